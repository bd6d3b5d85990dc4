//! Recordings in a single file, recognised by their first bytes or their extension: zip archives, which are
//! supported, and others, for which the error says how to unpack them.

use std::path::Path;

use super::error::{Place, RecordingError};
use super::location::Location;

/// Number of first bytes examined: the size of a tar header.
const HEAD: u64 = 512;
/// Most files examined per folder.
const MAX_FILES: usize = 64;

const TO_TUM: &str = "write its colour, depth and poses as rgb/, depth/, rgb.txt, depth.txt and groundtruth.txt (TUM layout)";
const UNPACK: &str = "unpack it and give the folder";

/// A kind of container file, and what to do with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Container {
    kind: &'static str,
    advice: &'static str,
}

/// Whether a file is a plain zip archive, by its first bytes and extension.
pub(super) fn is_zip(path: &Path) -> bool {
    let file = Location::from(path);
    // The second signature is that of an archive without members.
    let zip = |head: Vec<u8>| matches!(head.as_slice(), [b'P', b'K', 3, 4] | [b'P', b'K', 5, 6]);
    extension_of(&file) != "r3d" && file.head(4).is_ok_and(zip)
}

fn extension_of(file: &Location) -> String {
    let extension = file.path().extension().unwrap_or_default();
    extension.to_string_lossy().to_ascii_lowercase()
}

/// The error for a file that is a known container; `None` for any other file.
pub(super) fn recognise(file: &Location) -> Option<RecordingError> {
    let head = file.head(HEAD).ok()?;
    let found = identify(&head, &extension_of(file))?;
    let got = format!("{}, which is not supported: {}", found.kind, found.advice);
    Some(Place::file(file).field("recording", "a folder of pictures, or a zip of one", got))
}

/// The same, for the first container in a folder without pictures.
pub(super) fn find_in(root: &Location) -> Option<RecordingError> {
    let names = root.file_names().ok()?;
    names
        .iter()
        .take(MAX_FILES)
        .find_map(|name| recognise(&root.join(name)))
}

fn identify(head: &[u8], extension: &str) -> Option<Container> {
    let is = |kind, advice| Some(Container { kind, advice });
    let archive = || match extension {
        "r3d" => is(
            "a Record3D recording",
            "export it from the app as EXR + RGB, or unpack it (a zip) and write its depth as PNG or EXR",
        ),
        _ => is("an archive", UNPACK),
    };
    match extension {
        "svo" | "svo2" => {
            return is(
                "a ZED recording",
                "export it by ZED's SDK (samples: svo recording, export to image sequence with depth)",
            );
        }
        "sens" => {
            return is(
                "a ScanNet .sens file",
                "export it by ScanNet's SensReader (reader.py --export_depth_images --export_color_images --export_poses --export_intrinsics) and give the output folder",
            );
        }
        "klg" => return is("a Kintinuous .klg log", TO_TUM),
        _ => {}
    }
    match head {
        [b'#', b'R', b'O', b'S', b'B', b'A', b'G', ..] => is(
            "a ROS 1 bag",
            "of a RealSense, convert it by rs-convert -c color/ -d depth/; else write its topics as rgb/, depth/, rgb.txt, depth.txt and groundtruth.txt (TUM layout)",
        ),
        [0x89, b'M', b'C', b'A', b'P', ..] => is("an MCAP file", TO_TUM),
        [b'S', b'Q', b'L', b'i', b't', b'e', b' ', ..] => {
            is("an SQLite database (a ROS 2 bag)", TO_TUM)
        }
        [0x1A, 0x45, 0xDF, 0xA3, ..] => is(
            "a Matroska film",
            "of an Azure Kinect, unpack it by Open3D's azure_kinect_mkv_reader.py --output FOLDER",
        ),
        [b'N', b'I', b'1', b'0', ..] => is("an OpenNI .oni recording", TO_TUM),
        [0x89, b'H', b'D', b'F', ..] => is("an HDF5 file", TO_TUM),
        [b'P', b'K', 3, 4, ..] if extension != "r3d" => is(
            "a zip archive inside a folder",
            "give the path of the archive itself",
        ),
        [b'P', b'K', 3, 4, ..] => archive(),
        [0x1F, 0x8B, ..]
        | [b'7', b'z', 0xBC, 0xAF, ..]
        | [0xFD, b'7', b'z', b'X', b'Z', ..]
        | [0x28, 0xB5, 0x2F, 0xFD, ..]
        | [b'B', b'Z', b'h', ..]
        | [b'R', b'a', b'r', b'!', ..] => archive(),
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => is(
            "a film",
            "depth is needed beside colour: extract its frames into color/ and put depth/ and poses beside",
        ),
        _ if head.get(257..262) == Some(b"ustar") => archive(),
        _ => match extension {
            "bag" | "mcap" | "db3" | "mkv" | "oni" | "r3d" => is(
                "a recording container with unknown first bytes (perhaps cut short)",
                TO_TUM,
            ),
            _ => None,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(path: &Path) -> Location {
        Location::from(path)
    }

    #[test]
    fn containers_are_named_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let mut tar = vec![0; 512];
        tar[257..262].copy_from_slice(b"ustar");
        for (name, head, kind, advice) in [
            ("a.bag", &b"#ROSBAG V2.0\n"[..], "ROS 1 bag", "rs-convert"),
            ("a.mcap", b"\x89MCAP0\r\n", "MCAP", "TUM layout"),
            ("a.db3", b"SQLite format 3\0", "ROS 2 bag", "TUM layout"),
            (
                "a.mkv",
                b"\x1A\x45\xDF\xA3",
                "Matroska",
                "azure_kinect_mkv_reader",
            ),
            ("a.r3d", b"PK\x03\x04", "Record3D", "EXR"),
            ("a.zip", b"PK\x03\x04", "zip archive", "the archive itself"),
            ("a.tar", &tar, "archive", "unpack"),
            ("a.tgz", b"\x1F\x8B\x08", "archive", "unpack"),
            ("a.sens", b"\x04\0\0\0", "ScanNet .sens", "reader.py"),
            ("a.svo", b"anything", "ZED", "SDK"),
            ("a.svo2", b"\x89MCAP0\r\n", "ZED", "SDK"),
            ("a.klg", b"\x10\0\0\0", "Kintinuous", "TUM"),
            ("a.oni", b"NI10", "OpenNI", "TUM"),
            ("a.mp4", b"\0\0\0\x20ftypisom", "film", "depth/"),
            ("renamed", b"#ROSBAG V2.0\n", "ROS 1 bag", "rs-convert"),
            ("cut.BAG", b"", "unknown first bytes", "TUM"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, head).unwrap();
            let text = recognise(&at(&path)).unwrap().to_string();
            assert!(text.contains(kind) && text.contains(advice), "{text}");
            assert!(text.contains(name) && !text.contains('\n'), "{text}");
            let inside = find_in(&at(folder.path())).unwrap().to_string();
            assert_eq!(inside, text);
            std::fs::remove_file(&path).unwrap();
        }
        for (name, head, zip) in [
            ("a.zip", &b"PK\x03\x04..."[..], true),
            ("empty.zip", b"PK\x05\x06", true),
            ("renamed", b"PK\x03\x04", true),
            ("a.r3d", b"PK\x03\x04", false),
            ("text.zip", b"PK", false),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, head).unwrap();
            assert_eq!(is_zip(&path), zip, "{name}");
            std::fs::remove_file(&path).unwrap();
        }
        for name in ["a.glb", "a.png", "a.txt"] {
            let path = folder.path().join(name);
            std::fs::write(&path, b"glTF").unwrap();
            assert!(recognise(&at(&path)).is_none());
        }
        assert!(recognise(&at(folder.path())).is_none());
    }
}

//! Zipped recordings are read as the folders that were zipped; hostile archives are refused.

use std::io::Write as _;

use proptest::prelude::*;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::made::{self, LAYOUTS, reds, write};
use super::*;

/// Files of a folder, by their paths in it, with slashes.
fn files(folder: &Path, prefix: &str, into: &mut Vec<(String, Vec<u8>)>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("{prefix}{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            files(&path, &format!("{name}/"), into);
        } else {
            into.push((name, fs::read(&path).unwrap()));
        }
    }
}

/// An archive of these members, every other one deflated.
fn zip_of(path: &Path, members: &[(String, Vec<u8>)]) {
    let mut zip = ZipWriter::new(fs::File::create(path).unwrap());
    for (i, (name, bytes)) in members.iter().enumerate() {
        let method = [CompressionMethod::Stored, CompressionMethod::Deflated][i % 2];
        let options = SimpleFileOptions::default().compression_method(method);
        zip.start_file(name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
}

fn zip_folder(folder: &Path, prefix: &str, path: &Path) {
    let mut members = Vec::new();
    files(folder, prefix, &mut members);
    zip_of(path, &members);
}

/// Zips the folder of a recording, bare and with a folder around it, and compares.
pub(super) fn same_when_zipped(recording: &Recording) {
    let dir = tempfile::tempdir().unwrap();
    for prefix in ["", "take 1/", "a/b/"] {
        let path = dir.path().join("r.zip");
        zip_folder(&recording.root, prefix, &path);
        let zipped = Recording::open(&path, &recording.options).unwrap();
        assert_eq!(zipped.layout(), recording.layout());
        assert_eq!(zipped.times_ns(), recording.times_ns());
        assert_eq!(zipped.poses(), recording.poses());
        // Reasons contain the whole paths of files.
        let notes = |r: &Recording, root: &Path| {
            let root = root.display().to_string();
            let notes = r.notes().iter().map(|note| note.replace(&root, "ROOT"));
            notes.collect::<Vec<_>>()
        };
        let mut inner = path.clone();
        inner.extend(prefix.split('/').filter(|part| !part.is_empty()));
        assert_eq!(notes(&zipped, &inner), notes(recording, &recording.root));
        for i in 0..recording.len() {
            let (a, b) = (zipped.frame(i).unwrap(), recording.frame(i).unwrap());
            assert_eq!(a.color, b.color);
            assert_eq!(a.intrinsics, b.intrinsics);
            let bits = |depth: &DepthImage| -> Vec<u32> {
                depth.z_m.iter().map(|z| z.to_bits()).collect()
            };
            assert_eq!(bits(&a.depth), bits(&b.depth));
        }
        zipped.inspect().unwrap();
    }
}

#[test]
fn every_layout_is_the_same_when_zipped() {
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 5, None);
        same_when_zipped(&open(dir.path()).unwrap());
    }
}

/// Names that lead out of the archive are left out; names written by Windows and macOS are supported.
#[test]
fn names_stay_inside_the_archive() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("r");
    LAYOUTS[0].write(&folder, 3, None);
    let mut members = Vec::new();
    files(&folder, "r\\", &mut members);
    for (name, _) in &mut members {
        *name = name.replace('/', "\\");
    }
    let outside = "../rgb/9.png /rgb/9.png C:/rgb/9.png r/../rgb.txt __MACOSX/r/._a r/.DS_Store";
    for name in outside.split(' ') {
        members.push((name.to_owned(), made::color(9)));
    }
    members.push((format!("r/{}x", "d/".repeat(100)), Vec::new()));
    members.push((format!("r/{}", "x".repeat(5000)), Vec::new()));
    let path = dir.path().join("r.zip");
    zip_of(&path, &members);
    let zipped = open(&path).unwrap();
    assert_eq!(reds(&zipped), [0, 1, 2]);
    // Neither `rgb` nor anything else outside `r`.
    let root = Location::zip(&path).unwrap();
    assert_eq!(root.folder_names().unwrap(), ["r"]);
    assert!(root.file_names().unwrap().is_empty());
    assert_eq!(root.join("r").folder_names().unwrap(), ["depth", "rgb"]);
    for nowhere in ["..", "/etc/hostname", "r/../../r.zip", "r/rgb.txt/x"] {
        let location = root.join(nowhere);
        assert!(!location.is_file() && !location.is_dir(), "{nowhere}");
        assert!(location.read(1000).is_err(), "{nowhere}");
    }
    assert!(root.parent().is_none());
}

/// A list in an archive that names a file outside of it is rejected, as in a folder.
#[test]
fn lists_name_nothing_outside_the_archive() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("r");
    LAYOUTS[0].write(&folder, 2, None);
    write(dir.path(), "secret.png", made::color(7));
    let secret = dir.path().join("secret.png");
    let list = format!(
        "0.0 rgb/0.0.png\n0.5 ../secret.png\n1.0 {}\n",
        secret.display()
    );
    write(&folder, "rgb.txt", list);
    let path = dir.path().join("r.zip");
    zip_folder(&folder, "", &path);
    assert_eq!(reds(&open(&path).unwrap()), [0]);
}

#[test]
fn members_larger_than_they_may_be_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.zip");
    let zeros = vec![0u8; 1 << 20];
    let members = ["stored", "deflated"].map(|name| (name.to_owned(), zeros.clone()));
    zip_of(&path, &members);
    let mut bytes = fs::read(&path).unwrap();
    // A megabyte of zeros deflates to a thousandth.
    assert!(bytes.len() < (1 << 20) + (8 << 10));
    let read = |name: &str, max| Location::zip(&path).unwrap().join(name).read(max);
    for (name, zeros) in &members {
        assert_eq!(read(name, 1 << 20).unwrap(), *zeros);
        let error = read(name, (1 << 20) - 1).unwrap_err().to_string();
        assert!(
            error.contains("file size in bytes: expected at most"),
            "{error}"
        );
    }
    // The directory declares ten bytes; the output is bounded nevertheless.
    let claim = (1u32 << 20).to_le_bytes();
    let mut at = 0;
    while let Some(found) = bytes[at..].windows(4).position(|w| w == claim) {
        at += found;
        bytes[at..at + 4].copy_from_slice(&10u32.to_le_bytes());
        at += 4;
    }
    fs::write(&path, bytes).unwrap();
    assert!(read("deflated", 1000).map_or(true, |bytes| bytes.len() <= 1000));
}

#[test]
fn damaged_archives_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("r");
    LAYOUTS[2].write(&folder, 3, None);
    let path = dir.path().join("r.zip");
    zip_folder(&folder, "", &path);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let message = error(&path);
    assert!(
        message.contains("r.zip: recording: expected a whole zip archive"),
        "{message}"
    );
    // One flipped byte of a picture: its checksum fails, and its frame is left out.
    let picture = fs::read(folder.join("color/000001.png")).unwrap();
    let mut members = Vec::new();
    files(&folder, "", &mut members);
    // Pictures are stored uncompressed, so that they can be found in the archive's bytes.
    let mut zip = ZipWriter::new(fs::File::create(&path).unwrap());
    for (name, bytes) in &members {
        let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file(name, stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes
        .windows(picture.len())
        .position(|w| w == picture)
        .unwrap();
    bytes[at + picture.len() / 2] ^= 1;
    fs::write(&path, bytes).unwrap();
    let zipped = open(&path).unwrap();
    assert_eq!(reds(&zipped), [0, 2]);
    assert!(
        zipped
            .notes()
            .iter()
            .any(|n| n.contains("000001.png") && n.contains("checksum")),
        "{:?}",
        zipped.notes()
    );
    // An empty archive.
    zip_of(&path, &[]);
    assert!(error(&path).contains("expected a recording, found none of"));
    // An archive with a recording of an unsupported kind.
    zip_of(
        &path,
        &[("take.bag".to_owned(), b"#ROSBAG V2.0\n".to_vec())],
    );
    assert!(error(&path).contains("rs-convert"));
}

#[test]
fn links_in_an_archive_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("r.zip");
    let mut zip = ZipWriter::new(fs::File::create(&path).unwrap());
    let options = SimpleFileOptions::default();
    zip.add_symlink("link", "/etc/hostname", options).unwrap();
    zip.start_file("file", options).unwrap();
    zip.finish().unwrap();
    let root = Location::zip(&path).unwrap();
    assert_eq!(root.file_names().unwrap(), ["file"]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With any byte of an archive changed: frames or an error, never a panic.
    #[test]
    fn a_changed_archive_never_panics(at in 0.0..1.0f64, flip in 1u8..) {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("r");
        LAYOUTS[0].write(&folder, 2, None);
        let path = dir.path().join("r.zip");
        zip_folder(&folder, "", &path);
        let mut bytes = fs::read(&path).unwrap();
        let at = (at * bytes.len() as f64) as usize;
        bytes[at] ^= flip;
        fs::write(&path, bytes).unwrap();
        if let Ok(recording) = open(&path) {
            for i in 0..recording.len() {
                let _ = recording.frame(i);
            }
        }
    }
}

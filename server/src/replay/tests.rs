use super::*;
use crate::camera::{Intrinsics, Pose};
use crate::frame::{ColorImage, DepthImage};
use crate::numerics::hash;
use crate::render::{AovImage, Backend, FrameStats};
use std::collections::BTreeMap;
use std::path::Path;

/// Frames with a moving square.
fn frames(n: u64, width: u32, height: u32) -> Vec<RgbdFrame> {
    let pixels = (width * height) as usize;
    (0..n)
        .map(|index| RgbdFrame {
            index,
            time_ns: index as i64 * 40_000_000,
            color: ColorImage {
                width,
                height,
                rgba: (0..pixels as u32)
                    .map(|i| {
                        let (x, y) = (i % width, i / width);
                        let inside = x.abs_diff(8 * index as u32 + 20) < 12 && y.abs_diff(30) < 12;
                        if inside {
                            [230, 60, 40, 255]
                        } else {
                            [(x * 2) as u8, (y * 3) as u8, (hash(i, 0, 0) % 8) as u8, 255]
                        }
                    })
                    .collect(),
            },
            depth: DepthImage::from_metres(width, height, vec![1.0; pixels]),
            intrinsics: Intrinsics::new(100.0, 100.0, 40.0, 30.0, width, height).unwrap(),
            pose: Pose::IDENTITY,
        })
        .collect()
}

fn copied(frame: &RgbdFrame) -> Result<Rendered, BoxError> {
    let n = frame.color.rgba.len();
    Ok(Rendered {
        color: frame.color.clone(),
        aovs: vec![
            (Aov::Mask, AovImage::Gray8(vec![7; n])),
            (Aov::Depth, AovImage::Gray16(vec![1234; n])),
            (Aov::Normal, AovImage::Rgb8(vec![[1, 2, 3]; n])),
        ],
        stage_ns: [1_000_000; Stage::ALL.len()],
        total_ns: (frame.index + 1) * 2_000_000,
        stats: FrameStats::default(),
        lowered: Vec::new(),
    })
}

fn go(_: usize, _: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn into(path: &Path) -> ReplayOptions {
    ReplayOptions {
        backend: Backend::Cpu,
        frames: FrameRange::default(),
        aovs: vec![Aov::Mask, Aov::Depth, Aov::Normal],
        output: Output::from_path(path.to_owned()).unwrap(),
        report: None,
        measure: false,
    }
}

/// Every file below a folder, by its relative path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if entry.file_type().unwrap().is_dir() {
            found.insert(format!("{name}/"), Vec::new());
            for (inner, bytes) in files(&entry.path()) {
                found.insert(format!("{name}/{inner}"), bytes);
            }
        } else {
            found.insert(name, std::fs::read(entry.path()).unwrap());
        }
    }
    found
}

fn names(folder: &Path) -> Vec<String> {
    files(folder).into_keys().collect()
}

#[test]
fn a_folder_gets_a_picture_per_frame_and_aov_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("deep/er/out");
    let mut source = frames(4, 80, 61);
    let mut options = into(&out);
    options.frames = "1..3".parse().unwrap();
    options.report = Some(out.join("report.json"));
    let report = run(&mut source, copied, &options, go).unwrap();
    assert_eq!(
        names(&out),
        [
            ".ghostlight-replay",
            "000001.png",
            "000002.png",
            "depth/",
            "depth/000001.png",
            "depth/000002.png",
            "mask/",
            "mask/000001.png",
            "mask/000002.png",
            "normal/",
            "normal/000001.png",
            "normal/000002.png",
            "report.json"
        ]
    );
    assert_eq!(names(dir.path())[0], "deep/");
    for i in [1, 2] {
        let png = image::open(out.join(format!("{i:06}.png")))
            .unwrap()
            .to_rgba8();
        assert!(png.as_raw().as_slice() == source[i].color.bytes());
        let frame = &report.frames[i - 1];
        assert_eq!(frame.index, i);
        let hash = twox_hash::XxHash3_128::oneshot(png.as_raw());
        assert_eq!(frame.hash, format!("{hash:032x}"));
    }
    let depth = image::open(out.join("depth/000002.png")).unwrap();
    assert!(matches!(depth, image::DynamicImage::ImageLuma16(d) if d.iter().all(|&mm| mm == 1234)));

    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(json["summary"]["frames"], 2);
    // Frames 1 and 2 report 4 and 6 ms.
    assert_eq!(json["summary"]["median_ms"], 5.0);
    assert_eq!(json["summary"]["p95_ms"], 6.0);
    assert_eq!(json["summary"]["fps"], 200.0);
    assert_eq!(json["frames"][0]["hash"], report.frames[0].hash.as_str());
    let stages = json["frames"][1]["stages_ms"].as_object().unwrap();
    for stage in Stage::ALL {
        assert_eq!(stages[stage.name()], 1.0);
    }
    assert!(stages["read"].is_number() && stages["write"].is_number());
    assert!(report.frames[1].stages_ms.get("write").unwrap() > 0.0);
}

#[test]
fn the_hash_is_the_published_one() {
    // Hash that `xxhsum -H2` prints for the four bytes 01 02 03 04.
    let mut rendered = copied(&frames(1, 1, 1)[0]).unwrap();
    rendered.color.rgba = vec![[1, 2, 3, 4]];
    let hash = FrameReport::new(0, &rendered).hash;
    assert_eq!(hash.len(), 32);
    rendered.color.rgba = Vec::new();
    // The hash that the specification gives for no bytes and seed 0.
    let empty = FrameReport::new(0, &rendered).hash;
    assert_eq!(empty, "99aa06d3014798d86001c324468d497f");
    assert_ne!(hash, empty);
}

#[test]
fn replaying_again_replaces_frames_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    run(&mut frames(3, 16, 16), copied, &into(&out), go).unwrap();
    std::fs::write(out.join("notes.txt"), "mine").unwrap();
    std::fs::write(out.join("mask/keep.txt"), "mine").unwrap();
    let mut options = into(&out);
    options.aovs = Vec::new();
    options.frames = "..2".parse().unwrap();
    let bare = |frame: &RgbdFrame| {
        let mut rendered = copied(frame)?;
        rendered.aovs.clear();
        Ok(rendered)
    };
    run(&mut frames(2, 20, 20), bare, &options, go).unwrap();
    assert_eq!(
        names(&out),
        [
            ".ghostlight-replay",
            "000000.png",
            "000001.png",
            "mask/",
            "mask/keep.txt",
            "notes.txt"
        ]
    );
    assert_eq!(
        image::image_dimensions(out.join("000001.png")).unwrap(),
        (20, 20)
    );
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn pictures_of_someone_else_are_not_touched() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["000000.png", "depth"] {
        let out = dir.path().join(format!("recording of {name}"));
        std::fs::create_dir(&out).unwrap();
        std::fs::write(out.join(name), "a recording").unwrap();
        let error = run(&mut frames(1, 16, 16), copied, &into(&out), go).unwrap_err();
        assert!(
            matches!(&error, ReplayError::Occupied { found, .. } if found == name),
            "{error}"
        );
        assert_eq!(names(&out), [name]);
    }
    // Other files do no harm and are not changed.
    let out = dir.path().join("logs");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("log.txt"), "mine").unwrap();
    run(&mut frames(1, 16, 16), copied, &into(&out), go).unwrap();
    assert!(out.join("log.txt").exists() && out.join("000000.png").exists());
}

/// A source that fails at one frame.
struct Failing(Vec<RgbdFrame>, usize);

impl FrameSource for Failing {
    fn n_frames(&self) -> usize {
        self.0.len()
    }
    fn time_ns(&self, index: usize) -> Option<i64> {
        self.0.time_ns(index)
    }
    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        if index == self.1 {
            return Err("rgb/3.png: corrupt".into());
        }
        self.0.frame(index)
    }
}

/// A source that reports that some of its frames cannot be read.
struct Holed(Vec<RgbdFrame>, &'static [usize]);

impl FrameSource for Holed {
    fn n_frames(&self) -> usize {
        self.0.len()
    }
    fn time_ns(&self, index: usize) -> Option<i64> {
        self.0.time_ns(index)
    }
    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        if self.1.contains(&index) {
            return Err(format!("rgb/{index}.png: corrupt").into());
        }
        self.0.frame(index)
    }
    fn leaves_out(&self, _error: &BoxError) -> bool {
        true
    }
}

#[test]
fn frames_that_cannot_be_read_are_left_out_and_reported() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut options = into(&out);
    options.frames = "1..6".parse().unwrap();
    options.report = Some(dir.path().join("report.json"));
    let mut source = Holed(frames(6, 32, 32), &[1, 3]);
    let report = run(&mut source, copied, &options, go).unwrap();
    let indices: Vec<usize> = report.frames.iter().map(|frame| frame.index).collect();
    assert_eq!(indices, [2, 4, 5]);
    let left_out: Vec<(usize, &str)> = (report.left_out.iter())
        .map(|left| (left.index, left.reason.as_str()))
        .collect();
    assert_eq!(
        left_out,
        [(1, "rgb/1.png: corrupt"), (3, "rgb/3.png: corrupt")]
    );
    assert_eq!(report.summary.frames, 3);
    for frame in &report.frames {
        assert!(frame.stages_ms.get("read").is_some() && frame.stages_ms.get("write").is_some());
        assert!(out.join(format!("{:06}.png", frame.index)).exists());
    }
    assert!(!out.join("000003.png").exists());
    let json = std::fs::read_to_string(dir.path().join("report.json")).unwrap();
    assert!(json.contains("\"left_out\""));

    let mut source = Holed(frames(2, 32, 32), &[0, 1]);
    let error = run(&mut source, copied, &into(&out), go).unwrap_err();
    assert_eq!(error.to_string(), "frame 1: rgb/1.png: corrupt");
}

#[test]
fn an_error_in_the_middle_leaves_nothing_behind_and_what_was_there_alone() {
    let dir = tempfile::tempdir().unwrap();
    let fresh = dir.path().join("new");
    let film = dir.path().join("new.mp4");
    let old = dir.path().join("old");
    run(&mut frames(2, 32, 32), copied, &into(&old), go).unwrap();
    let before = files(dir.path());
    for out in [&fresh, &film, &old] {
        let mut options = into(out);
        options.report = Some(dir.path().join("report.json"));
        if out == &film {
            options.aovs.clear();
        }
        let mut source = Failing(frames(6, 64, 64), 3);
        let error = run(&mut source, copied, &options, go).unwrap_err();
        assert_eq!(error.to_string(), "frame 3: rgb/3.png: corrupt");
        let broken = |frame: &RgbdFrame| match frame.index {
            4 => Err("no memory".into()),
            _ => copied(frame),
        };
        let error = run(&mut frames(6, 64, 64), broken, &options, go).unwrap_err();
        assert_eq!(error.to_string(), "frame 4: rendering: no memory");
        let stop = |done, _| match done {
            2 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let error = run(&mut frames(6, 64, 64), copied, &options, stop).unwrap_err();
        assert!(matches!(error, ReplayError::Stopped { index: 2 }));
        assert!(files(dir.path()) == before, "{}", out.display());
    }
    // Errors of a writer: a film cannot change its size, and a PNG cannot be inconsistent.
    let mut sizes = frames(3, 64, 64);
    sizes.extend(frames(3, 32, 64));
    let mut options = into(&film);
    options.aovs.clear();
    let error = run(&mut sizes, copied, &options, go)
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("film frames: expected 64x64 as the first, got 32x64"),
        "{error}"
    );
    assert!(files(dir.path()) == before);
}

#[test]
fn a_writer_that_fails_stops_the_replay() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut rendered = 0;
    let short = |frame: &RgbdFrame| {
        rendered += 1;
        let mut done = copied(frame)?;
        // Sizes that PNG does not allow.
        done.color.width = 0;
        done.color.height = 0;
        done.color.rgba.clear();
        Ok(done)
    };
    let mut source = vec![frames(1, 8, 8).remove(0); 500];
    for (index, frame) in source.iter_mut().enumerate() {
        frame.index = index as u64;
    }
    let error = run(&mut source, short, &into(&out), go).unwrap_err();
    assert!(matches!(error, ReplayError::Picture { .. }), "{error}");
    assert!(rendered < 500, "{rendered}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn bad_ranges_and_empty_recordings_are_told() {
    let dir = tempfile::tempdir().unwrap();
    for text in [
        "",
        "3",
        "3..3",
        "5..2",
        "a..b",
        "-1..4",
        "1..2..3",
        "0..99999999999999999999",
    ] {
        let error = text.parse::<FrameRange>().unwrap_err();
        assert!(error.contains("expected A..B"), "{error}");
    }
    for (text, n, ok) in [
        ("0..4", 4, true),
        ("2..", 4, true),
        ("..", 1, true),
        ("0..5", 4, false),
        ("4..", 4, false),
    ] {
        let range: FrameRange = text.parse().unwrap();
        assert_eq!(range.of(n).is_ok(), ok, "{text}");
    }
    let out = dir.path().join("out");
    let error = run(&mut Vec::new(), copied, &into(&out), go).unwrap_err();
    assert_eq!(error.to_string(), "the recording has no frames");
    let mut film = into(&dir.path().join("a.MP4"));
    let error = run(&mut frames(1, 16, 16), copied, &film, go).unwrap_err();
    assert!(
        error.to_string().starts_with("aov: expected a folder"),
        "{error}"
    );
    film.output = Output::Film(dir.path().to_owned());
    film.aovs.clear();
    assert!(run(&mut frames(1, 16, 16), copied, &film, go).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn times_are_taken_with_nothing_else_running_only_to_measure() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    static READING: AtomicUsize = AtomicUsize::new(0);
    struct Slow(Vec<RgbdFrame>);
    impl FrameSource for Slow {
        fn n_frames(&self) -> usize {
            self.0.len()
        }
        fn time_ns(&self, index: usize) -> Option<i64> {
            self.0.time_ns(index)
        }
        fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
            READING.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(std::time::Duration::from_millis(4));
            READING.fetch_sub(1, Ordering::SeqCst);
            self.0.frame(index)
        }
    }
    let dir = tempfile::tempdir().unwrap();
    for measure in [true, false] {
        let mut options = into(&dir.path().join("out"));
        options.measure = measure;
        let mut seen = 0;
        let slow = |frame: &RgbdFrame| {
            for _ in 0..8 {
                seen += READING.load(Ordering::SeqCst);
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            copied(frame)
        };
        run(&mut Slow(frames(8, 16, 16)), slow, &options, go).unwrap();
        assert_eq!(seen == 0, measure, "{seen}");
    }
}

#[test]
fn films_are_playable_and_show_the_frames() {
    use openh264::formats::YUVSource;
    let dir = tempfile::tempdir().unwrap();
    for (width, height) in [(96, 64), (81, 61), (640, 480)] {
        let path = dir.path().join(format!("{width}.mp4"));
        let mut options = into(&path);
        options.aovs.clear();
        let source = frames(6, width, height);
        run(&mut source.clone(), copied, &options, go).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let at = |tag: &[u8]| bytes.windows(4).position(|w| w == tag).unwrap();
        assert!(at(b"ftyp") < at(b"moov") && at(b"moov") < at(b"mdat"));

        // The samples are NAL units with 4-byte lengths; parameter sets are in avcC.
        let mut stream = Vec::new();
        let avcc = at(b"avcC") + 4;
        let sps_len = usize::from(u16::from_be_bytes([bytes[avcc + 6], bytes[avcc + 7]]));
        let pps_at = avcc + 8 + sps_len + 1;
        let pps_len = usize::from(u16::from_be_bytes([bytes[pps_at], bytes[pps_at + 1]]));
        for nal in [
            &bytes[avcc + 8..][..sps_len],
            &bytes[pps_at + 2..][..pps_len],
        ] {
            stream.extend_from_slice(&[0, 0, 0, 1]);
            stream.extend_from_slice(nal);
        }
        let mut decoder = openh264::decoder::Decoder::new().unwrap();
        decoder.decode(&stream).unwrap();
        let mut mdat = &bytes[at(b"mdat") + 4..];
        let mut shown = 0;
        while mdat.len() > 4 {
            let n = u32::from_be_bytes([mdat[0], mdat[1], mdat[2], mdat[3]]) as usize;
            let unit = [&[0, 0, 0, 1], &mdat[4..4 + n]].concat();
            mdat = &mdat[4 + n..];
            let Some(picture) = decoder.decode(&unit).unwrap() else {
                continue;
            };
            assert_eq!(
                picture.dimensions(),
                (
                    width.next_multiple_of(2) as usize,
                    height.next_multiple_of(2) as usize
                )
            );
            let frame = &source[shown];
            let (mut error, mut n) = (0.0, 0.0);
            for y in 0..height as usize {
                for x in 0..width as usize {
                    let [r, g, b, _] = frame.color.rgba[y * width as usize + x].map(f64::from);
                    let luma = 16.0 + (0.2126 * r + 0.7152 * g + 0.0722 * b) * 219.0 / 255.0;
                    let got = f64::from(picture.y()[y * picture.strides().0 + x]);
                    error += (got - luma).powi(2);
                    n += 1.0;
                }
            }
            let psnr = 10.0 * (255.0f64.powi(2) / (error / n)).log10();
            // A neighbouring frame would be under 25 dB, because the square has moved.
            assert!(psnr > 33.0, "{width}x{height} frame {shown}: {psnr:.1} dB");
            shown += 1;
        }
        assert_eq!(shown, 6);
    }
    // The size may be too small for the encoder: this must not panic or leave a partial film.
    let path = dir.path().join("tiny.mp4");
    let mut options = into(&path);
    options.aovs.clear();
    let made = run(&mut frames(2, 1, 1), copied, &options, go).is_ok();
    assert_eq!(path.exists(), made);
}

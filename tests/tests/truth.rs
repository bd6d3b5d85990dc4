//! Compares composites with reference pictures that really contain the object: a room rendered by an independent
//! path tracer, empty and with each object in it. The data are not part of this repository: the test runs if
//! `GHOSTLIGHT_DATA` names a folder beside `truth`, and is skipped otherwise.
//!
//! The bounds are what the renderer reaches today; they may only be tightened.

use std::path::{Path, PathBuf};
use std::process::Command;

use image::{GrayImage, RgbImage};

/// Index of the frame that has a reference picture.
const FRAME: usize = 23;

/// Scene; least PSNR of the whole picture, dB; greatest RMSE on the object and in its shadow, in units of 1/255
/// of sRGB.
const CASES: [(&str, f64, f64, f64); 7] = [
    ("sphere-matte", 47.8, 2.3, 4.4),
    ("teapot-plastic", 46.7, 4.6, 4.2),
    ("teapot-brushed", 42.9, 10.1, 3.9),
    ("sphere-gold", 37.7, 14.3, 5.1),
    ("teapot-mirror", 40.3, 13.1, 3.9),
    ("sphere-glass", 40.8, 6.4, 9.8),
    ("box-red-on-paper", 45.8, 6.4, 5.4),
];

/// A pixel is in shadow if its light is below this share of the empty room's.
const IN_SHADOW: f64 = 0.93;

/// Standard deviation of the blur that separates shadows from noise, pixels.
const SIGMA: f64 = 3.0;

fn truth() -> Option<PathBuf> {
    let data = PathBuf::from(std::env::var_os("GHOSTLIGHT_DATA")?);
    let truth = data.parent()?.join("truth");
    truth.join("truth").is_dir().then_some(truth)
}

fn rgb(path: &Path) -> RgbImage {
    let picture = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    picture.into_rgb8()
}

fn linear(code: f64) -> f64 {
    let s = code / 255.0;
    if s <= 0.040_45 {
        s / 12.92
    } else {
        ((s + 0.055) / 1.055).powf(2.4)
    }
}

/// The set, grown by `radius` pixels.
fn grown(set: &[bool], [width, height]: [usize; 2], radius: isize) -> Vec<bool> {
    let mut grown = set.to_vec();
    for (i, _) in set.iter().enumerate().filter(|(_, there)| **there) {
        let (x, y) = ((i % width) as isize, (i / width) as isize);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                let (x, y) = (x + dx, y + dy);
                let inside = (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
                if inside && dx * dx + dy * dy <= radius * radius + radius {
                    grown[y as usize * width + x as usize] = true;
                }
            }
        }
    }
    grown
}

/// Gaussian-weighted mean of the pixels in `kept`.
fn blurred(values: &[f64], kept: &[bool], [width, height]: [usize; 2]) -> Vec<f64> {
    let radius = (3.0 * SIGMA) as isize;
    let along = |values: &[f64], horizontal: bool| -> Vec<f64> {
        let at = |i: usize, offset: isize| {
            let (x, y) = ((i % width) as isize, (i / width) as isize);
            let (x, y) = if horizontal {
                (x + offset, y)
            } else {
                (x, y + offset)
            };
            let inside = (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
            if inside {
                values[y as usize * width + x as usize]
            } else {
                0.0
            }
        };
        let weight = |offset: isize| (-0.5 * (offset as f64 / SIGMA).powi(2)).exp();
        let sum = |i| (-radius..=radius).map(|o| weight(o) * at(i, o)).sum();
        (0..values.len()).map(sum).collect()
    };
    let weights: Vec<f64> = kept.iter().map(|&kept| f64::from(u8::from(kept))).collect();
    let weighted: Vec<f64> = values.iter().zip(&weights).map(|(v, w)| v * w).collect();
    let sums = along(&along(&weighted, true), false);
    let weights = along(&along(&weights, true), false);
    sums.iter()
        .zip(weights)
        .map(|(s, w)| s / w.max(1e-9))
        .collect()
}

/// RMSE over the pixels of a set.
fn rmse(a: &RgbImage, b: &RgbImage, set: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut n) = (0.0, 0);
    for (i, (a, b)) in a.pixels().zip(b.pixels()).enumerate() {
        if set(i) {
            let squares = (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).powi(2));
            sum += squares.sum::<f64>();
            n += 3;
        }
    }
    (sum / f64::from(n.max(1))).sqrt()
}

/// A reference picture with the object, and where object and shadow are.
struct Reference {
    picture: RgbImage,
    object: Vec<bool>,
    shadow: Vec<bool>,
}

impl Reference {
    fn load(truth: &Path, case: &str) -> Self {
        let photo = rgb(&truth.join(format!("room/rgb/{FRAME:02}.png")));
        let stem = truth.join("truth").join(case);
        // Stored as the difference from the picture of the empty room, modulo 256.
        let mut picture = rgb(&stem.with_extension("png"));
        for (pixel, empty) in picture.pixels_mut().zip(photo.pixels()) {
            (0..3).for_each(|c| pixel[c] = pixel[c].wrapping_add(empty[c]));
        }
        let mask = rgb(&stem.with_file_name(format!("{case}-mask.png")));
        // The red channel is the share of the pixel that shows the object.
        let (width, height) = mask.dimensions();
        let visible =
            GrayImage::from_fn(width, height, |x, y| image::Luma([mask.get_pixel(x, y)[0]]));
        let size = [width as usize, height as usize];
        let any: Vec<bool> = visible.iter().map(|&share| share > 0).collect();
        let not_whole: Vec<bool> = visible.iter().map(|&share| share < 255).collect();
        let near = grown(&any, size, 2);
        let object = grown(&not_whole, size, 2)
            .iter()
            .map(|edge| !edge)
            .collect();
        let kept: Vec<bool> = near.iter().map(|near| !near).collect();
        let light = |picture: &RgbImage| {
            let sum = |p: &image::Rgb<u8>| p.0.iter().map(|&c| linear(f64::from(c))).sum();
            let sums: Vec<f64> = picture.pixels().map(sum).collect();
            blurred(&sums, &kept, size)
        };
        let lit = light(&picture).into_iter().zip(light(&photo));
        let shares = lit.map(|(with, without)| with / without.max(1e-4));
        let shadow = shares
            .zip(&kept)
            .map(|(share, &kept)| kept && share < IN_SHADOW);
        Self {
            shadow: shadow.collect(),
            picture,
            object,
        }
    }
}

#[test]
fn composites_are_as_near_to_photographs_as_they_were() {
    let Some(truth) = truth() else {
        eprintln!("SKIPPED: no folder \"truth\" beside GHOSTLIGHT_DATA");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut broken = Vec::new();
    for (case, whole, object, shadow) in CASES {
        let out = folder.path().join(case);
        let replayed = Command::new(env!("CARGO_BIN_EXE_ghostlight-under-test"))
            .arg("replay")
            .arg(truth.join("room"))
            .arg("--scene")
            .arg(truth.join(format!("scenes/{case}-probe.json")))
            .args(["--intrinsics", "525,525,319.5,239.5", "--quiet", "--frames"])
            .arg(format!("{FRAME}..{}", FRAME + 1))
            .arg("--out")
            .arg(&out)
            .output()
            .unwrap();
        assert!(replayed.status.success(), "{case}: {replayed:?}");
        let composite = rgb(&out.join(format!("{FRAME:06}.png")));
        let reference = Reference::load(&truth, case);
        let of = |set: &dyn Fn(usize) -> bool| rmse(&composite, &reference.picture, set);
        let found = [
            20.0 * (255.0 / of(&|_| true)).log10(),
            of(&|i| reference.object[i]),
            of(&|i| reference.shadow[i]),
        ];
        let line = format!(
            "{case}: {:.1} dB, object {:.1}, shadow {:.1} (bounds {whole}, {object}, {shadow})",
            found[0], found[1], found[2]
        );
        eprintln!("{line}");
        if found[0] < whole || found[1] > object || found[2] > shadow {
            broken.push(line);
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

//! Caustics: numbers of photons and kernel widths against many photons with the narrowest kernel.

mod truth;

use anyhow::{Context, Result};

use super::frames::{once, rmse, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Printed, Section, Window, number};
use ghostlight::frame::{ColorImage, RgbdFrame};
use ghostlight::numerics::{linear_from_srgb, srgb_from_linear};
use ghostlight::render::{CausticSettings, RenderSettings, Stage};
use ghostlight::scene::Scene;

const HQ_AR: Printed = Printed {
    source: "Kan and Kaufmann 2012 (HQ-AR), section 5, table 1, 720x576",
    machine: "hexa-core CPU, GTX 590",
};

/// Printed figures: scene, milliseconds for photons, for their tree, for tracing.
const THEIRS: [(&str, [f64; 3]); 9] = [
    ("HQ-AR ring, 280 K, 1 ray", [45.0, 196.0, 21.0]),
    ("HQ-AR ring, 280 K, 4 rays", [47.0, 196.0, 94.0]),
    ("HQ-AR ring, 280 K, 9 rays", [47.0, 196.0, 206.0]),
    ("HQ-AR glass monkey, 100 K", [20.0, 31.0, 24.0]),
    ("HQ-AR glass monkey, 1 M", [167.0, 619.0, 45.0]),
    ("HQ-AR glass monkey, 1 M, 4 rays", [167.0, 618.0, 138.0]),
    ("HQ-AR dragon, 240 K", [28.0, 47.0, 36.0]),
    ("HQ-AR Buddha", [16.0, 17.0, 42.0]),
    ("HQ-AR Buddha, 4 rays", [16.0, 17.0, 165.0]),
];

/// Kernel radii, metres.
const RADII_M: [f32; 3] = [0.002, 0.003, 0.006];

/// A pixel counts as changed by caustics from this difference, in display levels.
const LEVELS: u8 = 2;

fn settings(caustics: CausticSettings) -> RenderSettings {
    let mut settings = RenderSettings {
        caustics,
        edge_samples: 1,
        ..RenderSettings::default()
    };
    settings.bloom.enabled = false;
    settings
}

/// Mean of several pictures in linear light. Different numbers of photons are distributed over different cells,
/// so the errors of the runs are independent.
fn reference(lab: &Lab, frame: &RgbdFrame, scene: &Scene) -> Result<(ColorImage, String)> {
    let (runs, photons) = lab.pick((3u32, 1_500_000u32), (12, 4_000_000));
    let mut sums = vec![[0.0f64; 3]; frame.color.rgba.len()];
    for run in 0..runs {
        let caustics = CausticSettings {
            enabled: Some(true),
            photons: photons - run * 50_021,
            radius_m: 0.0005,
        };
        let color = once(lab, frame, scene, &settings(caustics), &[])?.color;
        for (sum, pixel) in sums.iter_mut().zip(&color.rgba) {
            for (sum, &code) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(linear_from_srgb(code));
            }
        }
    }
    let mean = |sum: [f64; 3]| sum.map(|c| srgb_from_linear((c / f64::from(runs)) as f32));
    let rgba = sums.iter().map(|&sum| {
        let [r, g, b] = mean(sum);
        [r, g, b, 255]
    });
    let picture = ColorImage {
        rgba: rgba.collect(),
        ..frame.color
    };
    Ok((picture, format!("{runs} x {}", number(f64::from(photons)))))
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    // The kernel is never smaller than a pixel, so a smaller picture would measure something else.
    let frame = lab.desk()?.frame;
    let scene = lab.bundled_scene("caustics.json", &frame)?;
    let photons: &[u32] = lab.pick(
        &[30_000, 100_000, 280_000],
        &[30_000, 100_000, 280_000, 1_000_000],
    );
    let default = CausticSettings {
        enabled: Some(true),
        ..CausticSettings::default()
    };
    let mut variants = vec![CausticSettings {
        enabled: Some(false),
        ..CausticSettings::default()
    }];
    for radius_m in RADII_M {
        variants.extend(photons.iter().map(|&photons| CausticSettings {
            enabled: Some(true),
            photons,
            radius_m,
        }));
    }
    let all: Vec<RenderSettings> = variants.iter().map(|&v| settings(v)).collect();
    lab.phase("photons and kernels");
    let shots = shoot(lab, &frame, &scene, &all, &[])?;
    lab.phase("reference");
    let start = super::clock();
    let (truth, told) = reference(lab, &frame, &scene)?;
    let reference_ms = (super::clock() - start) as f64 * 1e-6;

    let off = &shots[0].rendered.color;
    let changed = |i: usize| {
        let pair = truth.rgba[i].iter().zip(&off.rgba[i]).take(3);
        pair.into_iter().any(|(a, b)| a.abs_diff(*b) > LEVELS)
    };
    let mut section = Section::new();
    section.prose(format!(
        "A glass ball and a gold ring on the bundled desk, two lamps. Photons are traced again in every frame and \
         blurred with an Epanechnikov kernel of a fixed radius. The reference is the mean of {told} photons with \
         the narrowest kernel, one pixel. The error is over the pixels that caustics change by more than {LEVELS} \
         levels, including those in the full shadow of glass. `photons` is the time to emit, trace and sort them; \
         looking them up is part of `shadows`. The time of a point is that of one frame."
    ));
    section.prose(
        "The paper's times are for its own scenes at 720x576: photons, the tree for looking them up (built on the \
         CPU; shown here with photons), and tracing. The time of its frame is their sum, plus steps that it does \
         not list.",
    );
    let columns = [
        ("frame", "ms"),
        ("error where caustics show", "1/255"),
        ("whole picture", "1/255"),
        ("photons and sorting", "ms"),
        ("shadows and look-up", "ms"),
        ("times a frame without", ""),
        ("photons stored", ""),
    ];
    let size = format!("{}x{}", frame.color.width, frame.color.height);
    let mut curve = Curve::new(format!("Photons and kernel radius ({size})"), columns)
        .plot(Axis::Log(0), Axis::Log(1));
    let errors: Vec<f64> = shots
        .iter()
        .map(|shot| rmse(&shot.rendered.color, &truth, changed))
        .collect();
    for ((variant, shot), &error) in variants.iter().zip(&shots).zip(&errors) {
        let (series, label) = if variant.enabled == Some(true) {
            let note = if *variant == default {
                " (default)"
            } else {
                ""
            };
            let thousands = number(f64::from(variant.photons) / 1000.0);
            (
                format!("{} mm", number(f64::from(variant.radius_m * 1000.0))),
                format!("{thousands} K{note}"),
            )
        } else {
            ("off".to_owned(), "off".to_owned())
        };
        curve.point(
            series,
            label,
            [
                shot.ms,
                error,
                rmse(&shot.rendered.color, &truth, |_| true),
                shot.stages_ms(&[Stage::Photons]),
                shot.stages_ms(&[Stage::Shadow, Stage::ShadowFilter]),
                shot.ms / shots[0].ms,
                shot.rendered.stats.photons_stored as f64,
            ],
        );
    }
    curve
        .point("least", told.as_str(), [reference_ms, 0.0, 0.0])
        .reference();
    for (label, [photons, tree, tracing]) in THEIRS {
        let blank = f64::NAN;
        curve
            .point(
                "",
                label,
                [photons + tree + tracing, blank, blank, photons + tree],
            )
            .printed(HQ_AR);
    }
    section.curve(curve);

    let at = variants.iter().position(|v| *v == default);
    let at = at.context("the default is not among the settings compared")?;
    let result = &shots[at].rendered.color;
    // Faint light falls nearly everywhere: the pictures show only where it is visible.
    let mut shown = off.clone();
    for i in (0..shown.rgba.len()).filter(|&i| changed(i)) {
        shown.rgba[i] = truth.rgba[i];
    }
    let window = Window::of_difference(&shown, off, 8);
    section.pictures([
        Picture::new("Reference", &truth, window)?,
        Picture::new("Default", result, window)?,
        Picture::difference(
            "Difference, 8 times; red where the default is brighter",
            [result, &truth],
            8.0,
            window,
        )?,
        Picture::new("Without caustics", off, window)?,
    ]);
    section.bound(Bound::at_most(
        "error of the default where caustics show, against that of none",
        0.25 * errors[0],
        errors[at],
        "/255",
    ));
    section.bound(Bound::at_most(
        "error of the default where caustics show",
        2.5,
        errors[at],
        "/255",
    ));
    // The noise: with the narrowest kernel more photons always reduce the error.
    let narrow = &errors[1..=photons.len()];
    section.bound(Bound::new(
        "errors under the narrowest kernel",
        "falling with photons",
        narrow
            .iter()
            .map(|&e| number(e))
            .collect::<Vec<_>>()
            .join(", "),
        narrow.windows(2).all(|pair| pair[1] < pair[0]),
    ));
    truth::compare(lab, &mut section)?;
    Ok(section)
}

//! Bloom and glare against direct sums in double precision at full resolution.

mod direct;

use anyhow::{Context, Result};

use self::direct::{Plane, direct_bloom, direct_glare};
use super::{Axis, Bound, Curve, Lab, Picture, Section, clock, number, take_turns};
use ghostlight::frame::ColorImage;
use ghostlight::numerics::{gamma, srgb_from_linear};
use ghostlight::render::cpu::post::bloom::{BloomScratch, bloom};
use ghostlight::render::cpu::post::glare::{GlareScratch, glare};
use ghostlight::render::{BloomMethod, BloomSettings, GlareSettings, Threads};

/// Discs of light, like lamps seen in a mirror: one of them soft, near and far from the border.
fn highlights(width: usize, height: usize) -> Vec<[f32; 3]> {
    let scale = width as f32 / 640.0;
    let discs = [
        (300.3, 220.1, 5.0),
        (341.7, 263.2, 8.0),
        (281.5, 291.9, 2.6),
        (8.0, 470.0, 4.0),
    ];
    (0..width * height)
        .map(|i| {
            let (x, y) = ((i % width) as f32 / scale, (i / width) as f32 / scale);
            let light = discs
                .iter()
                .map(|&(cx, cy, r)| (r + 0.5 - (x - cx).hypot(y - cy)).clamp(0.0, 1.0))
                .fold(0.0, f32::max);
            [0.1 + 20.0 * light, 0.1 + 18.0 * light, 0.1 + 15.0 * light]
        })
        .collect()
}

/// RMSE, largest difference, and largest difference relative to the reference's peak.
fn difference(added: &[[f32; 3]], reference: &Plane) -> [f64; 3] {
    let pairs = added.iter().flatten().zip(reference.iter().flatten());
    let (mut sum, mut most, mut peak) = (0.0, 0f64, 0f64);
    for (&a, &r) in pairs {
        let d = (f64::from(a) - r).abs();
        sum += d * d;
        most = most.max(d);
        peak = peak.max(r);
    }
    [(sum / (3 * added.len()) as f64).sqrt(), most, most / peak]
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let (width, height) = lab.pick((320, 240), (640, 480));
    let source = highlights(width, height);
    let threads = Threads::new(lab.engine().threads(), clock).context("threads")?;
    let mut section = Section::new();
    section.prose(
        "Both forms of bloom reduce the picture level by level. Both approximate the same sum of filters at full \
         resolution: the effect of each level on a point of light, averaged over all positions that the point may \
         have relative to the coarser pixels. That sum, in double precision, is the reference. The error shows \
         how much a highlight's bloom depends on its position; with such an error a moving highlight shimmers.",
    );
    let columns = [
        ("time", "ms"),
        ("error, RMS", "1/255"),
        ("error, largest", "1/255"),
        ("largest / peak", "%"),
    ];
    let mut curve = Curve::new(
        format!("Bloom of four highlights ({width}x{height})"),
        columns,
    )
    .plot(Axis::Log(0), Axis::Log(1));
    let mut shown = None;
    for (series, method) in [
        ("pyramid", BloomMethod::Pyramid),
        ("RT2AR's Gaussians", BloomMethod::Gaussians),
    ] {
        for levels in [1, 3, 5, 7] {
            lab.phase(&format!("{series}, {levels} levels"));
            let settings = BloomSettings {
                method,
                levels,
                ..BloomSettings::default()
            };
            let mut scratch = BloomScratch::default();
            let mut added = vec![[0f32; 3]; source.len()];
            let seconds = take_turns(lab.rounds() * 3, &mut [()], |()| {
                added.fill([0.0; 3]);
                bloom(
                    &source,
                    width,
                    height,
                    &settings,
                    &mut scratch,
                    &mut added,
                    &threads,
                );
            });
            let start = clock();
            let reference = direct_bloom(&source, width, &settings);
            let reference_ms = (clock() - start) as f64 * 1e-6;
            let [rms, most, relative] = difference(&added, &reference);
            let label = match levels {
                1 => "1 level".to_owned(),
                n if settings == BloomSettings::default() => format!("{n} levels (default)"),
                n => format!("{n} levels"),
            };
            let values = [
                seconds[0] * 1e3,
                rms * 255.0,
                most * 255.0,
                relative * 100.0,
            ];
            curve.point(series, label.as_str(), values);
            if settings == BloomSettings::default() {
                curve
                    .point("direct sum", label, [reference_ms, 0.0, 0.0, 0.0])
                    .reference();
                section.bound(Bound::at_most(
                    "bloom of the default settings, RMS error over the picture",
                    1.0,
                    rms * 255.0,
                    "/255",
                ));
                shown = Some((added, reference));
            }
        }
    }
    section.curve(curve);
    if let Some((added, reference)) = shown {
        section.pictures(pictures(width, height, &added, &reference)?);
    }
    glare_section(lab, [width, height], &source, &threads, &mut section);
    Ok(section)
}

fn glare_section(
    lab: &Lab,
    [width, height]: [usize; 2],
    source: &[[f32; 3]],
    threads: &Threads,
    section: &mut Section,
) {
    let columns = [
        ("time", "ms"),
        ("largest error / peak", ""),
        ("direct sum", "ms"),
    ];
    let mut curve = Curve::new(
        format!("Glare against its formula ({width}x{height})"),
        columns,
    );
    let mut worst = 0f64;
    for (passes, samples) in [(1, 4), (2, 4), (3, 4), (3, 8)] {
        lab.phase(&format!("glare, {passes} passes"));
        let settings = GlareSettings {
            enabled: true,
            passes,
            samples,
            ..GlareSettings::default()
        };
        let mut scratch = GlareScratch::default();
        let mut added = vec![[0f32; 3]; source.len()];
        let seconds = take_turns(lab.rounds() * 3, &mut [()], |()| {
            added.fill([0.0; 3]);
            glare(
                source,
                width,
                height,
                &settings,
                &mut scratch,
                &mut added,
                threads,
            );
        });
        let start = clock();
        let reference = direct_glare(source, width, &settings);
        let direct_ms = (clock() - start) as f64 * 1e-6;
        let [_, _, relative] = difference(&added, &reference);
        worst = worst.max(relative);
        let plural = if passes == 1 { "" } else { "es" };
        let label = format!("{passes} pass{plural} of {samples} samples");
        curve.point("glare", label, [seconds[0] * 1e3, relative, direct_ms]);
    }
    section.prose(
        "Glare (RT2AR's formula, section IV.F) is exact up to rounding: only dark pixels are skipped.",
    );
    section.curve(curve);
    // Roundings: a product and a sum per sample, normalization, bright pass, four directions.
    section.bound(Bound::at_most(
        "glare: largest error, of the peak",
        f64::from(gamma(64)),
        worst,
        "",
    ));
    section.prose(format!(
        "The largest relative error is {}; the bound of 64 roundings is {}.",
        number(worst),
        number(f64::from(gamma(64)))
    ));
}

fn pictures(
    width: usize,
    height: usize,
    added: &[[f32; 3]],
    reference: &Plane,
) -> Result<[Picture; 3]> {
    let image = |value: &dyn Fn(usize) -> [f32; 3]| ColorImage {
        width: width as u32,
        height: height as u32,
        rgba: (0..width * height)
            .map(|i| {
                let [r, g, b] = value(i).map(srgb_from_linear);
                [r, g, b, 255]
            })
            .collect(),
    };
    let truth = image(&|i| reference[i].map(|c| c as f32));
    let result = image(&|i| added[i]);
    Ok([
        Picture::new("Light that a direct sum adds", &truth, None)?,
        Picture::new("The default: pyramid of five levels", &result, None)?,
        Picture::difference("Difference, 16 times", [&result, &truth], 16.0, None)?,
    ])
}

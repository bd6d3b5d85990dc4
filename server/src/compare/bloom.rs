//! Bloom and glare against direct sums in double precision at full resolution.

use anyhow::{Context, Result};

use super::{Axis, Bound, Curve, Lab, Picture, Section, clock, number, take_turns};
use crate::frame::ColorImage;
use crate::numerics::{gamma, srgb_from_linear};
use crate::render::cpu::bloom::{BloomScratch, bloom};
use crate::render::cpu::glare::{GlareScratch, glare};
use crate::render::{BloomMethod, BloomSettings, GlareSettings};

/// Linear light, three channels, in double precision.
type Plane = Vec<[f64; 3]>;

/// Discs of light as a mirror shows lamps, one of them soft, near and far from the border.
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

/// The light that the bright pass lets through, from its definition.
fn bright(source: &[[f32; 3]], threshold: f64, knee_share: Option<f64>) -> Plane {
    source
        .iter()
        .map(|pixel| {
            let light = pixel.map(f64::from);
            let luminance = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
            let Some(share) = knee_share else {
                // RT2AR's luminance map: the whole pixel.
                return if luminance > threshold {
                    light
                } else {
                    [0.0; 3]
                };
            };
            let (knee, over) = (threshold * share, luminance - threshold);
            let excess = if over <= -knee {
                0.0
            } else if over < knee {
                (over + knee).powi(2) / (4.0 * knee)
            } else {
                over
            };
            light.map(|c| c * excess / luminance)
        })
        .collect()
}

/// The sum over levels of what a form of bloom does to a point of light, averaged over every
/// place that the point may have between the pixels of coarser levels: one even kernel per level,
/// as its taps from the centre outwards.
fn kernels(method: BloomMethod, levels: u32) -> Vec<Vec<f64>> {
    (1..=levels)
        .map(|level| {
            let mut kernel = vec![1.0];
            match method {
                // Down by 1-3-3-1 and back by its transpose, at each level's spacing.
                BloomMethod::Pyramid => {
                    for i in 0..level {
                        for _ in 0..2 {
                            convolve(&mut kernel, &[0.125, 0.375, 0.375, 0.125], 1 << i);
                        }
                    }
                }
                // Means of 2x2 and a binomial per level; then bilinear reading.
                BloomMethod::Gaussians => {
                    for i in 0..level {
                        convolve(&mut kernel, &[0.5, 0.5], 1 << i);
                        convolve(&mut kernel, &[0.0625, 0.25, 0.375, 0.25, 0.0625], 2 << i);
                    }
                    let size = 1usize << level;
                    let tent: Vec<f64> = (0..2 * size)
                        .map(|k| {
                            let distance = (k as f64 + 0.5 - size as f64).abs();
                            (1.0 - distance / size as f64) / size as f64
                        })
                        .collect();
                    convolve(&mut kernel, &tent, 1);
                }
            }
            kernel.split_off(kernel.len() / 2)
        })
        .collect()
}

/// Convolves with taps `spacing` apart.
fn convolve(kernel: &mut Vec<f64>, taps: &[f64], spacing: usize) {
    let mut result = vec![0.0; kernel.len() + (taps.len() - 1) * spacing];
    for (i, a) in kernel.iter().enumerate() {
        for (k, b) in taps.iter().enumerate() {
            result[i + k * spacing] += a * b;
        }
    }
    *kernel = result;
}

/// Rows, then columns, of an even kernel; dark beyond the borders.
fn filter(plane: &Plane, width: usize, kernel: &[f64]) -> Plane {
    let height = plane.len() / width;
    let pass = |plane: &Plane, length: usize, at: &dyn Fn(usize, usize) -> usize, lines: usize| {
        let mut out = vec![[0.0; 3]; plane.len()];
        for line in 0..lines {
            for i in 0..length {
                let light = plane[at(line, i)];
                // Nearly all is dark: light is handed out, not gathered.
                if light == [0.0; 3] {
                    continue;
                }
                for (k, weight) in kernel.iter().enumerate() {
                    let mut put = |j: usize| {
                        for (sum, c) in out[at(line, j)].iter_mut().zip(light) {
                            *sum += c * weight;
                        }
                    };
                    if i + k < length {
                        put(i + k);
                    }
                    if k > 0 && i >= k {
                        put(i - k);
                    }
                }
            }
        }
        out
    };
    let rows = pass(plane, width, &|y, x| y * width + x, height);
    pass(&rows, height, &|x, y| y * width + x, width)
}

/// Bloom by its definition.
fn direct_bloom(source: &[[f32; 3]], width: usize, settings: &BloomSettings) -> Plane {
    let knee = match settings.method {
        BloomMethod::Pyramid => Some(f64::from(settings.knee)),
        BloomMethod::Gaussians => None,
    };
    let bright = bright(source, f64::from(settings.threshold), knee);
    let scale = f64::from(settings.intensity) / f64::from(settings.levels);
    let mut sum = vec![[0.0; 3]; source.len()];
    for kernel in kernels(settings.method, settings.levels) {
        for (sum, light) in sum.iter_mut().zip(filter(&bright, width, &kernel)) {
            for (sum, light) in sum.iter_mut().zip(light) {
                *sum += light * scale;
            }
        }
    }
    sum
}

/// Glare by its formula: pass n takes (x ± b s, y ± b s) with weight a^(b s), b = 4^(n-1).
fn direct_glare(source: &[[f32; 3]], width: usize, settings: &GlareSettings) -> Plane {
    let height = (source.len() / width) as i64;
    let start = bright(source, f64::from(settings.threshold), Some(0.0));
    let mut sum = vec![[0.0; 3]; source.len()];
    for (dx, dy) in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
        let mut plane = start.clone();
        for pass in 0..settings.passes {
            let b = 4i64.pow(pass);
            let weights: Vec<f64> = (0..i64::from(settings.samples))
                .map(|s| f64::from(settings.attenuation).powi((b * s) as i32))
                .collect();
            let total: f64 = weights.iter().sum();
            let mut next = vec![[0.0; 3]; source.len()];
            for (i, out) in next.iter_mut().enumerate() {
                let (x, y) = ((i % width) as i64, (i / width) as i64);
                for (s, weight) in (0i64..).zip(&weights) {
                    let (x, y) = (x + dx * b * s, y + dy * b * s);
                    if (0..width as i64).contains(&x) && (0..height).contains(&y) {
                        let light = plane[(y * width as i64 + x) as usize];
                        for (out, light) in out.iter_mut().zip(light) {
                            *out += light * weight / total;
                        }
                    }
                }
            }
            plane = next;
        }
        for (sum, light) in sum.iter_mut().zip(plane) {
            for (sum, light) in sum.iter_mut().zip(light) {
                *sum += light * 0.25 * f64::from(settings.intensity);
            }
        }
    }
    sum
}

/// Root mean square, largest, and largest relative to the reference's peak, of the difference.
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
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(lab.pool().current_num_threads())
        .build()
        .context("threads")?;
    let mut section = Section::new();
    section.prose(
        "Both forms of bloom shrink the picture level by level. What they approximate is the same sum of filters \
         at full resolution: each level's effect on a point of light, averaged over all places that the point may \
         have between the coarser pixels. That sum is the reference, in double precision. The error is how much a \
         highlight's bloom depends on where it falls; a moving one would shimmer by that.",
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
                    &pool,
                );
            });
            let start = clock();
            let reference = direct_bloom(&source, width, &settings);
            let reference_ms = (clock() - start) as f64 * 1e-6;
            let [rms, most, relative] = difference(&added, &reference);
            let label = match levels {
                1 => "1 level".to_owned(),
                n if n == BloomSettings::default().levels => format!("{n} levels (default)"),
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
    glare_section(lab, [width, height], &source, &pool, &mut section);
    Ok(section)
}

fn glare_section(
    lab: &Lab,
    [width, height]: [usize; 2],
    source: &[[f32; 3]],
    pool: &rayon::ThreadPool,
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
                pool,
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
        "Glare (RT2AR's formula, section IV.F) is exact but for rounding: it skips only what is dark.",
    );
    section.curve(curve);
    // A product and a sum per sample, normalisation, bright pass, four directions.
    section.bound(Bound::at_most(
        "glare: largest error, of the peak",
        f64::from(gamma(64)),
        worst,
        "",
    ));
    section.prose(format!(
        "Largest relative error {}, where {} would be the bound of 64 roundings.",
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_keep_light_and_are_even() {
        for method in [BloomMethod::Pyramid, BloomMethod::Gaussians] {
            for (level, kernel) in (1i32..).zip(kernels(method, 5)) {
                let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
                assert!((sum - 1.0).abs() < 1e-12, "{method:?}: {sum}");
                assert!(kernel.windows(2).all(|w| w[0] >= w[1]), "{method:?}");
                if method == BloomMethod::Pyramid {
                    let variance: f64 = (0i32..)
                        .zip(&kernel)
                        .map(|(k, w)| 2.0 * w * f64::from(k * k))
                        .sum();
                    // Each 1-3-3-1 at spacing s adds 3/4 s^2.
                    let expected = 0.5 * (4f64.powi(level) - 1.0);
                    assert!((variance - expected).abs() < 1e-9, "{variance}");
                }
            }
        }
    }
}

//! Reference bloom and glare from their definitions: plain sums in double precision at full resolution.

use ghostlight::render::{BloomMethod, BloomSettings, GlareSettings};

/// Linear light, three channels, in double precision.
pub(super) type Plane = Vec<[f64; 3]>;

/// The output of the bright pass, from its definition.
fn bright(source: &[[f32; 3]], threshold: f64, knee_share: Option<f64>) -> Plane {
    source
        .iter()
        .map(|pixel| {
            let light = pixel.map(f64::from);
            let luminance = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
            let Some(share) = knee_share else {
                // RT2AR's luminance map keeps the whole pixel.
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

/// For each level, the kernel with which a form of bloom spreads a point of light, averaged over every position
/// that the point may have relative to the pixels of coarser levels. Kernels are symmetric and given as taps from
/// the centre outwards.
fn kernels(method: BloomMethod, levels: u32) -> Vec<Vec<f64>> {
    (1..=levels)
        .map(|level| {
            let mut kernel = vec![1.0];
            match method {
                // Downsampling with 1-3-3-1 and upsampling with its transpose, at each level's spacing.
                BloomMethod::Pyramid => {
                    for i in 0..level {
                        for _ in 0..2 {
                            convolve(&mut kernel, &[0.125, 0.375, 0.375, 0.125], 1 << i);
                        }
                    }
                }
                // Means of 2x2 and a binomial filter per level, then bilinear sampling.
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

/// Filters rows, then columns, with a symmetric kernel; dark beyond the borders.
fn filter(plane: &Plane, width: usize, kernel: &[f64]) -> Plane {
    let height = plane.len() / width;
    let pass = |plane: &Plane, length: usize, at: &dyn Fn(usize, usize) -> usize, lines: usize| {
        let mut out = vec![[0.0; 3]; plane.len()];
        for line in 0..lines {
            for i in 0..length {
                let light = plane[at(line, i)];
                // Nearly every pixel is dark, so light is scattered from bright pixels instead of gathered.
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

/// Bloom from its definition.
pub(super) fn direct_bloom(source: &[[f32; 3]], width: usize, settings: &BloomSettings) -> Plane {
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

/// Glare from its formula: pass n adds (x ± b s, y ± b s) with weight a^(b s), b = 4^(n-1).
pub(super) fn direct_glare(source: &[[f32; 3]], width: usize, settings: &GlareSettings) -> Plane {
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
                    // Each 1-3-3-1 filter at spacing s adds a variance of 3/4 s^2.
                    let expected = 0.5 * (4f64.powi(level) - 1.0);
                    assert!((variance - expected).abs() < 1e-9, "{variance}");
                }
            }
        }
    }
}

//! Glare: star-shaped streaks around the brightest highlights, in linear light.
//!
//! RT2AR (dos Santos et al. 2012, section IV.F): `n` passes of `s` samples; in pass n, with `b = 4^(n-1)`, a
//! pixel sums the pixels (x ± b s, y ± b s) with weight `a^(b s)`, s = 0, 1, ..., once for each of the four pairs
//! of signs. Each pass reads the result of the previous one, as in Kawase's streak filter (2003): with four
//! samples per pass the offsets `b s` of all passes add up to every distance d in 0..4^n exactly once, so the
//! impulse response is `a^d` along each diagonal, a streak without gaps.
//!
//! Normalisation: each pass's weights are divided by their sum and the four directions by four, so the light
//! added is `intensity` times the light above the threshold, however long the streaks are; light that leaves the
//! picture is lost. Only the light *above* the threshold is used (not the whole pixel), so that a highlight whose
//! luminance varies around the threshold does not flicker.

use glam::Vec3A;

use super::composite::{Composite, PostPass};
use super::highlight::BrightPass;
use super::span::Span;
use crate::render::checkpoint::{Pulse, Uninterrupted};
use crate::render::settings::{GlareSettings, RenderSettings};
use crate::render::threads::{Threads, Workers};

/// Rows that one thread takes at a time.
const ROWS_AT_ONCE: usize = 16;

/// Most passes; the fifth has a step of 256 pixels.
const MAX_PASSES: u32 = 5;
/// Most samples per pass.
const MAX_SAMPLES: usize = 16;

/// Buffers that are kept between frames; nothing is allocated after the first frames.
#[derive(Debug, Default)]
pub struct GlareScratch {
    bright: Lit,
    passes: [Lit; 2],
}

/// An image of which only a span of each row is meaningful; it is dark elsewhere.
#[derive(Debug, Default)]
struct Lit {
    spans: Vec<Span>,
    px: Vec<Vec3A>,
}

/// A diagonal, as the signs of the offset from a pixel to the pixels that it reads.
#[derive(Debug, Clone, Copy)]
struct Direction {
    right: bool,
    down: bool,
}

/// Adds the glare of `source` (radiance of the virtual highlights, linear Rec.709, multiplied
/// by the mask) to `added`, both `width * height` pixels from the top row.
///
/// Returns false, with nothing written, if glare is off or nothing exceeds the threshold. The result is identical
/// for any number of threads.
///
/// # Panics
/// If a slice does not hold `width * height` pixels.
pub fn glare(
    source: &[[f32; 3]],
    width: usize,
    height: usize,
    settings: &GlareSettings,
    scratch: &mut GlareScratch,
    added: &mut [[f32; 3]],
    threads: &Threads,
) -> bool {
    let pulse = &Pulse::new(&Uninterrupted);
    let workers = Workers { threads, pulse };
    glare_while(source, width, height, settings, scratch, added, workers)
}

/// [`glare`] that returns early, with nothing meaningful written, if the frame is cancelled.
pub(crate) fn glare_while(
    source: &[[f32; 3]],
    width: usize,
    height: usize,
    settings: &GlareSettings,
    scratch: &mut GlareScratch,
    added: &mut [[f32; 3]],
    workers: Workers<'_>,
) -> bool {
    assert_eq!(source.len(), width * height, "source of {width}x{height}");
    assert_eq!(added.len(), width * height, "added of {width}x{height}");
    if !settings.enabled || settings.intensity <= 0.0 {
        return false;
    }
    let pass = BrightPass::knee(settings.threshold, 0.0);
    let GlareScratch { bright, passes } = scratch;
    pass.spans(source, width, &mut bright.spans, workers);
    if bright.spans.iter().all(|span| span.is_empty()) {
        return false;
    }
    bright.px.resize(width * height, Vec3A::ZERO);
    for_rows(
        &bright.spans,
        &mut bright.px,
        width,
        workers,
        |y, span, row| {
            let source = &source[y * width..][..width];
            for x in span.start..span.end {
                row[x] = pass.filter(source[x]);
            }
        },
    );
    let share = settings.intensity * 0.25;
    for down in [false, true] {
        for right in [false, true] {
            let direction = Direction { right, down };
            let [result, previous] = passes;
            streak(bright, result, width, direction, 1, settings, workers);
            for n in 2..=settings.passes.clamp(1, MAX_PASSES) {
                if !workers.pulse.go_on() {
                    return false;
                }
                std::mem::swap(result, previous);
                streak(previous, result, width, direction, n, settings, workers);
            }
            for_rows(&result.spans, added, width, workers, |y, span, row| {
                let light = &result.px[y * width..][..width];
                for x in span.start..span.end {
                    let light = light[x] * share;
                    row[x][0] += light.x;
                    row[x][1] += light.y;
                    row[x][2] += light.z;
                }
            });
        }
    }
    true
}

/// Calls `work` with each row of an image that has a span, and the row's number; stops if the frame is cancelled.
fn for_rows<T: Send>(
    spans: &[Span],
    pixels: &mut [T],
    width: usize,
    workers: Workers<'_>,
    work: impl Fn(usize, Span, &mut [T]) + Sync,
) {
    let bands = spans.chunks(ROWS_AT_ONCE);
    let bands = bands.zip(pixels.chunks_mut(width * ROWS_AT_ONCE));
    workers.for_each(bands.enumerate(), |(band, (spans, pixels))| {
        for (i, (&span, row)) in spans.iter().zip(pixels.chunks_mut(width)).enumerate() {
            if !span.is_empty() && workers.pulse.go_on() {
                work(band * ROWS_AT_ONCE + i, span, row);
            }
        }
    });
}

/// One pass: `to(x, y) = sum over s of w_s from(x ± b s, y ± b s)`.
fn streak(
    from: &Lit,
    to: &mut Lit,
    width: usize,
    direction: Direction,
    pass: u32,
    settings: &GlareSettings,
    workers: Workers<'_>,
) {
    let height = from.spans.len();
    let step = 4usize.pow(pass - 1);
    let weights = weights(settings, step);
    // The weights of far steps may be zero: 0.85^(256 * 5) is below the smallest float.
    let n = weights.iter().take_while(|&&weight| weight > 0.0).count();
    let weights = &weights[..n];
    // The columns of `from` that columns of `to` read, `offset` pixels away, in coordinates of `to`; and the row.
    let columns = |span: Span, offset: usize| {
        let (start, end) = if direction.right {
            (
                span.start.saturating_sub(offset),
                span.end.saturating_sub(offset),
            )
        } else {
            (
                (span.start + offset).min(width),
                (span.end + offset).min(width),
            )
        };
        Span { start, end }
    };
    let row_of = |y: usize, offset: usize| {
        if direction.down {
            Some(y + offset).filter(|&y| y < height)
        } else {
            y.checked_sub(offset)
        }
    };
    to.spans.clear();
    to.spans.extend((0..height).map(|y| {
        (0..weights.len()).fold(Span::default(), |all, s| {
            let offset = s * step;
            let Some(source) = row_of(y, offset) else {
                return all;
            };
            all.union(columns(from.spans[source], offset))
        })
    }));
    to.px.resize(width * height, Vec3A::ZERO);
    for_rows(&to.spans, &mut to.px, width, workers, |y, span, row| {
        row[span.start..span.end].fill(Vec3A::ZERO);
        for (s, &weight) in weights.iter().enumerate() {
            let offset = s * step;
            let Some(source) = row_of(y, offset) else {
                continue;
            };
            let target = columns(from.spans[source], offset);
            if target.is_empty() {
                continue;
            }
            let start = if direction.right {
                target.start + offset
            } else {
                target.start - offset
            };
            let light = &from.px[source * width + start..];
            for (sum, &light) in row[target.start..target.end].iter_mut().zip(light) {
                *sum += light * weight;
            }
        }
    });
}

/// `a^(b s)` for each sample, divided by their sum; zero from the number of samples on.
fn weights(settings: &GlareSettings, step: usize) -> [f32; MAX_SAMPLES] {
    let attenuation = f64::from(settings.attenuation.clamp(0.0, 1.0));
    let samples = (settings.samples as usize).clamp(1, MAX_SAMPLES);
    let weight = |s: usize| attenuation.powi((s * step) as i32);
    let sum: f64 = (0..samples).map(weight).sum();
    std::array::from_fn(|s| {
        if s < samples {
            (weight(s) / sum) as f32
        } else {
            0.0
        }
    })
}

/// Glare as a post pass.
#[derive(Default)]
pub(crate) struct GlarePass(GlareScratch);

impl PostPass for GlarePass {
    fn run(&mut self, settings: &RenderSettings, composite: &mut Composite<'_>) {
        let glare = &settings.glare;
        if !glare.enabled || composite.virtual_peak() <= glare.threshold {
            return;
        }
        let [width, height] = composite.size();
        composite.add(|light, added, workers| {
            glare_while(light, width, height, glare, &mut self.0, added, workers)
        });
    }
}

#[cfg(test)]
mod tests;

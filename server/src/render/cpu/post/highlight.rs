//! Extracts the light that bloom and glare spread: light above a luminance threshold.

use glam::Vec3A;

use crate::numerics::luminance;
use crate::render::threads::Workers;

use super::span::Span;

/// Largest value of a channel of a highlight, in units of display white: the largest half float. NaN and negative
/// light count as zero. Keeps every sum of bloom and glare finite.
pub const MAX_HIGHLIGHT: f32 = 65_504.0;

/// Pixels examined at a time when looking for highlights.
const SCAN_PX: usize = 32;

/// Pictures with fewer pixels are examined on one thread.
const SERIAL_PX: usize = 16_384;

/// The part of a pixel's light that passes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BrightPass {
    /// Luminance at which the pass begins.
    start: f32,
    threshold: f32,
    /// Half width of the quadratic knee around the threshold.
    knee: f32,
    /// Whether the whole pixel passes, instead of the light above the threshold.
    whole: bool,
}

impl BrightPass {
    /// Passes all the light of pixels above a threshold, like RT2AR's luminance map.
    pub(crate) fn whole(threshold: f32) -> Self {
        Self {
            start: threshold,
            threshold,
            knee: 0.0,
            whole: true,
        }
    }

    /// Passes the light above a threshold. Within `share * threshold` on both sides of it, the excess is a
    /// parabola that joins both straight parts smoothly, so that a highlight whose luminance varies around the
    /// threshold does not flicker.
    pub(crate) fn knee(threshold: f32, share: f32) -> Self {
        let knee = threshold * share.clamp(0.0, 1.0);
        Self {
            start: threshold - knee,
            threshold,
            knee,
            whole: false,
        }
    }

    /// The part of a pixel's light that passes; zero at and below the start.
    #[inline]
    pub(crate) fn filter(&self, pixel: [f32; 3]) -> Vec3A {
        // False for NaN as well.
        let measured = |c: f32| if c > 0.0 { c.min(MAX_HIGHLIGHT) } else { 0.0 };
        let light = Vec3A::from_array(pixel.map(measured));
        let luminance = luminance(light);
        // With a NaN threshold nothing passes.
        if luminance <= self.start || self.start.is_nan() {
            return Vec3A::ZERO;
        }
        if self.whole {
            return light;
        }
        let over = luminance - self.threshold;
        let excess = if over < self.knee {
            let rise = over + self.knee;
            rise * rise / (4.0 * self.knee)
        } else {
            over
        };
        light * (excess / luminance)
    }

    /// For each row, the pixels from the first to the last that pass.
    pub(crate) fn spans(
        &self,
        source: &[[f32; 3]],
        width: usize,
        spans: &mut Vec<Span>,
        workers: Workers<'_>,
    ) {
        spans.clear();
        if width == 0 {
            return;
        }
        spans.resize(source.len() / width, Span::default());
        let rows = SERIAL_PX.div_ceil(width);
        let bands = spans.chunks_mut(rows).zip(source.chunks(rows * width));
        workers.for_each(bands, |(spans, source)| {
            for (span, row) in spans.iter_mut().zip(source.chunks(width)) {
                *span = self.span(row);
            }
        });
    }

    fn span(&self, row: &[[f32; 3]]) -> Span {
        let mut span = Span::default();
        for (chunk, pixels) in row.chunks(SCAN_PX).enumerate() {
            // Luminance is a mean of the channels, so it is over the start only if one of
            // them is; that test runs over whole vectors. (The weights may sum to 1 + 1 ulp.)
            let any = pixels
                .as_flattened()
                .iter()
                .fold(false, |any, &c| any | (c >= self.start));
            if !any {
                continue;
            }
            for (i, &pixel) in pixels.iter().enumerate() {
                if self.filter(pixel) != Vec3A::ZERO {
                    let x = chunk * SCAN_PX + i;
                    if span.is_empty() {
                        span.start = x;
                    }
                    span.end = x + 1;
                }
            }
        }
        span
    }
}

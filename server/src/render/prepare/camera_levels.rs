//! Mipmap levels of the camera's picture, linear, for rough reflections.

use glam::Vec3A;

use crate::frame::ColorImage;
use crate::numerics::linear_from_srgb;
use crate::render::threads::Workers;

/// Number of levels in addition to the picture itself; a look-up covers at most 2^LEVELS pixels.
const LEVELS: usize = 6;

/// Rows of a level that one thread computes at a time.
const ROWS_AT_ONCE: usize = 16;

/// A level: half as wide and high as the previous one.
#[derive(Debug, Clone, Default)]
struct Level {
    width: usize,
    height: usize,
    texels: Vec<Vec3A>,
}

/// Buffers are kept between frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct CameraLevels {
    levels: Vec<Level>,
}

impl CameraLevels {
    /// Computes the levels of a new picture; rows in parallel, until the frame is cancelled.
    pub(crate) fn rebuild(&mut self, color: &ColorImage, workers: Workers<'_>) {
        self.levels.resize_with(LEVELS, Level::default);
        let (width, height) = (color.width as usize, color.height as usize);
        let pixel = |x: usize, y: usize| {
            let [r, g, b, _] = color.rgba[y * width + x];
            Vec3A::from_array([r, g, b].map(linear_from_srgb))
        };
        self.levels[0].fill(width, height, workers, pixel);
        for i in 1..LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(i);
            let finer = &finer[i - 1];
            let texel = |x: usize, y: usize| finer.texels[y * finer.width + x];
            coarser[0].fill(finer.width, finer.height, workers, texel);
        }
    }

    /// Mean over a square of `width_px` pixels around a position of the picture; `width_px` is above two.
    pub(crate) fn lookup(&self, u: f32, v: f32, width_px: f32) -> Vec3A {
        let lod = (width_px.max(2.0).log2() - 1.0).min((LEVELS - 1) as f32);
        let fine = lod as usize;
        let coarse = (fine + 1).min(LEVELS - 1);
        let [a, b] = [fine, coarse].map(|i| self.levels[i].lookup(u, v, i));
        a.lerp(b, lod.fract())
    }
}

impl Level {
    /// Means of 2x2 pixels of a finer level of the given size; at an odd edge, of the existing ones.
    fn fill(
        &mut self,
        w: usize,
        h: usize,
        workers: Workers<'_>,
        finer: impl Fn(usize, usize) -> Vec3A + Sync,
    ) {
        (self.width, self.height) = (w.div_ceil(2).max(1), h.div_ceil(2).max(1));
        self.texels.resize(self.width * self.height, Vec3A::ZERO);
        let width = self.width;
        let bands = self.texels.chunks_mut(width * ROWS_AT_ONCE).enumerate();
        workers.for_each(bands, |(band, texels)| {
            for (i, texel) in texels.iter_mut().enumerate() {
                let (x, y) = (i % width, band * ROWS_AT_ONCE + i / width);
                let ys = [2 * y, (2 * y + 1).min(h - 1)];
                let xs = [2 * x, (2 * x + 1).min(w - 1)];
                let mean = |y: usize| (finer(xs[0], y) + finer(xs[1], y)) * 0.5;
                *texel = (mean(ys[0]) + mean(ys[1])) * 0.5;
            }
        });
    }

    /// Bilinear interpolation at a position of the picture, in the level with index `index`.
    fn lookup(&self, u: f32, v: f32, index: usize) -> Vec3A {
        let scale = (2 << index) as f32;
        let place = |x: f32, n: usize| {
            let x = ((x + 0.5) / scale - 0.5).clamp(0.0, (n - 1) as f32);
            // NaN becomes 0.
            let first = (x as usize).min(n - 1);
            (first, (first + 1).min(n - 1), x - first as f32)
        };
        let (x0, x1, fx) = place(u, self.width);
        let (y0, y1, fy) = place(v, self.height);
        let at = |x: usize, y: usize| self.texels[y * self.width + x];
        at(x0, y0)
            .lerp(at(x1, y0), fx)
            .lerp(at(x0, y1).lerp(at(x1, y1), fx), fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::threads::with_workers;

    #[test]
    fn levels_are_means_at_their_places() {
        let mut levels = CameraLevels::default();
        for (w, h) in [(64, 48), (1, 1), (7, 5)] {
            let color = ColorImage::filled(w, h, [188, 188, 188, 255]);
            with_workers(2, |workers| levels.rebuild(&color, workers));
            for width in [2.0, 3.0, 17.0, 1e6, f32::INFINITY] {
                let got = levels.lookup(0.0, 0.0, width).x;
                assert!(
                    (got - linear_from_srgb(188)).abs() < 1e-6,
                    "{w}x{h} {width}"
                );
            }
        }
        // Half black, half white, with look-ups on the border: the result is half, whatever the width.
        let mut color = ColorImage::filled(64, 64, [0, 0, 0, 255]);
        for (i, pixel) in color.rgba.iter_mut().enumerate() {
            if i % 64 >= 32 {
                *pixel = [255; 4];
            }
        }
        with_workers(2, |workers| levels.rebuild(&color, workers));
        for width in [2.0, 4.0, 11.0, 16.0] {
            let got = levels.lookup(31.5, 20.0, width).x;
            assert!((got - 0.5).abs() < 1e-5, "{width}: {got}");
        }
        assert_eq!(levels.lookup(50.0, 20.0, 4.0).x, 1.0);
    }
}

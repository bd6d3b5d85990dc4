//! Finds where a lens ray hits the real scene.
//!
//! The scene is the depth map that primary rays use, one flat piece per pixel, so that a lens of zero aperture
//! sees the same as the pinhole. A ray crosses it as a straight line in inverse depth that is shorter than its
//! circle of confusion is wide. Neighbours on one surface are joined by a wall. Where a ray passes behind the
//! edge of a nearer surface, the surface that it was over is extended behind the edge, as in hole filling;
//! otherwise objects behind a wall would be visible beside everything in front of it. In a hole the surface is
//! extended as well.

use crate::ghost::Connection;
use crate::render::prepare::lens::Track;

/// Depth per pixel, NaN in holes, and which neighbours are one surface.
#[derive(Clone, Copy)]
pub(crate) struct DepthSurface<'a> {
    pub(crate) depth: &'a [f32],
    /// Size of the picture, pixels.
    pub(crate) size: [u32; 2],
    pub(crate) connection: Connection,
}

/// A point of the real scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crossing {
    /// Depth at which the ray hits it, metres.
    pub(crate) z: f32,
    /// Pixel that shows the point.
    pub(crate) x: u32,
    pub(crate) y: u32,
}

/// The flat piece of one pixel.
#[derive(Clone, Copy)]
struct Piece {
    z: f32,
    x: u32,
    y: u32,
}

impl DepthSurface<'_> {
    /// The first crossing of a ray between the depths `near`, where nothing is in front of it yet, and `far`.
    pub(crate) fn first_crossing(&self, track: &Track, near: f32, far: f32) -> Option<Crossing> {
        let end_w = 1.0 / far;
        // Rounded up, so that a piece at exactly `near` is in front of the ray's start.
        let start_w = self.enters(track, (1.0 + 4.0 * f32::EPSILON) / near);
        let length = start_w - end_w;
        if length.is_nan() || length <= 0.0 {
            return None;
        }
        let at = |axis: usize| track.start[axis] + track.step[axis] * start_w + 0.5;
        let place = [at(0), at(1)];
        let mut pixel = place.map(|p| p.floor() as i32);
        // For each axis: the direction of the ray, the inverse depth that crossing a pixel takes, and where the
        // first pixel ends. The ray recedes, so inverse depth decreases along it.
        let mut way = [0; 2];
        let mut width = [f32::INFINITY; 2];
        let mut first = [f32::INFINITY; 2];
        for axis in 0..2 {
            let step = -track.step[axis];
            let inside = place[axis] - place[axis].floor();
            if step > 0.0 {
                (way[axis], width[axis]) = (1, 1.0 / step);
                first[axis] = (1.0 - inside) / step;
            } else if step < 0.0 {
                (way[axis], width[axis]) = (-1, -1.0 / step);
                first[axis] = -inside / step;
            }
        }
        let mut next = first;
        let mut crossed = [0_u16; 2];
        let mut over: Option<Piece> = None;
        let mut gone = 0.0;
        // Each iteration enters another pixel of the picture, or is the last one.
        loop {
            let w = start_w - gone;
            if let Some(piece) = self.piece(pixel) {
                if piece.z * w >= 1.0 {
                    over = Some(piece);
                } else if let Some(before) = over
                    && self.connection.joins(before.z, piece.z)
                {
                    return Some(Crossing {
                        z: 1.0 / w,
                        x: piece.x,
                        y: piece.y,
                    });
                }
            }
            let axis = usize::from(next[1] < next[0]);
            let outside = (0..2).any(|axis| match way[axis] {
                0 => false,
                1 => pixel[axis] >= self.size[axis] as i32,
                _ => pixel[axis] < 0,
            });
            // False for NaN.
            let goes_on = !outside && next[axis] < length;
            let leaves = if goes_on { next[axis] } else { length };
            if let Some(Piece { z, x, y }) = over
                && z * (start_w - leaves) <= 1.0
            {
                return Some(Crossing { z, x, y });
            }
            if !goes_on {
                return None;
            }
            gone = leaves;
            pixel[axis] += way[axis];
            crossed[axis] += 1;
            // Computed by multiplication, because a sum may stop growing by rounding.
            next[axis] = first[axis] + f32::from(crossed[axis]) * width[axis];
        }
    }

    /// The inverse depth, at most `w`, at which a ray enters the picture.
    fn enters(&self, track: &Track, w: f32) -> f32 {
        (0..2).fold(w, |w, axis| {
            let (start, step) = (track.start[axis], track.step[axis]);
            let border = if step > 0.0 {
                self.size[axis] as f32 - 0.5
            } else {
                -0.5
            };
            let outside = (start + step * w - border) * step > 0.0;
            if outside { (border - start) / step } else { w }
        })
    }

    fn piece(&self, [x, y]: [i32; 2]) -> Option<Piece> {
        let [x, y] = [u32::try_from(x).ok()?, u32::try_from(y).ok()?];
        let [width, height] = self.size;
        if x >= width || y >= height {
            return None;
        }
        let z = self.depth[(y * width + x) as usize];
        (!z.is_nan()).then_some(Piece { z, x, y })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ghost::GhostSettings;

    const SIZE: [u32; 2] = [40, 30];

    fn sheet(depth: &[f32]) -> DepthSurface<'_> {
        DepthSurface {
            depth,
            size: SIZE,
            connection: Connection::new(&GhostSettings::default()),
        }
    }

    fn map(z: impl Fn(u32, u32) -> f32) -> Vec<f32> {
        let [width, height] = SIZE;
        (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| z(x, y))
            .collect()
    }

    /// Through pixel (20, 15) at depth 2, `step` pixels per inverse metre.
    fn track(step: [f32; 2]) -> Track {
        Track {
            start: [20.0 - step[0] * 0.5, 15.0 - step[1] * 0.5],
            step,
        }
    }

    #[test]
    fn a_ray_that_stays_in_its_pixel_sees_what_the_pinhole_sees() {
        let depth = map(|x, _| if x < 20 { 1.0 } else { 2.0 });
        let sheet = sheet(&depth);
        let still = track([0.0, 0.0]);
        assert_eq!(
            sheet.first_crossing(&still, 1.0, 3.0),
            Some(Crossing {
                z: 2.0,
                x: 20,
                y: 15
            })
        );
        assert_eq!(sheet.first_crossing(&still, 1.0, 1.9), None);
        let hole = map(|_, _| f32::NAN);
        assert_eq!(
            super::tests::sheet(&hole).first_crossing(&still, 1.0, 3.0),
            None
        );
    }

    /// A wall at 1 m left of column 20, another at 2 m right of it. A ray from the left hits the nearer wall if
    /// it is still over it at 1 m; one from the right passes behind it.
    #[test]
    fn a_ray_meets_what_it_is_over_and_passes_behind_rims() {
        let depth = map(|x, _| if x < 20 { 1.0 } else { 2.0 });
        let sheet = sheet(&depth);
        let crossing = |step: f32, far| sheet.first_crossing(&track([step, 0.0]), 0.5, far);
        // At 1 m it is at pixel 20 + step / 2.
        assert_eq!(
            crossing(-6.0, 3.0),
            Some(Crossing {
                z: 1.0,
                x: 17,
                y: 15
            })
        );
        assert_eq!(
            crossing(6.0, 3.0),
            Some(Crossing {
                z: 2.0,
                x: 20,
                y: 15
            })
        );
        // It is at pixel 18.5 at 4 m: beyond the edge the far wall is extended, which was last visible in column
        // 20.
        let aside = Track {
            start: [17.0, 15.0],
            step: [6.0, 0.0],
        };
        let met = sheet.first_crossing(&aside, 0.5, 4.0);
        assert_eq!(
            met,
            Some(Crossing {
                z: 2.0,
                x: 20,
                y: 15
            })
        );
        // In front of the far wall, behind the near one: nothing blocks it.
        let behind = Track {
            start: [15.0, 15.0],
            step: [6.0, 0.0],
        };
        assert_eq!(sheet.first_crossing(&behind, 0.5, 1.19), None);
    }

    /// A slope of 1 cm per pixel is one surface: no ray passes between its pixels. The hit is on the slope to
    /// within the step of a pixel.
    #[test]
    fn a_slope_is_tight_in_every_direction() {
        for slope in [0.01, -0.01, 0.03] {
            let depth = map(|x, y| 1.5 + slope * (x as f32 - 20.0) + 0.005 * (y as f32 - 15.0));
            let sheet = sheet(&depth);
            for i in 0..64 {
                let (sin, cos) = (i as f32 * 0.1).sin_cos();
                let ray = track([20.0 * cos, 20.0 * sin]);
                let Some(met) = sheet.first_crossing(&ray, 0.8, 10.0) else {
                    panic!("{slope}, {i}: slipped through");
                };
                let at = |axis: usize| ray.start[axis] + ray.step[axis] / met.z;
                let exact = 1.5 + slope * (at(0) - 20.0) + 0.005 * (at(1) - 15.0);
                let step = 2.0 * (slope.abs() + 0.005);
                assert!(
                    (met.z - exact).abs() <= step,
                    "{slope}, {i}: {} {exact}",
                    met.z
                );
                assert!((at(0) - met.x as f32).abs() <= 1.5, "{slope}, {i}");
                assert!((at(1) - met.y as f32).abs() <= 1.5, "{slope}, {i}");
            }
        }
    }
}

//! Depth where the sensor measured none, for the occlusion of primary rays only.

use crate::frame::{DepthImage, is_valid_depth};

/// How far a hole's depth is looked for, pixels. A structured-light sensor's shadow is
/// `focal * baseline * (1/near - 1/far)` wide: 575 px and 75 mm at 0.8 m before a far wall
/// give 54 px.
pub const FILL_REACH_PX: u32 = 64;

/// A depth map whose holes are filled.
#[derive(Debug, Clone, Default)]
pub struct FilledDepth {
    /// Depth per pixel, metres; NaN where nothing is in reach.
    pub z_m: Vec<f32>,
    /// Nearest valid depth before the hole last met in each column, and its row.
    columns: Vec<(f32, usize)>,
}

/// Pixels looked at together: most have no hole among them.
const RUN: usize = 16;

impl FilledDepth {
    /// Fills holes: each invalid pixel takes the farthest of the nearest valid depths to its left,
    /// right, above and below within [`FILL_REACH_PX`]; it stays invalid if there is none. The
    /// farthest, because such a sensor's holes lie on the background beside an edge. Two passes
    /// over the image, whatever the holes' sizes; allocates only for a larger image than before.
    pub fn rebuild(&mut self, depth: &DepthImage) {
        let (width, height) = (depth.width as usize, depth.height as usize);
        self.z_m.clear();
        self.z_m.extend_from_slice(&depth.z_m);
        if width == 0 {
            return;
        }
        for backward in [false, true] {
            self.columns.clear();
            self.columns.resize(width, (DepthImage::INVALID, 0));
            for row in 0..height {
                let y = if backward { height - 1 - row } else { row };
                self.fill_row(depth, y, row, backward);
            }
        }
    }

    /// Row y, the `row`-th in this pass. What a hole takes is found at the pixel before it, or
    /// else at the hole that this one was.
    fn fill_row(&mut self, depth: &DepthImage, y: usize, row: usize, backward: bool) {
        let width = depth.width as usize;
        let line = &depth.z_m[y * width..(y + 1) * width];
        let before = (row > 0).then(|| {
            let y = if backward { y + 1 } else { y - 1 };
            &depth.z_m[y * width..(y + 1) * width]
        });
        let mut along = (DepthImage::INVALID, 0);
        for first in (0..width).step_by(RUN) {
            let last = (first + RUN).min(width);
            let run = if backward {
                &line[width - last..width - first]
            } else {
                &line[first..last]
            };
            if run.iter().all(|&z| is_valid_depth(z)) {
                continue;
            }
            for step in first..last {
                let x = if backward { width - 1 - step } else { step };
                if is_valid_depth(line[x]) {
                    continue;
                }
                if step > 0 {
                    let z = line[if backward { x + 1 } else { x - 1 }];
                    if is_valid_depth(z) {
                        along = (z, step - 1);
                    }
                }
                if let Some(&z) = before.map(|before| &before[x])
                    && is_valid_depth(z)
                {
                    self.columns[x] = (z, row - 1);
                }
                for ((z, seen), now) in [(along, step), (self.columns[x], row)] {
                    let filled = &mut self.z_m[y * width + x];
                    // A NaN in `filled` is replaced, a NaN in `z` never taken.
                    if now - seen <= FILL_REACH_PX as usize && !z.is_nan() {
                        *filled = filled.max(z);
                    }
                }
            }
        }
    }
}

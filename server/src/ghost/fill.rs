//! Fills holes of the depth map, for the occlusion of primary rays only.

use crate::frame::{DepthImage, is_valid_depth};

/// Search distance for a hole's depth, pixels. The shadow of a structured-light sensor is `focal * baseline *
/// (1/near - 1/far)` wide: with 575 px and 75 mm, an object at 0.8 m in front of a far wall gives 54 px.
pub const FILL_REACH_PX: u32 = 64;

/// A depth map whose holes are filled.
#[derive(Debug, Clone, Default)]
pub struct FilledDepth {
    /// Depth per pixel, metres; NaN if no valid depth is in reach.
    pub z_m: Vec<f32>,
    /// For each column, the valid depth just before the last hole of the pass, and its row.
    columns: Vec<(f32, usize)>,
}

/// Pixels that are tested together; most runs have no hole.
const RUN: usize = 16;

impl FilledDepth {
    /// Fills holes: each invalid pixel takes the farthest of the nearest valid depths to its left, right, above
    /// and below within [`FILL_REACH_PX`]; it stays invalid if there is none. The farthest is taken because holes
    /// of such a sensor are on the background beside an edge. Takes two passes over the image, whatever the sizes
    /// of the holes; allocates only if the image is larger than before.
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

    /// Fills row y, the `row`-th of this pass. A hole's depth is that of the pixel before it, or the one stored
    /// for the hole to which it belongs.
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
                    // A NaN in `filled` is replaced; a NaN in `z` is never used.
                    if now - seen <= FILL_REACH_PX as usize && !z.is_nan() {
                        *filled = filled.max(z);
                    }
                }
            }
        }
    }
}

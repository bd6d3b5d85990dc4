//! Depth where the sensor measured none, for the occlusion of primary rays only.

use crate::frame::{DepthImage, is_valid_depth};

/// How far a hole's depth is looked for, pixels. A structured-light sensor's shadow is
/// `focal * baseline * (1/near - 1/far)` wide: 575 px and 75 mm at 0.8 m before a far wall
/// give 54 px.
pub const FILL_REACH_PX: u32 = 64;

/// Fills holes: each invalid pixel takes the farthest of the nearest valid depths to its left,
/// right, above and below within [`FILL_REACH_PX`]; it stays invalid if there is none. The
/// farthest, because such a sensor's holes lie on the background beside an edge. Two passes
/// over the image, whatever the holes' sizes. `out` gets one depth per pixel, metres.
pub fn fill_holes(depth: &DepthImage, out: &mut Vec<f32>) {
    let (width, height) = (depth.width as usize, depth.height as usize);
    out.clear();
    out.extend_from_slice(&depth.z_m);
    if width == 0 {
        return;
    }
    // Nearest valid depth seen so far in each column, and its row.
    let mut columns = vec![(DepthImage::INVALID, 0usize); width];
    for backward in [false, true] {
        columns.fill((DepthImage::INVALID, 0));
        for row in 0..height {
            let y = if backward { height - 1 - row } else { row };
            let mut along = (DepthImage::INVALID, 0usize);
            for step in 0..width {
                let x = if backward { width - 1 - step } else { step };
                let z = depth.z_m[y * width + x];
                if is_valid_depth(z) {
                    along = (z, step);
                    columns[x] = (z, row);
                    continue;
                }
                for ((z, seen), now) in [(along, step), (columns[x], row)] {
                    let filled = &mut out[y * width + x];
                    // A NaN in `filled` is replaced, a NaN in `z` never taken.
                    if now - seen <= FILL_REACH_PX as usize && !z.is_nan() {
                        *filled = filled.max(z);
                    }
                }
            }
        }
    }
}

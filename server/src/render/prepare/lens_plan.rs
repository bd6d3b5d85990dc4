//! Decides which tiles a lens with an aperture affects. Other tiles are rendered as with a pinhole.

use crate::render::checkpoint::Pulse;

use super::lens::{Lens, SHARP_PX};
use super::tile_plan::{TILE, TileGrid, TilePlan};

/// Plans the lens for tiles whose own depths, lights and objects are known.
pub(crate) fn plan_lens(lens: &Lens, grid: &TileGrid, plans: &mut [TilePlan], pulse: &Pulse<'_>) {
    let (columns, rows) = (grid.columns as usize, grid.rows as usize);
    for row in 0..rows {
        if !pulse.go_on() {
            return;
        }
        for column in 0..columns {
            let from = plans[row * columns + column];
            if from.near > from.far {
                continue;
            }
            // Surfaces in a tile can be hit by lens rays of pixels up to its blur away; these rays start up to
            // half a pixel off their centres and read whole pixels.
            let blur = lens.blur_between_px(from.near, from.far);
            let reach = ((blur + 2.0) / TILE as f32)
                .ceil()
                .min(columns.max(rows) as f32) as usize;
            let changed = !from.lights.is_empty() || from.has_photons;
            let blurred = changed && blur >= SHARP_PX;
            for y in row.saturating_sub(reach)..(row + reach + 1).min(rows) {
                for x in column.saturating_sub(reach)..(column + reach + 1).min(columns) {
                    let to = &mut plans[y * columns + x].lens;
                    to.near = to.near.min(from.near);
                    to.far = to.far.max(from.far);
                    to.gathers |= blurred;
                }
            }
        }
    }
    for plan in plans {
        // A real surface in front of an object in focus may be out of focus.
        let rim = plan.lens.near;
        plan.lens.rays = plan.sees_objects
            && (plan.object_blur_px >= SHARP_PX
                || (rim < plan.object_far_m && lens.blur_px(rim) >= SHARP_PX));
    }
}

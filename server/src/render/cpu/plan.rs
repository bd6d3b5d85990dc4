//! The plan stage: plans every tile in parallel and lists the tiles to be traced.

use crate::render::prepare::lens_plan::plan_lens;
use crate::render::prepare::tile_plan::{Reach, TILE, TileGrid, TilePlan};
use crate::render::threads::Workers;

use super::photons::PhotonMap;
use super::tile::Tile;

/// Plans the frame: `tiles` are those to be traced; empty for a cancelled frame.
pub(crate) fn plan_tiles(
    reach: &Reach<'_>,
    photons: Option<&PhotonMap>,
    workers: Workers<'_>,
    plans: &mut Vec<TilePlan>,
    grid: &mut TileGrid,
    tiles: &mut Vec<Tile>,
) {
    let [width, height] = reach.size;
    grid.reset(width, height);
    tiles.clear();
    let columns = grid.columns as usize;
    plans.clear();
    plans.resize(columns * grid.rows as usize, TilePlan::default());
    let bounds = |column: u32, row: u32| {
        let (x0, y0) = (column * TILE, row * TILE);
        [x0, y0, (x0 + TILE).min(width), (y0 + TILE).min(height)]
    };
    if !plans.is_empty() {
        let rows = plans.chunks_mut(columns).enumerate();
        workers.for_each(rows, |(row, plans)| {
            for (column, plan) in plans.iter_mut().enumerate() {
                if !reach.pulse.go_on() {
                    return;
                }
                let (column, row) = (column as u32, row as u32);
                *plan = reach.plan(bounds(column, row));
                plan.has_photons = photons.is_some_and(|map| map.reaches(column, row));
            }
        });
    }
    if let Some(lens) = reach.lens {
        plan_lens(lens, grid, plans, reach.pulse);
    }
    for row in 0..grid.rows {
        if !reach.pulse.go_on() {
            tiles.clear();
            return;
        }
        for column in 0..grid.columns {
            let plan = plans[row as usize * columns + column as usize];
            let reached = plan.sees_objects || plan.has_photons || plan.lens.gathers;
            let reached = reached || plan.has_ambient;
            if !reached && plan.lights.is_empty() {
                continue;
            }
            let [x0, y0, x1, y1] = bounds(column, row);
            grid.set(column, row, tiles.len());
            tiles.push(Tile {
                x0,
                y0,
                width: x1 - x0,
                height: y1 - y0,
                sees_objects: plan.sees_objects,
                lights: plan.lights,
                glass: plan.glass,
                has_photons: plan.has_photons,
                has_ambient: plan.has_ambient,
                lens: plan.lens,
            });
        }
    }
}

//! Ambient light of virtual surfaces: light from nearby surfaces in place of that of the surroundings.
//!
//! The irradiance of an environment map or estimate is valid for a point in the open. Close to a table, or in a
//! fold of its own mesh, a surface sees these instead. Rays over its hemisphere give the difference, at one point
//! of every cell; it is interpolated as on real surfaces, but no pixel is gathered individually.

use glam::Vec3A;

use crate::accel::{Hit, Ray};
use crate::ghost::GhostOutcome;

use crate::render::cpu::light_field::SurfaceLight;
use crate::render::cpu::tile::{PrimaryHit, PrimaryTile, Tile};
use crate::render::prepare::mask::MASK_VIRTUAL_ANY;
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::TILE;

use super::around::{around, taps};
use super::gather::Scene;
use super::input::{AmbientInput, CELL, TILE_CELLS};

/// Heuristic: spread of normals in the weight, as in [`super::cell`]; a normal rotated by about 50 degrees counts
/// as an error of one.
const NORMAL_SPREAD: f32 = 0.6;

/// Heuristics: a record exactly at a point has a hundred times the weight of one with an error of 1; and a record
/// at the end of the tent still counts if no other is on the same object.
const LEAST_ERROR: f32 = 1e-2;
const LEAST_TENT: f32 = 1e-3;

/// The record of a cell on a virtual surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ObjectCell {
    /// Index of the object; `u32::MAX` if the cell shows none.
    instance: u32,
    point: Vec3A,
    normal: Vec3A,
    /// Irradiance minus that of the surroundings.
    delta: Vec3A,
    /// Harmonic mean distance to the hits of its rays, metres.
    apart_m: f32,
}

impl ObjectCell {
    pub(crate) const NONE: Self = Self {
        instance: u32::MAX,
        point: Vec3A::ZERO,
        normal: Vec3A::ZERO,
        delta: Vec3A::ZERO,
        apart_m: 0.0,
    };

    /// Ward's weight at another point of the object; never zero, so that there is always a record.
    fn weight(&self, surface: &Surface) -> f32 {
        let away = (surface.position - self.point).length();
        let turned = (1.0 - surface.normal.dot(self.normal)).max(0.0).sqrt();
        let error = away / self.apart_m.max(f32::MIN_POSITIVE) + turned / NORMAL_SPREAD;
        1.0 / (error * error + LEAST_ERROR)
    }
}

/// Buffers of a thread.
#[derive(Default)]
pub(crate) struct ObjectScratch {
    surfaces: Vec<(usize, Surface)>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    outcomes: Vec<GhostOutcome>,
}

/// Gathers records at the cells of a tile.
pub(crate) fn object_cells(
    input: AmbientInput<'_>,
    light: SurfaceLight<'_>,
    (tile, primary): (&Tile, &PrimaryTile),
    cells: &mut [ObjectCell; TILE_CELLS],
    scratch: &mut ObjectScratch,
) {
    cells.fill(ObjectCell::NONE);
    let ObjectScratch {
        surfaces,
        rays,
        hits,
        outcomes,
    } = scratch;
    surfaces.clear();
    rays.clear();
    let per_row = TILE / CELL;
    for cell in 0..TILE_CELLS {
        let (cx, cy) = (cell as u32 % per_row * CELL, cell as u32 / per_row * CELL);
        let candidates = [
            (4, 4),
            (2, 2),
            (6, 2),
            (2, 6),
            (6, 6),
            (0, 0),
            (7, 0),
            (0, 7),
            (7, 7),
        ];
        let seen = candidates.into_iter().find_map(|(dx, dy)| {
            let (dx, dy) = (cx + dx, cy + dy);
            let inside = dx < tile.width && dy < tile.height;
            inside
                .then(|| surface_at(input, tile, primary, dx, dy))
                .flatten()
        });
        if let Some(surface) = seen {
            surfaces.push((cell, surface));
        }
    }
    let packets = input.frame.settings.ambient.samples.div_ceil(16) as usize * 2;
    let n = packets * 16;
    for (cell, surface) in surfaces.iter() {
        let (u, v) = surface.normal.any_orthonormal_pair();
        let (x, y) = (
            tile.x0 / CELL + *cell as u32 % per_row,
            tile.y0 / CELL + *cell as u32 / per_row,
        );
        for part in 0..packets {
            for &[s, t] in input.frame.ambient_samples.part(x, y, part) {
                let phi = std::f32::consts::TAU * s;
                let (aside, along) = ((1.0 - t).sqrt(), t.sqrt());
                let direction =
                    u * (aside * phi.cos()) + v * (aside * phi.sin()) + surface.normal * along;
                rays.push(Ray {
                    origin: surface.leave(direction),
                    direction,
                    t_min: 0.0,
                    t_max: f32::INFINITY,
                });
            }
        }
    }
    input
        .frame
        .scene
        .intersect_all(rays, |_| MASK_VIRTUAL_ANY, hits);
    for (ray, hit) in rays.iter_mut().zip(hits.iter()) {
        ray.t_min = input.frame.sensed.lift(ray.origin);
        ray.t_max = hit.map_or(f32::INFINITY, |hit| hit.t);
    }
    outcomes.clear();
    outcomes.resize(rays.len(), GhostOutcome::Unknown);
    input.frame.sensed.ghost.trace_batch(rays, outcomes);
    let met = rays.iter().zip(hits.iter()).zip(outcomes.iter());
    let met: &mut dyn Iterator<Item = ((&Ray, &Option<Hit>), &GhostOutcome)> = &mut { met };
    for (cell, surface) in surfaces.iter() {
        if !input.frame.go_on() {
            return;
        }
        let (mut delta, mut nearness) = (Vec3A::ZERO, 0.0);
        for ((ray, hit), outcome) in met.take(n) {
            // A ray below its own triangle counts as one that sees the surroundings.
            if !surface.is_outside(ray.direction) {
                continue;
            }
            let (now, t) = match (outcome, hit) {
                (GhostOutcome::Hit(ghost), _) if ghost.from_front => (
                    light.relit_camera(&input.frame.sensed, ghost.u, ghost.v),
                    ghost.t,
                ),
                (GhostOutcome::Hit(_), _) | (_, None) => continue,
                (_, Some(hit)) => (Scene::Open.sent(input, ray, hit), hit.t),
            };
            delta += now - input.surroundings.ambient_radiance(ray.direction);
            nearness += 1.0 / t.max(f32::MIN_POSITIVE);
        }
        delta *= std::f32::consts::PI / n as f32;
        cells[*cell] = ObjectCell {
            instance: surface.instance,
            point: surface.position,
            normal: surface.normal,
            delta: if delta.is_finite() {
                delta
            } else {
                Vec3A::ZERO
            },
            apart_m: if nearness > 0.0 {
                n as f32 / nearness
            } else {
                f32::INFINITY
            },
        };
    }
}

/// The diffuse surface of a virtual object at a pixel of a tile.
fn surface_at(
    input: AmbientInput<'_>,
    tile: &Tile,
    primary: &PrimaryTile,
    dx: u32,
    dy: u32,
) -> Option<Surface> {
    let pixel = &primary.pixels[Tile::index(dx, dy)];
    if pixel.seen != PrimaryHit::Object
        || !input.frame.scene.objects[pixel.hit.instance as usize].diffuses
    {
        return None;
    }
    Some(
        input
            .frame
            .primary_surface(&pixel.hit, tile.x0 + dx, tile.y0 + dy),
    )
}

/// Irradiance minus that of the surroundings, at the pixels of a tile that show virtual surfaces.
pub(crate) fn spread_objects(
    input: AmbientInput<'_>,
    cells: &[[ObjectCell; TILE_CELLS]],
    (tile, primary): (&Tile, &PrimaryTile),
    out: &mut [Vec3A],
) {
    let around = around(input.grid, cells, tile, &ObjectCell::NONE);
    if around.iter().all(|cell| cell.instance == u32::MAX) {
        return;
    }
    for (place, out) in out.iter_mut().enumerate() {
        let (dx, dy) = (place as u32 % TILE, place as u32 / TILE);
        let Some(surface) = surface_at(input, tile, primary, dx, dy) else {
            continue;
        };
        let (mut sum, mut weights) = (Vec3A::ZERO, 0.0);
        for (i, tent) in taps(dx, dy) {
            let cell = around[i];
            if cell.instance == surface.instance {
                let weight = (tent + LEAST_TENT) * cell.weight(&surface);
                sum += cell.delta * weight;
                weights += weight;
            }
        }
        *out = if weights > 0.0 {
            sum / weights
        } else {
            Vec3A::ZERO
        };
    }
}

//! Lens rays of one tile: their hits, and the share of each pixel that shows virtual objects.
//!
//! Sample i of sixteen neighbouring pixels makes a packet whose rays start on the same part of the lens. A ray's
//! hit is the first hit of a path and is shaded with shadow rays of its own, because the hits of one pixel are
//! spread over its circle of confusion. Occlusion by the real scene is tested along the ray
//! ([`super::lens_walk`]), with the tolerance of primary rays. A ray that hits no virtual object shows the
//! camera's pixel, which is already defocused by the camera's own lens. The shadows that virtual objects cast on
//! it are not defocused yet: they are taken from the point where the ray hits the real surface.
//!
//! For a pixel in a hole, [`HolePolicy`] applies to the whole pixel; holes that its rays cross on the way to a
//! virtual object hide nothing.

use glam::Vec3A;

use crate::accel::{HitPacket, RayPacket};
use crate::frame::depth_sigma_m;
use crate::ghost::{Connection, HolePolicy};
use crate::numerics::luminance;
use crate::render::cpu::path::{Path, PixelSample, mirror_seeds, seed};
use crate::render::cpu::scatter::{is_specular, scatter};
use crate::render::cpu::shadow::group::POINTS_AT_ONCE;
use crate::render::cpu::tile::{PixelSet, Tile};
use crate::render::prepare::lens::{Lens, LensSample, SHARP_PX};
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};
use crate::simd::{LANES, LaneMask};

use super::input::ShadeInput;
use super::lens_walk::{Crossing, DepthSurface};
use super::secondary::{Scratch, Sums, glossy_rays, light_hits, trace_to_end};
use super::shaded::Shaded;

/// Most sets of samples for a pixel; see [`crate::render::LensSettings::noise_threshold`].
const MOST_SETS: usize = 16;

/// Accumulated results of a tile's lens rays, per pixel; separately for even and odd samples, whose difference
/// estimates the noise of the sum.
struct LensHits {
    rays: [[u16; TILE_PIXELS]; 2],
    /// Number of rays that hit a virtual object.
    objects: [[u16; TILE_PIXELS]; 2],
    /// Sum over the other rays of the share of light that virtual objects leave at their hit.
    shares: [Vec3A; TILE_PIXELS],
}

/// A tile whose lens rays are being traced.
struct Defocus<'a> {
    input: &'a ShadeInput<'a>,
    lens: &'a Lens,
    tile: &'a Tile,
    sheet: DepthSurface<'a>,
    /// Some ray hits the real surface where its light differs from that of the pixel.
    gathers: bool,
}

/// One sample of a block's pixels.
#[derive(Clone, Copy)]
struct Packet {
    /// Coordinates in the tile.
    block: (u32, u32),
    /// Pixels that use the sample.
    active: u16,
    set: usize,
    sample: usize,
}

/// Casts the lens rays of a tile, shades their hits and traces their paths. Writes the mask and, if it differs
/// from the pixels' own, the share of light on real surfaces.
pub(crate) fn trace_lens(
    input: &ShadeInput<'_>,
    lens: &Lens,
    tile: &Tile,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) {
    let frame = input.frame;
    let defocus = Defocus {
        input,
        lens,
        tile,
        sheet: DepthSurface {
            depth: frame.sensed.depth,
            size: frame.sensed.size(),
            connection: Connection::new(frame.sensed.settings),
        },
        gathers: tile.lens.gathers && is_relit_near(input, lens, tile),
    };
    if !tile.lens.rays && !defocus.gathers {
        return;
    }
    let mut met = LensHits {
        rays: [[0; TILE_PIXELS]; 2],
        objects: [[0; TILE_PIXELS]; 2],
        shares: [Vec3A::ZERO; TILE_PIXELS],
    };
    scratch.lens_hits.clear();
    scratch.odd_light.clear();
    scratch.odd_light.resize(TILE_PIXELS, Vec3A::ZERO);
    // Each round has twice as many rays, and only for pixels whose rays disagree so far.
    let mut grainy = None;
    let mut sets = 0..1;
    loop {
        for set in sets.clone() {
            for block in tile.blocks() {
                let active = defocus.active(block, grainy.as_ref());
                for sample in (0..lens.n()).filter(|_| active != 0) {
                    if !frame.go_on() {
                        return;
                    }
                    let packet = Packet {
                        block,
                        active,
                        set,
                        sample,
                    };
                    defocus.trace_packet(packet, &mut met, scratch);
                    if scratch.lens_hits.len() + LANES > POINTS_AT_ONCE {
                        finish_lens_hits(input, tile, out, delta, scratch);
                    }
                }
            }
        }
        finish_lens_hits(input, tile, out, delta, scratch);
        if sets.end == MOST_SETS || !tile.lens.rays || lens.noise_threshold() >= 1.0 {
            break;
        }
        let found = defocus.grainy(&met, out, &scratch.odd_light);
        if found == PixelSet::default() {
            break;
        }
        grainy = Some(found);
        sets = sets.end..2 * sets.end;
    }
    defocus.average(&met, out, delta, &scratch.odd_light);
}

/// Shades the hits of lens rays, and traces the paths that they start.
fn finish_lens_hits(
    input: &ShadeInput<'_>,
    tile: &Tile,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) {
    let Scratch {
        paths,
        lens_hits,
        odd_light,
        rough,
        shadow,
        ..
    } = scratch;
    let mut sums = Sums {
        virtual_light: &mut out.virtual_light,
        odd_light,
        rough,
        delta,
    };
    light_hits(input, tile, 0, lens_hits, shadow, paths, &mut sums);
    lens_hits.clear();
    trace_to_end(input, tile, out, delta, scratch);
}

/// Whether virtual objects change the light at any point that lens rays of a tile can reach.
fn is_relit_near(input: &ShadeInput<'_>, lens: &Lens, tile: &Tile) -> bool {
    let blur = lens.blur_between_px(tile.lens.near, tile.lens.far);
    if blur < SHARP_PX {
        return false;
    }
    // Rays start up to half a pixel off the centre, and read whole pixels.
    let reach = blur as u32 + 2;
    let surfaces = &input.light.surfaces;
    let grid = surfaces.raw.grid;
    let (columns, rows) = (grid.columns, grid.rows);
    let first = |at: u32| at.saturating_sub(reach) / TILE;
    let last = |at: u32, n: u32| (at.saturating_add(TILE + reach) / TILE).min(n - 1);
    (first(tile.y0)..=last(tile.y0, rows)).any(|row| {
        (first(tile.x0)..=last(tile.x0, columns)).any(|column| {
            grid.slot(column, row).is_some_and(|slot| {
                let light = surfaces
                    .filtered
                    .get(slot)
                    .unwrap_or(&surfaces.raw.tiles[slot].light);
                light.iter().any(|light| light.ghost != Vec3A::ONE)
            })
        })
    })
}

impl Defocus<'_> {
    /// Lanes of a block that are pixels whose rays may hit a virtual object; only those of `among`, if given.
    fn active(&self, block: (u32, u32), among: Option<&PixelSet>) -> u16 {
        let shows_holes = self.input.frame.settings.ghost.holes != HolePolicy::ShowReal;
        (0..LANES).fold(0, |active, lane| {
            let (x, y, _) = self.pixel(block, lane);
            let inside = x < self.tile.x0 + self.tile.width && y < self.tile.y0 + self.tile.height;
            let counts = inside
                && among.is_none_or(|among| among.contains(x, y))
                && (shows_holes
                    || !self.sheet.depth[(y * self.sheet.size[0] + x) as usize].is_nan());
            active | u16::from(counts) << lane
        })
    }

    /// Coordinates of a block's pixel in the picture, and the index of its record in the tile.
    fn pixel(&self, (bx, by): (u32, u32), lane: usize) -> (u32, u32, usize) {
        let (dx, dy) = (bx + lane as u32 % 4, by + lane as u32 / 4);
        (self.tile.x0 + dx, self.tile.y0 + dy, Tile::index(dx, dy))
    }

    fn trace_packet(&self, packet: Packet, met: &mut LensHits, scratch: &mut Scratch) {
        let (frame, lens) = (self.input.frame, self.lens);
        let Packet {
            block,
            active,
            set,
            sample,
        } = packet;
        let half = sample % 2;
        let at = |lane| {
            let (x, y, _) = self.pixel(block, lane);
            (x, y, &lens.samples(x, y, set)[sample])
        };
        let mut rays = RayPacket::default();
        let mut hits = HitPacket::default();
        // Elsewhere everything is sharp except the light on real surfaces.
        if self.tile.lens.rays {
            for lane in LaneMask(active) {
                let (x, y, sample) = at(lane);
                rays.set(lane, &lens.ray(x, y, sample));
            }
            frame
                .scene
                .intersect_packet(&rays, active, MASK_ALL, &mut hits);
        }
        for lane in LaneMask(active) {
            let (x, y, sample_at) = at(lane);
            let (_, _, place) = self.pixel(block, lane);
            met.rays[half][place] += 1;
            let mut real = None;
            if let Some(hit) = hits.get(lane) {
                real = self.hidden_by(x, y, sample_at, hit.t);
                if real.is_none() {
                    let cone = frame.sensed.pinhole.pixel_cone(hit.t);
                    let surface = frame.scene.surface(&hit, rays.get(lane).direction, cone);
                    let ray = PixelSample {
                        place,
                        weight: 1.0,
                        random: frame.random(x, y, sample as u32),
                    };
                    let path = Path {
                        sample: sample as u16,
                        ..seed(&surface, ray, false)
                    };
                    if !frame.scene.objects[hit.instance as usize].ghost {
                        met.objects[half][place] += 1;
                        scratch.lens_hits.push((surface, path));
                        continue;
                    }
                    let material = frame.scene.material(&surface);
                    if is_specular(material, &surface) {
                        let glossy = glossy_rays(frame, 0);
                        for path in mirror_seeds(&surface, ray) {
                            scatter(material, &surface, &path, 0, glossy, &mut scratch.paths);
                        }
                    }
                }
            }
            let real = real.or_else(|| self.meets(x, y, sample_at));
            met.shares[place] += self.share(x, y, real);
        }
    }

    /// Pixels whose even and odd samples differ visibly, and their neighbours.
    fn grainy(&self, met: &LensHits, out: &Shaded, odd_light: &[Vec3A]) -> PixelSet {
        let mut found = PixelSet::default();
        for block in self.tile.blocks() {
            for lane in LaneMask(self.active(block, None)) {
                let (x, y, place) = self.pixel(block, lane);
                let [even, odd] = met.rays.map(|rays| f32::from(rays[place]));
                if odd == 0.0 || met.objects.iter().all(|objects| objects[place] == 0) {
                    continue;
                }
                // Approximate displayed brightness: a square root for the transfer curve.
                let camera =
                    self.input.frame.sensed.color_at(x, y) * self.input.light.at(x, y).ghost;
                let shown = |light: Vec3A, half: usize, rays: f32| {
                    let mask = f32::from(met.objects[half][place]) / rays;
                    let composite = light / rays + camera * (1.0 - mask);
                    luminance(composite).clamp(0.0, 1.0).sqrt()
                };
                let differ =
                    shown(out.virtual_light[place], 0, even) - shown(odd_light[place], 1, odd);
                if differ.abs() > self.lens.noise_threshold() {
                    found.insert(x, y);
                }
            }
        }
        found.widened()
    }

    /// The real surface that hides a virtual object at depth `z` from a ray, if any.
    fn hidden_by(&self, x: u32, y: u32, sample: &LensSample, z: f32) -> Option<Crossing> {
        if z <= self.tile.lens.near {
            return None;
        }
        let track = self.lens.track(x, y, sample);
        let crossing = self.sheet.first_crossing(&track, self.tile.lens.near, z)?;
        // As for primary rays: within the sensor's noise the object is shown.
        let sigmas = self.input.frame.settings.ghost.occlusion_sigmas;
        (z > crossing.z + sigmas * depth_sigma_m(crossing.z)).then_some(crossing)
    }

    /// The point at which a ray hits the real scene, if it is needed.
    fn meets(&self, x: u32, y: u32, sample: &LensSample) -> Option<Crossing> {
        if !self.gathers {
            return None;
        }
        let (near, far) = (self.tile.lens.near, self.tile.lens.far);
        // Rounded up, so that a surface exactly at `far` is hit.
        let far = far * (1.0 + 4.0 * f32::EPSILON);
        self.sheet
            .first_crossing(&self.lens.track(x, y, sample), near, far)
    }

    /// The share of light that virtual objects leave at the point where a ray of pixel (x, y) hits the real
    /// scene.
    fn share(&self, x: u32, y: u32, real: Option<Crossing>) -> Vec3A {
        match real {
            Some(Crossing { x, y, .. }) if self.gathers => self.input.light.at(x, y).ghost,
            _ => self.input.light.at(x, y).ghost,
        }
    }

    /// Converts sums to means over each pixel's rays.
    fn average(
        &self,
        met: &LensHits,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        odd_light: &[Vec3A],
    ) {
        if self.gathers {
            out.shares.resize(TILE_PIXELS, Vec3A::ONE);
        }
        for block in self.tile.blocks() {
            for lane in LaneMask(self.active(block, None)) {
                let (x, y, place) = self.pixel(block, lane);
                let total = |of: &[[u16; TILE_PIXELS]; 2]| {
                    f32::from(of[0][place]) + f32::from(of[1][place])
                };
                let (rays, objects) = (total(&met.rays), total(&met.objects));
                out.mask[place] = objects / rays;
                out.virtual_light[place] = (out.virtual_light[place] + odd_light[place]) / rays;
                delta[place] /= rays;
                if self.gathers {
                    out.shares[place] = if objects < rays {
                        met.shares[place] / (rays - objects)
                    } else {
                        self.input.light.at(x, y).ghost
                    };
                }
            }
        }
    }
}

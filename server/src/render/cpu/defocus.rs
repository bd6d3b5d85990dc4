//! Lens rays of one tile: what each meets, and the share of each pixel that is virtual.
//!
//! Sample i of sixteen neighbouring pixels makes a packet: it starts on the same part of the lens.
//! What a ray meets is a path's first hit, shaded with shadows of its own, for the hits of one pixel
//! are spread over its circle of confusion. Whether the real scene hides it is asked along the ray
//! ([`super::lens_walk`]), with the tolerance of primary rays. A ray that meets nothing virtual shows
//! the camera's pixel: that is defocused already, by the camera's own lens. What virtual things
//! change of it, their shadows, is not: it is taken from where the ray meets the real surface.
//!
//! A pixel in a hole follows [`HolePolicy`] as a whole; holes that its rays pass on the way to
//! something virtual hide nothing.

use glam::Vec3A;

use crate::accel::{HitPacket, RayPacket};
use crate::frame::depth_sigma_m;
use crate::ghost::Connection;
use crate::render::HolePolicy;

use super::FrameContext;
use super::lens::{Lens, SHARP_PX};
use super::lens_walk::{Crossing, Sheet};
use super::path::{Scratch, Sums, mirror_seeds, seed};
use super::shade::Shaded;
use super::shadow_group::{LANES, POINTS_AT_ONCE, lanes};
use super::tile::{TILE, TILE_PIXELS, Tile};

/// What the lens rays of a tile have met so far, per pixel.
struct Met {
    /// Rays that met something virtual.
    objects: [u16; TILE_PIXELS],
    /// Sum over the others of the share of light that virtual objects leave on what they met.
    shares: [Vec3A; TILE_PIXELS],
}

/// A tile under its lens rays.
struct Defocus<'a> {
    ctx: &'a FrameContext<'a>,
    lens: &'a Lens,
    tile: &'a Tile,
    sheet: Sheet<'a>,
    /// Some ray meets the real surface elsewhere than its pixel does, where the light differs.
    gathers: bool,
}

impl FrameContext<'_> {
    /// Casts and shades the lens rays of a tile, up to paths that are still under way. Writes the
    /// mask and, where it is not the pixels' own, the share of light on what is real.
    pub(super) fn trace_lens(
        &self,
        lens: &Lens,
        tile: &Tile,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        scratch: &mut Scratch,
    ) {
        let defocus = Defocus {
            ctx: self,
            lens,
            tile,
            sheet: Sheet {
                depth: self.occlusion_depth,
                size: [self.frame.color.width, self.frame.color.height],
                connection: Connection::new(&self.settings.ghost),
            },
            gathers: tile.lens.gathers && self.is_relit_near(lens, tile),
        };
        if !tile.lens.rays && !defocus.gathers {
            return;
        }
        let mut met = Met {
            objects: [0; TILE_PIXELS],
            shares: [Vec3A::ZERO; TILE_PIXELS],
        };
        scratch.lens_hits.clear();
        for block in tile.blocks() {
            let active = defocus.active(block);
            for i in 0..lens.n() {
                if tile.lens.rays {
                    defocus.trace_packet(block, active, i, &mut met, scratch);
                } else {
                    for lane in lanes(active) {
                        defocus.miss(block, lane, i, &mut met);
                    }
                }
                if scratch.lens_hits.len() + LANES > POINTS_AT_ONCE {
                    self.finish_lens_hits(tile, out, delta, scratch);
                }
            }
        }
        self.finish_lens_hits(tile, out, delta, scratch);
        defocus.write(&met, out);
    }

    /// Shades what lens rays have met, and follows what that sends on.
    fn finish_lens_hits(
        &self,
        tile: &Tile,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        scratch: &mut Scratch,
    ) {
        let Scratch {
            paths,
            lens_hits,
            shadow,
            ..
        } = scratch;
        let mut sums = Sums {
            virtual_light: &mut out.virtual_light,
            delta,
        };
        self.light_hits(tile, 0, lens_hits, shadow, paths, &mut sums);
        lens_hits.clear();
        self.trace_to_end(tile, out, delta, scratch);
    }

    /// Whether virtual objects change the light on anything that lens rays of a tile reach.
    fn is_relit_near(&self, lens: &Lens, tile: &Tile) -> bool {
        let blur = lens.blur_between_px(tile.lens.near, tile.lens.far);
        if blur < SHARP_PX {
            return false;
        }
        // Rays start half a pixel aside and see whole pixels.
        let reach = blur as u32 + 2;
        let (columns, rows) = (self.grid.columns, self.grid.rows);
        let first = |at: u32| at.saturating_sub(reach) / TILE;
        let last = |at: u32, n: u32| (at.saturating_add(TILE + reach) / TILE).min(n - 1);
        (first(tile.y0)..=last(tile.y0, rows)).any(|row| {
            (first(tile.x0)..=last(tile.x0, columns)).any(|column| {
                self.grid.slot(column, row).is_some_and(|slot| {
                    let light = self.filtered.get(slot).unwrap_or(&self.tiles[slot].light);
                    light.iter().any(|light| light.ghost != Vec3A::ONE)
                })
            })
        })
    }
}

impl Defocus<'_> {
    /// Lanes of a block that are pixels whose rays may see something virtual.
    fn active(&self, block: (u32, u32)) -> u16 {
        let shows_holes = self.ctx.settings.ghost.holes == HolePolicy::ShowVirtual;
        (0..LANES).fold(0, |active, lane| {
            let (dx, dy) = within(block, lane);
            let counts = dx < self.tile.width && dy < self.tile.height && {
                let (x, y) = (self.tile.x0 + dx, self.tile.y0 + dy);
                shows_holes || !self.sheet.depth[(y * self.sheet.size[0] + x) as usize].is_nan()
            };
            active | u16::from(counts) << lane
        })
    }

    fn pixel(&self, block: (u32, u32), lane: usize) -> (u32, u32, usize) {
        let (dx, dy) = within(block, lane);
        (self.tile.x0 + dx, self.tile.y0 + dy, Tile::index(dx, dy))
    }

    /// Sample `i` of a block's pixels.
    fn trace_packet(
        &self,
        block: (u32, u32),
        active: u16,
        i: usize,
        met: &mut Met,
        scratch: &mut Scratch,
    ) {
        let (ctx, lens) = (self.ctx, self.lens);
        let mut rays = RayPacket::default();
        for lane in lanes(active) {
            let (x, y, _) = self.pixel(block, lane);
            rays.set(lane, &lens.ray(x, y, &lens.samples(x, y)[i]));
        }
        let mut hits = HitPacket::default();
        ctx.intersect_packet(&rays, active, super::MASK_ALL, &mut hits);
        let weight = 1.0 / lens.n() as f32;
        for lane in lanes(active) {
            let (x, y, place) = self.pixel(block, lane);
            let Some(hit) = hits.get(lane) else {
                self.miss(block, lane, i, met);
                continue;
            };
            if let Some(hidden) = self.hidden_by(x, y, i, hit.t) {
                met.shares[place] += self.share(x, y, Some(hidden));
                continue;
            }
            let surface = ctx.surface(&hit, rays.get(lane).direction);
            if ctx.objects[hit.instance as usize].ghost {
                if ctx.is_specular(&surface) {
                    let glossy = ctx.glossy_rays(0);
                    for path in mirror_seeds(&surface, place, weight) {
                        ctx.scatter(&surface, &path, 0, glossy, &mut scratch.paths);
                    }
                }
                self.miss(block, lane, i, met);
                continue;
            }
            met.objects[place] += 1;
            let mut path = seed(&surface, place, weight, false);
            path.sample = i as u16;
            scratch.lens_hits.push((surface, path));
        }
    }

    /// What real thing hides something virtual at depth `z` from a ray.
    fn hidden_by(&self, x: u32, y: u32, i: usize, z: f32) -> Option<Crossing> {
        if z <= self.tile.lens.near {
            return None;
        }
        let track = self.lens.track(x, y, &self.lens.samples(x, y)[i]);
        let crossing = self.sheet.first_crossing(&track, self.tile.lens.near, z)?;
        // As primary rays: within the sensor's noise the object wins.
        let sigmas = self.ctx.settings.ghost.occlusion_sigmas;
        (z > crossing.z + sigmas * depth_sigma_m(crossing.z)).then_some(crossing)
    }

    /// Counts a ray that meets nothing virtual.
    fn miss(&self, block: (u32, u32), lane: usize, i: usize, met: &mut Met) {
        let (x, y, place) = self.pixel(block, lane);
        let crossing = if self.gathers {
            let track = self.lens.track(x, y, &self.lens.samples(x, y)[i]);
            let (near, far) = (self.tile.lens.near, self.tile.lens.far);
            // Rounded up: what lies at `far` itself is met.
            self.sheet
                .first_crossing(&track, near, far * (1.0 + 4.0 * f32::EPSILON))
        } else {
            None
        };
        met.shares[place] += self.share(x, y, crossing);
    }

    /// The share of light that virtual objects leave where a ray of pixel (x, y) meets what is real.
    fn share(&self, x: u32, y: u32, crossing: Option<Crossing>) -> Vec3A {
        match crossing {
            Some(crossing) if self.gathers => self.ctx.light(crossing.x, crossing.y).ghost,
            _ => self.ctx.light(x, y).ghost,
        }
    }

    /// Mask and shares of the tile's pixels.
    fn write(&self, met: &Met, out: &mut Shaded) {
        let n = self.lens.n();
        if self.gathers {
            out.shares.resize(TILE_PIXELS, Vec3A::ONE);
        }
        for block in self.tile.blocks() {
            for lane in lanes(self.active(block)) {
                let (x, y, place) = self.pixel(block, lane);
                let objects = usize::from(met.objects[place]);
                out.mask[place] = objects as f32 / n as f32;
                if self.gathers {
                    let real = n - objects;
                    out.shares[place] = if real == 0 {
                        self.ctx.light(x, y).ghost
                    } else {
                        met.shares[place] / real as f32
                    };
                }
            }
        }
    }
}

/// Pixel of a block within its tile.
fn within((bx, by): (u32, u32), lane: usize) -> (u32, u32) {
    (bx + lane as u32 % 4, by + lane as u32 / 4)
}

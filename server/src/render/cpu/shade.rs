//! Shading, secondary rays and compositing of one tile.
//!
//! Every pixel gets `If = M Im + (1 - M)(Ic + Im - Ir)` (Kan and Kaufmann 2012), averaged over its
//! samples. On the real surface the diffuse albedo is estimated from the camera's pixel and the
//! modelled irradiance, `rho = pi Ic / Er`; then Ir is Ic itself and Ic + Im - Ir = Ic Em / Er, the
//! camera's pixel times the share of light that virtual objects leave.
//!
//! A contribution is a sum over paths, so their order inside a tile is fixed and the picture does
//! not depend on threads.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};
use crate::numerics::{radical_inverse, srgb_from_linear};
use crate::render::FrameStats;

use super::FrameContext;
use super::path::{PATHS_AT_ONCE, Scratch, mirror_seeds};
use super::scatter::LightShare;
use super::tile::{Seen, TILE, TILE_PIXELS, Tile};

/// Depth step between neighbouring pixels of one object that counts as its silhouette against
/// itself, relative to depth.
const SILHOUETTE_STEP: f32 = 0.02;

/// The result of a tile.
#[derive(Debug, Clone)]
pub(super) struct Shaded {
    /// Linear composite; meaningful where `touched`.
    pub(super) color: Box<[Vec3A; TILE_PIXELS]>,
    /// M Im: the virtual part of `color`, what bloom and glare spread.
    pub(super) virtual_light: Box<[Vec3A; TILE_PIXELS]>,
    /// M.
    pub(super) mask: Box<[f32; TILE_PIXELS]>,
    /// Share of light that virtual objects leave on what is real in each pixel, where a lens takes it
    /// from other pixels too; else empty.
    pub(super) shares: Vec<Vec3A>,
    /// Pixels that differ from the camera's.
    pub(super) touched: Box<[bool; TILE_PIXELS]>,
    /// `color` as displayed; meaningful where `touched`. Converted here, while other tiles are still
    /// traced: only where a highlight spreads to is it done again.
    pub(super) bytes: Box<[[u8; 3]; TILE_PIXELS]>,
    /// `virtual_light` and `mask` are zero everywhere.
    blank: bool,
    /// Largest luminance of `virtual_light`.
    pub(super) peak: f32,
    pub(super) stats: FrameStats,
}

impl Shaded {
    pub(super) fn new() -> Self {
        Self {
            color: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            virtual_light: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            mask: Box::new([0.0; TILE_PIXELS]),
            shares: Vec::new(),
            touched: Box::new([false; TILE_PIXELS]),
            bytes: Box::new([[0; 3]; TILE_PIXELS]),
            blank: true,
            peak: 0.0,
            stats: FrameStats::default(),
        }
    }
}

/// Luminance, Rec. 709.
pub(super) fn luminance(c: Vec3A) -> f32 {
    c.dot(Vec3A::new(0.2126, 0.7152, 0.0722))
}

/// Shades one tile.
pub(super) fn shade_tile(
    ctx: &FrameContext<'_>,
    (slot, tile): (usize, &Tile),
    out: &mut Shaded,
    scratch: &mut Scratch,
) {
    if !out.blank {
        out.virtual_light.fill(Vec3A::ZERO);
        out.mask.fill(0.0);
        out.blank = true;
    }
    out.touched.fill(false);
    out.shares.clear();
    out.peak = 0.0;
    out.stats = tile.shadow_stats;
    let lens = ctx.lens.filter(|_| tile.lens.rays || tile.lens.gathers);
    if !tile.sees_objects && !tile.is_relit && lens.is_none() {
        // Planned for what turned out not to reach it: the camera's pixels stay.
        out.stats.traced_pixels += u64::from(tile.width * tile.height);
        return;
    }
    if tile.only_ambient && lens.is_none() {
        shade_relit(ctx, (slot, tile), out);
        return;
    }
    out.blank = false;
    scratch.paths.clear();
    scratch.shadow.stats = FrameStats::default();

    // The change that virtual objects cause on modelled real mirrors, Im - Ir, per pixel.
    let mut delta = [Vec3A::ZERO; TILE_PIXELS];
    let mut any_delta = false;
    if let Some(lens) = lens {
        ctx.trace_lens(lens, tile, out, &mut delta, scratch);
        any_delta = ctx.has_ghost_objects;
    }
    let through_lens = lens.is_some() && tile.lens.rays;
    // Block by block, for secondary rays of neighbours are traced together.
    let pixels = tile
        .blocks()
        .flat_map(|(bx, by)| (0..16).map(move |i| (bx + i % 4, by + i / 4)));
    let inside = |&(dx, dy): &(u32, u32)| !through_lens && dx < tile.width && dy < tile.height;
    for (i, (dx, dy)) in pixels.filter(inside).enumerate() {
        if !ctx.go_on_at(i) {
            return;
        }
        if scratch.paths.len() > PATHS_AT_ONCE {
            ctx.trace_to_end(tile, out, &mut delta, scratch);
        }
        let place = Tile::index(dx, dy);
        let (x, y) = (tile.x0 + dx, tile.y0 + dy);
        let pixel = tile.pixels[place];
        let light = ctx.light(x, y);
        if tile.sees_objects && ctx.settings.edge_samples > 1 && ctx.is_edge(tile, dx, dy) {
            ctx.shade_edge(tile, x, y, place, out, scratch);
        } else {
            match pixel.seen {
                Seen::Camera => {}
                Seen::Object => {
                    let surface = ctx.primary_surface(&pixel.hit, x, y);
                    out.mask[place] = 1.0;
                    out.virtual_light[place] += ctx.direct(&surface, light.object, Vec3A::ONE);
                    out.virtual_light[place] += ctx.start(&surface, place, 1.0, &mut scratch.paths);
                }
                Seen::GhostObject => {
                    let surface = ctx.primary_surface(&pixel.hit, x, y);
                    if ctx.is_specular(&surface) {
                        any_delta = true;
                        let glossy = ctx.settings.glossy_samples;
                        for path in mirror_seeds(&surface, place, 1.0) {
                            ctx.scatter(&surface, &path, 0, glossy, &mut scratch.paths);
                        }
                    }
                }
            }
        }
    }
    ctx.trace_to_end(tile, out, &mut delta, scratch);
    if !through_lens
        && tile.sees_objects
        && ctx.settings.edge_samples > 1
        && ctx.refine_contrast(tile, out, &mut delta, scratch)
    {
        ctx.trace_to_end(tile, out, &mut delta, scratch);
    }
    if !ctx.go_on() {
        return;
    }
    out.stats.add(&scratch.shadow.stats);

    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let share = ctx.real_share(out, x, y, place);
            let mask = out.mask[place];
            let relit = share != Vec3A::ONE;
            let changed = any_delta && delta[place] != Vec3A::ZERO;
            if mask == 0.0 && !relit && !changed {
                continue;
            }
            out.touched[place] = true;
            let camera = ctx.camera_color(x, y);
            // Real mirrors: Im - Ir was summed with the sign and weight of each ray.
            let background = camera * share * (1.0 - mask) + delta[place];
            out.color[place] = out.virtual_light[place] + background.max(Vec3A::ZERO);
            out.bytes[place] = out.color[place].to_array().map(srgb_from_linear);
            out.peak = out.peak.max(luminance(out.virtual_light[place]));
            let real_depth = ctx.occlusion_depth[(y * ctx.frame.color.width + x) as usize];
            out.stats.virtual_pixels += u64::from(mask > 0.0);
            out.stats.unmeasured_pixels += u64::from(mask > 0.0 && real_depth.is_nan());
            out.stats.relit_pixels += u64::from(relit && mask < 1.0);
        }
    }
    out.stats.traced_pixels += u64::from(tile.width * tile.height);
}

/// Shades a tile in which nothing but the ambient light of real surfaces changes.
fn shade_relit(ctx: &FrameContext<'_>, (slot, tile): (usize, &Tile), out: &mut Shaded) {
    if !ctx.go_on() {
        return;
    }
    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let share = ctx.ambient_share(slot, place);
            if share == Vec3A::ONE {
                continue;
            }
            out.touched[place] = true;
            out.color[place] = ctx.camera_color(tile.x0 + dx, tile.y0 + dy) * share;
            out.bytes[place] = out.color[place].to_array().map(srgb_from_linear);
            out.stats.relit_pixels += 1;
        }
    }
    out.stats.traced_pixels += u64::from(tile.width * tile.height);
}

impl FrameContext<'_> {
    /// The share of light that virtual objects leave on what is real in a pixel.
    pub(super) fn real_share(&self, out: &Shaded, x: u32, y: u32, place: usize) -> Vec3A {
        let through_lens = out.shares.get(place).copied();
        through_lens.unwrap_or_else(|| self.light(x, y).ghost)
    }

    /// Whether a pixel of a tile lies on the outline of something virtual.
    fn is_edge(&self, tile: &Tile, dx: u32, dy: u32) -> bool {
        let (x, y) = (tile.x0 + dx, tile.y0 + dy);
        let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
        let place = Tile::index(dx, dy);
        let here = &tile.pixels[place];
        let inside = |there: usize| tile.pixels[there];
        let neighbours = [
            (x > 0).then(|| match dx {
                0 => self.pixel(x - 1, y),
                _ => inside(place - 1),
            }),
            (x < right).then(|| match tile.width - dx {
                1 => self.pixel(x + 1, y),
                _ => inside(place + 1),
            }),
            (y > 0).then(|| match dy {
                0 => self.pixel(x, y - 1),
                _ => inside(place - TILE as usize),
            }),
            (y < bottom).then(|| match tile.height - dy {
                1 => self.pixel(x, y + 1),
                _ => inside(place + TILE as usize),
            }),
        ];
        neighbours.into_iter().flatten().any(|there| {
            let any_object = here.seen == Seen::Object || there.seen == Seen::Object;
            any_object
                && (here.seen != there.seen
                    || here.hit.instance != there.hit.instance
                    || (here.hit.t - there.hit.t).abs()
                        > SILHOUETTE_STEP * here.hit.t.min(there.hit.t))
        })
    }

    /// Anti-aliasing by image gradient (RT2AR, section III.A): virtual pixels that differ much from a
    /// neighbour, as reflections do where they are squeezed, are shaded again with several samples.
    fn refine_contrast(
        &self,
        tile: &Tile,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        scratch: &mut Scratch,
    ) -> bool {
        let mut refine = [false; TILE_PIXELS];
        // As bright as displayed, roughly: a square root for the transfer curve.
        let shown = |place: usize| luminance(out.virtual_light[place]).clamp(0.0, 1.0).sqrt();
        let whole = |place: usize| out.mask[place] == 1.0;
        for dy in 0..tile.height {
            for dx in 0..tile.width {
                let here = Tile::index(dx, dy);
                for (nx, ny) in [(dx + 1, dy), (dx, dy + 1)] {
                    if nx >= tile.width || ny >= tile.height {
                        continue;
                    }
                    let there = Tile::index(nx, ny);
                    if whole(here)
                        && whole(there)
                        && (shown(here) - shown(there)).abs() > self.settings.edge_contrast
                    {
                        refine[here] = true;
                        refine[there] = true;
                    }
                }
            }
        }
        for dy in 0..tile.height {
            for dx in 0..tile.width {
                let place = Tile::index(dx, dy);
                let (x, y) = (tile.x0 + dx, tile.y0 + dy);
                // Outlines have had their samples.
                if refine[place] && !self.is_edge(tile, dx, dy) {
                    if scratch.paths.len() > PATHS_AT_ONCE {
                        self.trace_to_end(tile, out, delta, scratch);
                    }
                    out.mask[place] = 0.0;
                    out.virtual_light[place] = Vec3A::ZERO;
                    self.shade_edge(tile, x, y, place, out, scratch);
                }
            }
        }
        !scratch.paths.is_empty()
    }

    /// Several samples for a pixel on an outline, stratified over its area.
    fn shade_edge(
        &self,
        tile: &Tile,
        x: u32,
        y: u32,
        place: usize,
        out: &mut Shaded,
        scratch: &mut Scratch,
    ) {
        let n = self.settings.edge_samples;
        let weight = 1.0 / n as f32;
        let mut rays = RayPacket::default();
        let mut hits = HitPacket::default();
        for first in (0..n).step_by(16) {
            let lanes = (n - first).min(16);
            for lane in 0..lanes {
                // Hammersley's points: one in each row and column of an n x n grid.
                let i = first + lane;
                let su = (i as f32 + 0.5) * weight - 0.5;
                let sv = radical_inverse(i) + 0.5 * weight - 0.5;
                let direction = self.ray_direction(x as f32 + su, y as f32 + sv.min(0.5));
                rays.set(
                    lane as usize,
                    &Ray {
                        origin: Vec3A::ZERO,
                        direction,
                        t_min: 1e-3,
                        t_max: f32::INFINITY,
                    },
                );
            }
            let active = ((1u32 << lanes) - 1) as u16;
            self.intersect_packet(&rays, active, super::MASK_ALL, &mut hits);
            for lane in 0..lanes as usize {
                if !self.go_on_at(lane) {
                    return;
                }
                let Some(hit) = hits.get(lane) else { continue };
                let seen = self.seen(x, y, hit.t, self.objects[hit.instance as usize].ghost);
                if seen != Seen::Object {
                    continue;
                }
                let cone = self.pixel_cone(hit.t).share(n);
                let surface = self.surface(&hit, rays.get(lane).direction, cone);
                out.mask[place] += weight;
                out.virtual_light[place] += self.direct(
                    &surface,
                    self.object_share_near(tile, x, y, &hit),
                    Vec3A::ONE,
                ) * weight;
                out.virtual_light[place] += self.start(&surface, place, weight, &mut scratch.paths);
            }
        }
        // Weights of a power of two sum exactly; others leave a few roundings.
        out.mask[place] = out.mask[place].min(1.0);
    }

    /// The share of direct light found at the pixel, or at a neighbour that sees the same object.
    fn object_share_near(&self, tile: &Tile, x: u32, y: u32, hit: &Hit) -> LightShare {
        let (right, bottom) = (tile.x0 + tile.width - 1, tile.y0 + tile.height - 1);
        let mut best = None;
        for ny in y.saturating_sub(1).max(tile.y0)..=(y + 1).min(bottom) {
            for nx in x.saturating_sub(1).max(tile.x0)..=(x + 1).min(right) {
                let pixel = self.pixel(nx, ny);
                if pixel.seen == Seen::Object && pixel.hit.instance == hit.instance {
                    let distance = (pixel.hit.t - hit.t).abs();
                    if best.is_none_or(|(d, _)| distance < d) {
                        best = Some((distance, self.light(nx, ny).object));
                    }
                }
            }
        }
        best.map_or(LightShare::ALL, |(_, share)| share)
    }
}

//! Rough reflections that neighbouring pixels estimate together. Where the lobes of neighbours point about the same
//! way, each pixel sends fewer rays, and takes the weighted mean of the rays of all of them: a joint bilateral filter
//! (Petschnigg et al. 2004) over the incoming radiance, guided by the directions of the lobes.

use glam::Vec3A;

use crate::render::cpu::scatter::RoughLobe;
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS, TileGrid};

/// Pixels to each side that a pixel shares with.
const REACH: u32 = 2;

/// No entry.
const NONE: u16 = u16::MAX;

/// The lobe of a pixel that shares.
#[derive(Debug, Clone, Copy)]
struct Sharer {
    place: u16,
    instance: u32,
    material: u32,
    position: Vec3A,
    /// Middle of the lobe.
    direction: Vec3A,
    /// Reflected share of what the lobe gathers.
    tint: Vec3A,
    /// Half the inverse variance of the directions that may stand for this one, per square radian.
    sharpness: f32,
    /// Rays that it sends.
    rays: u32,
    /// Whether a neighbour's reflection counts as its own.
    shares: bool,
    /// Mean radiance of its own rays, times `tint`.
    light: Vec3A,
    /// Sum of 1 / length of its own rays, per metre.
    nearness: f32,
}

impl Sharer {
    /// How much of another's reflection counts as its own, 0..=1: by the angle between what both lobes
    /// see, `nearness` being one over the distance of that.
    fn likeness(&self, other: &Self, nearness: f32) -> f32 {
        if self.instance != other.instance || self.material != other.material {
            return 0.0;
        }
        let turned = (self.direction - other.direction).length_squared();
        let moved = (self.position - other.position).length_squared() * (nearness * nearness);
        let x = (turned + moved) * self.sharpness.max(other.sharpness);
        // Like a Gauss curve, and ends.
        let rest = (1.0 - 0.5 * x).max(0.0);
        rest * rest
    }

    /// One over the mean distance of what its rays met.
    fn nearness(&self) -> f32 {
        self.nearness / self.rays as f32
    }
}

/// The pixels of a tile that share rough reflections.
#[derive(Debug, Default)]
pub(crate) struct RoughTile {
    sharers: Vec<Sharer>,
    /// Index into `sharers` by pixel; empty without any.
    at: Vec<u16>,
}

impl RoughTile {
    pub(crate) fn clear(&mut self) {
        self.sharers.clear();
        self.at.clear();
    }

    /// Notes the lobe of a pixel. `width` is that of the directions that may stand for the lobe's
    /// middle, relative to the lobe; `rays` the number that it sends if no neighbour shares.
    pub(crate) fn add(
        &mut self,
        place: usize,
        surface: &Surface,
        lobe: &RoughLobe,
        width: f32,
        rays: u32,
    ) {
        self.at.resize(TILE_PIXELS, NONE);
        self.at[place] = self.sharers.len() as u16;
        // Facets tilted by alpha turn what they reflect by twice as much.
        let deviation = width * 2.0 * lobe.alpha;
        self.sharers.push(Sharer {
            place: place as u16,
            instance: surface.instance,
            material: surface.material,
            position: surface.position,
            direction: surface.mirror(),
            tint: lobe.reflectance(),
            sharpness: 0.5 / (deviation * deviation).max(f32::MIN_POSITIVE),
            rays,
            shares: false,
            light: Vec3A::ZERO,
            nearness: 0.0,
        });
    }

    /// If n pixels of the tile share, each sends 1 / sqrt(n) of its rays. The mean of all of them then has sqrt(n)
    /// times as many rays as before, so its error falls by n^(1/4).
    pub(crate) fn plan(&mut self) {
        for i in 0..self.sharers.len() {
            let this = self.sharers[i];
            let place = u32::from(this.place);
            let at = (place % TILE, place / TILE);
            let like = |reach| {
                let around = neighbours(at, (TILE, TILE), reach);
                let sharing = around.filter_map(|(x, y)| self.of((y * TILE + x) as usize));
                sharing.map(|other| this.likeness(other, 0.0)).sum::<f32>()
            };
            // It is its own neighbour. Narrow lobes on curved surfaces have no other.
            if like(1) > 1.0 {
                let n = like(REACH);
                let this = &mut self.sharers[i];
                this.shares = true;
                this.rays = (this.rays as f32 / n.sqrt()).ceil().max(1.0) as u32;
            }
        }
    }

    /// Rays that a pixel sends, if it shares.
    pub(crate) fn rays(&self, place: usize) -> Option<u32> {
        self.of(place).map(|sharer| sharer.rays)
    }

    fn of(&self, place: usize) -> Option<&Sharer> {
        let at = usize::from(*self.at.get(place)?);
        self.sharers.get(at)
    }

    fn of_mut(&mut self, place: usize) -> Option<&mut Sharer> {
        let at = usize::from(*self.at.get(place)?);
        self.sharers.get_mut(at)
    }

    /// Adds light that a ray of a pixel brings.
    pub(crate) fn add_light(&mut self, place: usize, light: Vec3A) {
        if let Some(sharer) = self.of_mut(place) {
            sharer.light += light;
        }
    }

    /// Notes the length of a ray of a pixel, metres.
    pub(crate) fn add_length(&mut self, place: usize, length: f32) {
        if let Some(sharer) = self.of_mut(place) {
            sharer.nearness += length.recip();
        }
    }
}

/// What the pixels of all tiles share.
#[derive(Clone, Copy)]
pub(crate) struct RoughPixels<'a> {
    pub(crate) grid: &'a TileGrid,
    pub(crate) tiles: &'a [RoughTile],
    /// Size of the picture.
    pub(crate) size: [u32; 2],
}

impl RoughPixels<'_> {
    /// The pixels of a tile that share, each with the reflection that it and its neighbours found.
    pub(crate) fn gather(
        self,
        slot: usize,
        (x0, y0): (u32, u32),
    ) -> impl Iterator<Item = (usize, Vec3A)> {
        self.tiles[slot].sharers.iter().map(move |this| {
            let place = u32::from(this.place);
            if !this.shares {
                return (usize::from(this.place), this.light);
            }
            let (mut sum, mut weights) = (Vec3A::ZERO, 0.0);
            let at = (x0 + place % TILE, y0 + place / TILE);
            let around = neighbours(at, self.size.into(), REACH);
            for other in around.filter_map(|(x, y)| {
                let (slot, place) = self.grid.locate(x, y)?;
                self.tiles[slot].of(place)
            }) {
                let nearness = 0.5 * (this.nearness() + other.nearness());
                let weight = this.likeness(other, nearness) * other.rays as f32;
                sum += other.light / other.tint * weight;
                weights += weight;
            }
            // No weight is left if a ray had no length: then not even its own pixel's distance is known.
            let light = if weights > 0.0 {
                sum / weights * this.tint
            } else {
                this.light
            };
            (usize::from(this.place), light)
        })
    }
}

/// The pixels around one of a picture, itself among them, so far to each side.
fn neighbours(
    (x, y): (u32, u32),
    (width, height): (u32, u32),
    reach: u32,
) -> impl Iterator<Item = (u32, u32)> {
    let around = move |at: u32, n: u32| at.saturating_sub(reach)..=(at + reach).min(n - 1);
    around(y, height).flat_map(move |y| around(x, width).map(move |x| (x, y)))
}

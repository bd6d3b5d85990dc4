//! Points that are asked about together, and what is known of them so far.

use std::ops::Range;

use glam::Vec3A;

use crate::accel::Ray;
use crate::render::FrameStats;

use super::ambient::AmbientChange;
use super::light::LightDisc;
use super::photon_light::PhotonLight;
use super::plan::LightSet;
use super::scatter::LightShare;
use super::tile::TILE;

/// Lanes of a packet, points of a group.
pub(super) const LANES: usize = 16;

/// A point whose light is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShadowPoint {
    /// Where rays start, already lifted off its own surface by the rounding error of the point.
    pub(super) origin: Vec3A,
    /// Unit normal; for ghost points found only when needed.
    pub(super) normal: Vec3A,
    pub(super) gloss: Gloss,
    /// A ray to each light's middle is enough: the point is one of many that a rough reflection sees.
    pub(super) coarse: bool,
    /// Pixel, for the pattern's rotation and the ghost normal.
    pub(super) x: u32,
    pub(super) y: u32,
}

/// How a virtual surface mirrors light: what its highlights are weighed by.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gloss {
    /// Unit direction of the ray that sees it.
    pub(super) incoming: Vec3A,
    /// GGX alpha; 0 where it has no highlights, or they are not asked for.
    pub(super) alpha: f32,
}

impl ShadowPoint {
    const NOWHERE: Self = Self {
        origin: Vec3A::ZERO,
        normal: Vec3A::ZERO,
        gloss: Gloss {
            incoming: Vec3A::ZERO,
            alpha: 0.0,
        },
        coarse: false,
        x: 0,
        y: 0,
    };
}

/// Answer for one point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Visibility {
    /// Em / Er on the ghost surface; lit share of direct light on a virtual one.
    pub(super) share: Vec3A,
    /// Lit share of what a virtual surface mirrors of lamps.
    pub(super) gloss: Vec3A,
    pub(super) penumbra: bool,
}

impl Visibility {
    /// Of a virtual surface.
    pub(super) fn of_object(&self) -> LightShare {
        LightShare {
            diffuse: self.share,
            gloss: self.gloss,
            ambient: Vec3A::ZERO,
        }
    }
}

/// Up to sixteen points of one kind.
pub(super) struct ShadowGroup {
    pub(super) points: [ShadowPoint; LANES],
    pub(super) n: usize,
    pub(super) on_ghost: bool,
    /// A whole 4x4 block of pixels, row by row, on one surface: it is probed.
    pub(super) coherent: bool,
    /// Lights that something virtual may keep from a ghost point.
    pub(super) lights: LightSet,
    /// Lights that something transmissive may be before.
    pub(super) glass: LightSet,
    /// Lanes of ghost points that photons light, and their irradiance.
    pub(super) lit: u16,
    pub(super) photons: [Vec3A; LANES],
    pub(super) answers: [Visibility; LANES],
    /// Change of ambient light on ghost points.
    pub(super) ambient: [AmbientChange; LANES],
    /// Irradiance with everything and with real things only: sums over lights, and for ghost
    /// points over what virtual and real things take of each.
    pub(super) mixed: [Vec3A; LANES],
    pub(super) real: [Vec3A; LANES],
    /// What virtual surfaces mirror of lamps, with and without what is in the way.
    pub(super) gloss: [[Vec3A; 2]; LANES],
    /// Lanes where something virtual takes light away.
    pub(super) touched: u16,
    pub(super) cast: Cast,
}

impl ShadowGroup {
    fn new() -> Self {
        Self {
            points: [ShadowPoint::NOWHERE; LANES],
            n: 0,
            on_ghost: false,
            coherent: false,
            lights: LightSet::default(),
            glass: LightSet::default(),
            lit: 0,
            photons: [Vec3A::ZERO; LANES],
            ambient: [AmbientChange::default(); LANES],
            answers: [Visibility {
                share: Vec3A::ONE,
                gloss: Vec3A::ONE,
                penumbra: false,
            }; LANES],
            mixed: [Vec3A::ZERO; LANES],
            real: [Vec3A::ZERO; LANES],
            gloss: [[Vec3A::ZERO; 2]; LANES],
            touched: 0,
            cast: Cast::default(),
        }
    }

    /// Adds a point, the next lane.
    pub(super) fn push(&mut self, point: ShadowPoint) {
        self.points[self.n] = point;
        self.ambient[self.n] = AmbientChange::default();
        self.n += 1;
    }

    /// Adds a point that photons of irradiance `e` light; its normal is known.
    pub(super) fn push_lit(&mut self, point: ShadowPoint, e: Vec3A) {
        self.lit |= 1 << self.n;
        self.photons[self.n] = e;
        self.push(point);
    }

    /// Says how the ambient light of the last point changes.
    pub(super) fn set_ambient(&mut self, change: AmbientChange) {
        self.ambient[self.n - 1] = change;
    }

    /// Points and their answers.
    pub(super) fn answered(&self) -> impl Iterator<Item = (&ShadowPoint, &Visibility)> {
        self.points.iter().zip(&self.answers).take(self.n)
    }

    /// Whether the points are a whole 4x4 block without an edge: over its three steps depth changes
    /// by no more than `edge_relative` lets three neighbours differ.
    pub(super) fn is_one_surface(&self, edge_relative: f32) -> bool {
        let depths = self.points[..self.n].iter().map(|point| point.origin.z);
        let (near, far) = depths.fold((f32::INFINITY, 0.0f32), |(near, far), z| {
            (near.min(z), far.max(z))
        });
        self.n == LANES && far - near <= 3.0 * edge_relative * near
    }

    /// The lanes as at most two sets that lie together: a block across an edge has near points and
    /// far ones, and nothing between them.
    pub(super) fn sheets(&self) -> [u16; 2] {
        let all = (u32::MAX >> (u32::BITS - self.n as u32)) as u16;
        if self.coherent {
            return [all, 0];
        }
        let depths = || self.points[..self.n].iter().map(|point| point.origin.z);
        let (near, far) = depths().fold((f32::INFINITY, 0.0f32), |(near, far), z| {
            (near.min(z), far.max(z))
        });
        let middle = 0.5 * (near + far);
        let behind = depths().enumerate().fold(0, |behind, (lane, z)| {
            behind | u16::from(z > middle) << lane
        });
        [all & !behind, behind]
    }

    /// A ball around the points of some lanes.
    pub(super) fn ball(&self, sheet: u16) -> (Vec3A, f32) {
        let (low, high) = lanes(sheet).fold(
            (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY)),
            |(low, high), lane| {
                let p = self.points[lane].origin;
                (low.min(p), high.max(p))
            },
        );
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }
}

/// Points asked about at once where there may be any number: bounds what their groups hold.
pub(super) const POINTS_AT_ONCE: usize = 64 * LANES;

/// Groups and buffers of a thread, and its counts of rays and points.
#[derive(Default)]
pub(super) struct ShadowScratch {
    pub(super) groups: Vec<ShadowGroup>,
    pub(super) n_groups: usize,
    pub(super) rays: Vec<Ray>,
    /// Of each ray: group, sample of the chunk, lane.
    pub(super) owners: Vec<(u32, u8, u8)>,
    pub(super) blocked: Vec<bool>,
    pub(super) photons: PhotonLight,
    pub(super) stats: FrameStats,
}

impl ShadowScratch {
    /// Forgets all groups.
    pub(super) fn clear(&mut self) {
        self.n_groups = 0;
    }

    /// Adds points on virtual surfaces, neighbours in groups.
    pub(super) fn object_points(&mut self, points: impl IntoIterator<Item = ShadowPoint>) {
        let mut points = points.into_iter().peekable();
        while points.peek().is_some() {
            let group = self.group(false, LightSet::ALL, LightSet::ALL);
            for point in points.by_ref().take(LANES) {
                group.push(point);
            }
        }
    }

    /// Adds points on virtual surfaces from a 4x4 block of pixels, row by row.
    pub(super) fn object_block(
        &mut self,
        points: impl IntoIterator<Item = ShadowPoint>,
        edge_relative: f32,
    ) {
        let before = self.n_groups;
        self.object_points(points);
        if let Some(group) = self.groups[..self.n_groups].get_mut(before) {
            group.coherent = group.is_one_surface(edge_relative);
        }
    }

    /// An empty group.
    pub(super) fn group(
        &mut self,
        on_ghost: bool,
        lights: LightSet,
        glass: LightSet,
    ) -> &mut ShadowGroup {
        if self.n_groups == self.groups.len() {
            self.groups.push(ShadowGroup::new());
        }
        let group = &mut self.groups[self.n_groups];
        self.n_groups += 1;
        group.n = 0;
        group.on_ghost = on_ghost;
        group.coherent = false;
        group.lights = lights;
        group.glass = glass;
        group.lit = 0;
        group
    }

    /// All groups since they were last forgotten, in order.
    pub(super) fn groups(&self) -> &[ShadowGroup] {
        &self.groups[..self.n_groups]
    }
}

/// Samples cast at once: bounds the records kept between the virtual and the real half.
pub(super) const CHUNK: usize = 16;

/// The rays to real occluders of a chunk of samples.
pub(super) struct Buffers<'a> {
    pub(super) rays: &'a mut Vec<Ray>,
    pub(super) owners: &'a mut Vec<(u32, u8, u8)>,
    pub(super) blocked: &'a mut Vec<bool>,
    /// Some group got no proof that nothing real is between it and the present light.
    pub(super) light_unclear: bool,
}

/// Lanes at the corners of a 4x4 block.
pub(super) const CORNERS: u16 = 0b1001_0000_0000_1001;

/// The pixels of a tile, a bit for each, row by row.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct PixelSet([u16; TILE as usize]);

impl PixelSet {
    /// Puts in a pixel, wherever the tile lies in the picture.
    pub(super) fn insert(&mut self, x: u32, y: u32) {
        self.0[(y % TILE) as usize] |= 1 << (x % TILE);
    }

    pub(super) fn contains(&self, x: u32, y: u32) -> bool {
        self.0[(y % TILE) as usize] >> (x % TILE) & 1 != 0
    }

    /// The pixels, and those to their left, right, above and below within the tile.
    pub(super) fn widened(&self) -> Self {
        let row = |y: usize| self.0.get(y).copied().unwrap_or(0);
        Self(std::array::from_fn(|y| {
            row(y) | row(y) << 1 | row(y) >> 1 | row(y.wrapping_sub(1)) | row(y + 1)
        }))
    }
}

/// One sample of a light from sixteen points, a bit per lane.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    /// Lanes that it has been cast from.
    pub(super) cast: u16,
    pub(super) virtual_blocked: u16,
    pub(super) real_blocked: u16,
    /// Glass is in the way: `glass` tells which.
    pub(super) tinted: u16,
    pub(super) glass: [u32; LANES],
}

impl Sample {
    pub(super) const OPEN: Self = Self {
        cast: 0,
        virtual_blocked: 0,
        real_blocked: 0,
        tinted: 0,
        glass: [0; LANES],
    };
}

/// What is known of one light from sixteen points: per lane sums over the samples so far.
pub(super) struct Cast {
    /// Meaningful for lanes that are asked.
    pub(super) discs: [LightDisc; LANES],
    /// Lanes whose discs are open.
    pub(super) opened: u16,
    /// Of the pattern.
    pub(super) rotations: [u8; LANES],
    pub(super) samples: [Sample; CHUNK],
    /// Lanes that each sample is to be cast from next.
    pub(super) todo: [u16; CHUNK],
    /// Lanes whose light is not clear from the start.
    pub(super) asked: u16,
    /// Lanes that the present samples are cast from.
    pub(super) active: u16,
    /// Those of them that look for real occluders.
    pub(super) relevant: u16,
    /// Rays cast so far.
    pub(super) n_rays: [u32; LANES],
    pub(super) weight: [f32; LANES],
    pub(super) mixed_lit: [Vec3A; LANES],
    pub(super) real_lit: [f32; LANES],
    /// Nothing virtual is in the way of any lane.
    pub(super) virtual_clear: bool,
    /// Something transmissive may be.
    pub(super) glass: bool,
    /// Lanes where something virtual takes light away.
    pub(super) touched: u16,
    pub(super) penumbra: u16,
    /// Lanes beside penumbra: they have cast the outer samples.
    pub(super) beside: u16,
    pub(super) ever_blocked: u16,
    pub(super) ever_lit: u16,
    pub(super) ever_real_blocked: u16,
    pub(super) ever_real_lit: u16,
    pub(super) real_lit_everywhere: u16,
    /// Lanes of which it was asked whether anything real can be in the way.
    pub(super) clear_asked: u16,
    /// Those of them where it is proven that nothing is.
    pub(super) clear: u16,
}

impl Default for Cast {
    fn default() -> Self {
        Self {
            discs: [LightDisc::default(); LANES],
            opened: 0,
            rotations: [0; LANES],
            samples: [Sample::OPEN; CHUNK],
            todo: [0; CHUNK],
            asked: 0,
            active: 0,
            relevant: 0,
            n_rays: [0; LANES],
            weight: [0.0; LANES],
            mixed_lit: [Vec3A::ZERO; LANES],
            real_lit: [0.0; LANES],
            virtual_clear: false,
            glass: false,
            touched: 0,
            penumbra: 0,
            beside: 0,
            ever_blocked: 0,
            ever_lit: 0,
            ever_real_blocked: 0,
            ever_real_lit: 0,
            real_lit_everywhere: 0,
            clear_asked: 0,
            clear: 0,
        }
    }
}

impl Cast {
    /// Nothing is asked any more. What only asked lanes read is left alone.
    pub(super) fn reset(&mut self) {
        self.n_rays = [0; LANES];
        self.weight = [0.0; LANES];
        self.mixed_lit = [Vec3A::ZERO; LANES];
        self.real_lit = [0.0; LANES];
        (self.asked, self.active, self.relevant) = (0, 0, 0);
        (self.touched, self.penumbra, self.beside) = (0, 0, 0);
        (self.ever_blocked, self.ever_lit) = (0, 0);
        (self.ever_real_blocked, self.ever_real_lit) = (0, 0);
        self.real_lit_everywhere = 0;
        (self.virtual_clear, self.glass) = (false, false);
        (self.opened, self.clear_asked, self.clear) = (0, 0, 0);
    }

    /// Whether samples already cast differ in what virtual things leave of the light.
    pub(super) fn virtual_disagreement(&self, chunk: &Range<usize>) -> bool {
        let samples = &self.samples[..chunk.len()];
        let tinted = samples.iter().any(|sample| sample.tinted != 0);
        let blocked = samples.iter().any(|sample| sample.virtual_blocked != 0);
        let open = samples
            .iter()
            .any(|sample| sample.cast & !sample.virtual_blocked != 0);
        tinted || (blocked && open)
    }

    /// Whether samples already cast differ in what real things leave of the light.
    pub(super) fn real_disagreement(&self, chunk: &Range<usize>) -> bool {
        let samples = &self.samples[..chunk.len()];
        let blocked = samples.iter().any(|sample| sample.real_blocked != 0);
        let open = samples
            .iter()
            .any(|sample| sample.cast & self.relevant & !sample.real_blocked != 0);
        blocked && open
    }

    /// What is left of the samples is to do: the lanes that have not cast them.
    pub(super) fn rest_of(&mut self, chunk: &Range<usize>) {
        let samples = &self.samples[..chunk.len()];
        for (todo, sample) in self.todo.iter_mut().zip(samples) {
            *todo = self.active & !sample.cast;
        }
    }

    /// Adds rays and points to a frame's counts.
    pub(super) fn count(&self, stats: &mut FrameStats) {
        for lane in lanes(self.asked) {
            let n_rays = u64::from(self.n_rays[lane]);
            let penumbra = self.penumbra & (1 << lane) != 0;
            stats.shadow_points += 1;
            stats.shadow_rays += n_rays;
            stats.penumbra_points += u64::from(penumbra);
            stats.penumbra_rays += if penumbra { n_rays } else { 0 };
        }
    }

    /// Lanes whose samples do not all say the same, of everything or of real things.
    pub(super) fn disagreement(&self) -> u16 {
        (self.ever_blocked & self.ever_lit) | (self.ever_real_blocked & self.ever_real_lit)
    }
}

/// Set bits, lowest first.
pub(super) fn lanes(mut mask: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        (mask != 0).then(|| {
            mask &= mask - 1;
            lane
        })
    })
}

impl Buffers<'_> {
    /// Forgets the rays.
    pub(super) fn clear(&mut self) {
        self.rays.clear();
        self.owners.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widening_adds_the_four_neighbours_within_the_tile() {
        const { assert!(TILE == u16::BITS) };
        for (x, y) in (0..TILE).flat_map(|y| (0..TILE).map(move |x| (x, y))) {
            let mut one = PixelSet::default();
            one.insert(x + 3 * TILE, y + TILE);
            let wide = one.widened();
            for (i, j) in (0..TILE).flat_map(|j| (0..TILE).map(move |i| (i, j))) {
                let near = x.abs_diff(i) + y.abs_diff(j) <= 1;
                assert_eq!(wide.contains(i, j), near, "{x} {y}: {i} {j}");
            }
        }
    }
}

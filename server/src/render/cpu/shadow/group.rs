//! Groups of neighbouring points whose light visibility is queried together, and the state of a query.

use std::ops::Range;

use glam::Vec3A;

use crate::accel::Ray;
use crate::render::cpu::ambient::change::AmbientChange;
use crate::render::cpu::photons::light::PhotonLight;
use crate::render::cpu::tile::LightShare;
use crate::render::prepare::light::LightDisc;
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::LightSet;
use crate::render::stats::FrameStats;
use crate::simd::{LANES, LaneMask};

/// A point at which light visibility is needed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShadowPoint {
    /// Origin of rays, already offset from its own surface by the rounding error of the point.
    pub(crate) origin: Vec3A,
    /// Unit normal; for ghost points computed only when needed.
    pub(crate) normal: Vec3A,
    pub(crate) gloss: Gloss,
    /// One ray to each light's centre is enough: the point is one of many in a rough reflection.
    pub(crate) coarse: bool,
    /// Pixel, for the pattern's rotation and the ghost normal.
    pub(crate) x: u32,
    pub(crate) y: u32,
}

/// Parameters of a surface's specular reflection, which weight its highlights.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Gloss {
    /// Unit direction of the ray that hit the surface.
    pub(crate) incoming: Vec3A,
    /// GGX alpha; 0 for no highlights.
    pub(crate) alpha: f32,
}

impl ShadowPoint {
    /// A point on a virtual surface that is shaded for pixel (x, y).
    pub(crate) fn on_object(surface: &Surface, x: u32, y: u32) -> Self {
        Self {
            origin: surface.leave(surface.geometric_normal),
            normal: surface.normal,
            gloss: Gloss {
                incoming: surface.incoming,
                alpha: surface.roughness * surface.roughness,
            },
            coarse: false,
            x,
            y,
        }
    }

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

/// Light visibility of one point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Visibility {
    /// On the ghost surface Em / Er; on a virtual surface the lit share of direct light.
    pub(crate) share: Vec3A,
    /// Lit share of a virtual surface's specular reflection of lamps.
    pub(crate) gloss: Vec3A,
    pub(crate) penumbra: bool,
}

impl Visibility {
    /// The share of light of a virtual surface.
    pub(crate) fn of_object(&self) -> LightShare {
        LightShare {
            diffuse: self.share,
            gloss: self.gloss,
            ambient: Vec3A::ZERO,
        }
    }
}

/// Up to sixteen points of one kind.
pub(crate) struct ShadowGroup {
    pub(crate) points: [ShadowPoint; LANES],
    pub(crate) n: usize,
    pub(crate) on_ghost: bool,
    /// The group is a whole 4x4 block of pixels, row by row, on one surface, so it can be probed.
    pub(crate) coherent: bool,
    /// Lights that virtual objects may block from a ghost point.
    pub(crate) lights: LightSet,
    /// Lights that transmissive objects may be in front of.
    pub(crate) glass: LightSet,
    /// Lanes of ghost points with photons, and the photons' irradiance.
    pub(crate) lit: u16,
    pub(crate) photons: [Vec3A; LANES],
    pub(crate) answers: [Visibility; LANES],
    /// Change of ambient light on ghost points.
    pub(crate) ambient: [AmbientChange; LANES],
    /// Irradiance with all objects and with real objects only: sums over lights; for ghost points, sums of the
    /// light that virtual and real occluders remove.
    pub(crate) mixed: [Vec3A; LANES],
    pub(crate) real: [Vec3A; LANES],
    /// Specular reflection of lamps on virtual surfaces, with and without occluders.
    pub(crate) gloss: [[Vec3A; 2]; LANES],
    /// Lanes at which virtual objects remove light.
    pub(crate) touched: u16,
    pub(crate) query: LightQuery,
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
            query: LightQuery::default(),
        }
    }

    /// Adds a point in the next lane.
    pub(crate) fn push(&mut self, point: ShadowPoint) {
        self.points[self.n] = point;
        self.ambient[self.n] = AmbientChange::default();
        self.n += 1;
    }

    /// Adds a point with photons of irradiance `e`; its normal is known.
    pub(crate) fn push_lit(&mut self, point: ShadowPoint, e: Vec3A) {
        self.lit |= 1 << self.n;
        self.photons[self.n] = e;
        self.push(point);
    }

    /// Sets the change of ambient light of the last point.
    pub(crate) fn set_ambient(&mut self, change: AmbientChange) {
        self.ambient[self.n - 1] = change;
    }

    /// Points and their results.
    pub(crate) fn answered(&self) -> impl Iterator<Item = (&ShadowPoint, &Visibility)> {
        self.points.iter().zip(&self.answers).take(self.n)
    }

    /// Whether the points are a whole 4x4 block without a depth edge: over its three steps, depth differs by no
    /// more than `edge_relative` allows between three neighbours.
    pub(crate) fn is_one_surface(&self, edge_relative: f32) -> bool {
        let depths = self.points[..self.n].iter().map(|point| point.origin.z);
        let (near, far) = depths.fold((f32::INFINITY, 0.0f32), |(near, far), z| {
            (near.min(z), far.max(z))
        });
        self.n == LANES && far - near <= 3.0 * edge_relative * near
    }

    /// Splits the lanes into at most two clusters: a block across a depth edge has near points and far ones, and
    /// none between them.
    pub(crate) fn clusters(&self) -> [u16; 2] {
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

    /// A sphere around the points of some lanes.
    pub(crate) fn ball(&self, sheet: u16) -> (Vec3A, f32) {
        let (low, high) = LaneMask(sheet).into_iter().fold(
            (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY)),
            |(low, high), lane| {
                let p = self.points[lane].origin;
                (low.min(p), high.max(p))
            },
        );
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }
}

/// Most points of one query if their number is unlimited: bounds the memory of their groups.
pub(crate) const POINTS_AT_ONCE: usize = 64 * LANES;

/// Groups and buffers of a thread, with counts of rays and points.
#[derive(Default)]
pub(crate) struct ShadowScratch {
    pub(crate) groups: Vec<ShadowGroup>,
    pub(crate) n_groups: usize,
    pub(crate) rays: Vec<Ray>,
    /// For each ray: group, sample of the chunk, lane.
    pub(crate) owners: Vec<(u32, u8, u8)>,
    pub(crate) blocked: Vec<bool>,
    pub(crate) photons: PhotonLight,
    pub(crate) stats: FrameStats,
}

impl ShadowScratch {
    /// Removes all groups.
    pub(crate) fn clear(&mut self) {
        self.n_groups = 0;
    }

    /// Adds points on virtual surfaces, with neighbours in groups.
    pub(crate) fn object_points(&mut self, points: impl IntoIterator<Item = ShadowPoint>) {
        let mut points = points.into_iter().peekable();
        while points.peek().is_some() {
            let group = self.group(false, LightSet::ALL, LightSet::ALL);
            for point in points.by_ref().take(LANES) {
                group.push(point);
            }
        }
    }

    /// Adds points on virtual surfaces from a 4x4 block of pixels, row by row.
    pub(crate) fn object_block(
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
    pub(crate) fn group(
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

    /// All groups since the last [`Self::clear`], in order.
    pub(crate) fn groups(&self) -> &[ShadowGroup] {
        &self.groups[..self.n_groups]
    }
}

/// Samples cast at once: bounds the records kept between casting virtual and real rays.
pub(crate) const CHUNK: usize = 16;

/// Rays to real occluders for a chunk of samples.
pub(crate) struct Buffers<'a> {
    pub(crate) rays: &'a mut Vec<Ray>,
    pub(crate) owners: &'a mut Vec<(u32, u8, u8)>,
    pub(crate) blocked: &'a mut Vec<bool>,
    /// Some group may have real occluders for the current light.
    pub(crate) light_unclear: bool,
}

/// Lanes at the corners of a 4x4 block.
pub(crate) const CORNERS: u16 = 0b1001_0000_0000_1001;

/// One sample of a light from sixteen points, one bit per lane.
#[derive(Clone, Copy)]
pub(crate) struct Sample {
    /// Lanes from which it has been cast.
    pub(crate) cast: u16,
    pub(crate) virtual_blocked: u16,
    pub(crate) real_blocked: u16,
    /// Lanes whose ray crosses a transmissive object, which is `glass` of the lane.
    pub(crate) tinted: u16,
    pub(crate) glass: [u32; LANES],
}

impl Sample {
    pub(crate) const OPEN: Self = Self {
        cast: 0,
        virtual_blocked: 0,
        real_blocked: 0,
        tinted: 0,
        glass: [0; LANES],
    };
}

/// Visibility of one light from the points of a group: sums over the samples so far, per lane.
pub(crate) struct LightQuery {
    /// Meaningful for lanes in `asked`.
    pub(crate) discs: [LightDisc; LANES],
    /// Lanes whose discs have their axes computed.
    pub(crate) opened: u16,
    /// Rotation of the light samples per lane.
    pub(crate) rotations: [u8; LANES],
    pub(crate) samples: [Sample; CHUNK],
    /// Lanes from which each sample is to be cast next.
    pub(crate) todo: [u16; CHUNK],
    /// Lanes that need rays to this light.
    pub(crate) asked: u16,
    /// Lanes that need the current samples.
    pub(crate) active: u16,
    /// Active lanes for which real occluders matter.
    pub(crate) relevant: u16,
    /// Rays cast so far.
    pub(crate) n_rays: [u32; LANES],
    pub(crate) weight: [f32; LANES],
    pub(crate) mixed_lit: [Vec3A; LANES],
    pub(crate) real_lit: [f32; LANES],
    /// No lane has a virtual occluder.
    pub(crate) virtual_clear: bool,
    /// A transmissive object may be on the way.
    pub(crate) glass: bool,
    /// Masks of the virtual objects that block these rays, and of those that tint them.
    pub(crate) stops: u8,
    pub(crate) tints: u8,
    /// Lanes at which virtual objects remove light.
    pub(crate) touched: u16,
    pub(crate) penumbra: u16,
    /// Lanes beside penumbra, which have cast the outer samples.
    pub(crate) beside: u16,
    pub(crate) ever_blocked: u16,
    pub(crate) ever_lit: u16,
    pub(crate) ever_real_blocked: u16,
    pub(crate) ever_real_lit: u16,
    pub(crate) real_lit_everywhere: u16,
    /// Lanes for which a proof that there is no real occluder was tried.
    pub(crate) clear_asked: u16,
    /// Lanes where that proof succeeded.
    pub(crate) clear: u16,
}

impl Default for LightQuery {
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
            stops: 0,
            tints: 0,
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

impl LightQuery {
    /// Resets the query for another light. Fields that are only read for lanes in `asked` keep their old values.
    pub(crate) fn reset(&mut self) {
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

    /// Whether the samples cast so far disagree about virtual occluders.
    pub(crate) fn virtual_disagreement(&self, chunk: &Range<usize>) -> bool {
        let samples = &self.samples[..chunk.len()];
        let tinted = samples.iter().any(|sample| sample.tinted != 0);
        let blocked = samples.iter().any(|sample| sample.virtual_blocked != 0);
        let open = samples
            .iter()
            .any(|sample| sample.cast & !sample.virtual_blocked != 0);
        tinted || (blocked && open)
    }

    /// Whether the samples cast so far disagree about real occluders.
    pub(crate) fn real_disagreement(&self, chunk: &Range<usize>) -> bool {
        let samples = &self.samples[..chunk.len()];
        let blocked = samples.iter().any(|sample| sample.real_blocked != 0);
        let open = samples
            .iter()
            .any(|sample| sample.cast & self.relevant & !sample.real_blocked != 0);
        blocked && open
    }

    /// Adds the samples that active lanes have not cast yet to `todo`.
    pub(crate) fn rest_of(&mut self, chunk: &Range<usize>) {
        let samples = &self.samples[..chunk.len()];
        for (todo, sample) in self.todo.iter_mut().zip(samples) {
            *todo = self.active & !sample.cast;
        }
    }

    /// Adds the numbers of rays and points to a frame's counts.
    pub(crate) fn count(&self, stats: &mut FrameStats) {
        for lane in LaneMask(self.asked) {
            let n_rays = u64::from(self.n_rays[lane]);
            let penumbra = self.penumbra & (1 << lane) != 0;
            stats.shadow_points += 1;
            stats.shadow_rays += n_rays;
            stats.penumbra_points += u64::from(penumbra);
            stats.penumbra_rays += if penumbra { n_rays } else { 0 };
        }
    }

    /// Lanes whose samples disagree, about virtual or about real occluders.
    pub(crate) fn disagreement(&self) -> u16 {
        (self.ever_blocked & self.ever_lit) | (self.ever_real_blocked & self.ever_real_lit)
    }
}

impl Buffers<'_> {
    /// Removes the rays.
    pub(crate) fn clear(&mut self) {
        self.rays.clear();
        self.owners.clear();
    }
}

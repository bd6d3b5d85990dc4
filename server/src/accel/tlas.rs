//! Many meshes in camera space: instances, their boxes, and the tree over them, rebuilt per frame.

use std::sync::Arc;

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use glam::{Affine3A, DMat3, DVec3, Vec3A};

use super::packet::{self, Eight, Found, PacketTarget, Rays, Sixteen, Width};
use super::ray::{Columns, Slabs, SpaceRay, transform_point, transform_vector};
use super::split::BinaryTree;
use super::wide::{self, Target};
use super::{Blas, Hit, HitFilter, HitPacket, NO_HIT, PacketFilter, Ray, RayPacket, scalar};
use crate::numerics::UNIT_ROUNDOFF;

/// Widening of a camera-space box relative to `|origin| + |scene|`, per unit of the worst
/// instance's condition number k = |A| |A^-1| (maximum norms).
///
/// A hit lies in a leaf's box widened by 16 u (object space, `ray::PAD`), which A carries to at
/// most 16 k u. The object-space ray is off by the transform's roundings: 6 u for the origin (each entry rounded,
/// a product, three sums), 5 u for the direction over its whole length, again times k. The slab test
/// adds 4 u. Sum 31 u; 48 leaves room for second-order terms.
const PAD: f32 = 48.0 * UNIT_ROUNDOFF;

/// Instances in a leaf of the tree: up to this many are a plain loop.
const LEAF_SIZE: u32 = 4;

/// The tree is halved at medians, so even 2^32 instances make it 32 deep; the walk keeps one
/// sibling per level.
const STACK: usize = 40;

/// A mesh placed in the frame.
#[derive(Debug, Clone)]
pub struct TlasInstance {
    /// The mesh.
    pub blas: Arc<Blas>,
    /// Camera from object space. May mirror and scale unevenly; an instance whose transform has
    /// no finite inverse is skipped.
    pub camera_from_object: Affine3A,
    /// [`super::MASK_VIRTUAL`], [`super::MASK_GHOST`]: rays see it if any bit is in their mask.
    pub mask: u8,
    /// Whether hits are put to a query's filter, for alpha-masked textures.
    pub filtered: bool,
}

#[derive(Debug)]
struct Instance {
    blas: Arc<Blas>,
    /// Object (centred) from camera.
    columns: Columns,
    mask: u8,
    filtered: bool,
    /// Camera-space box; `None` if no ray can hit it.
    bounds: Option<(Vec3A, Vec3A)>,
}

/// All instances of a frame.
#[derive(Debug)]
pub struct Tlas {
    level: Level,
    instances: Vec<Instance>,
    tree: BinaryTree,
    /// [`PAD`] times the worst condition number.
    pad: f32,
    /// Largest camera-space coordinate of any box.
    extent: f32,
}

impl Default for Tlas {
    fn default() -> Self {
        Self::new()
    }
}

impl Tlas {
    /// No instances yet; the best instruction set of this machine.
    pub fn new() -> Self {
        Self::with_level(Level::new())
    }

    /// No instances yet; the given instruction set.
    pub fn with_level(level: Level) -> Self {
        Self {
            level,
            instances: Vec::new(),
            tree: BinaryTree::default(),
            pad: 0.0,
            extent: 0.0,
        }
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Replaces all instances. Allocates only while their number exceeds all earlier ones.
    pub fn rebuild(&mut self, instances: &[TlasInstance]) {
        self.instances.clear();
        let mut condition = 1.0_f64;
        let mut extent = 0.0_f32;
        for source in instances {
            let placed = place(source);
            let (columns, bounds) = match placed {
                Some(placed) => {
                    condition = condition.max(placed.condition);
                    let (low, high) = placed.bounds;
                    extent = extent.max(low.abs().max(high.abs()).max_element());
                    (placed.columns, Some(placed.bounds))
                }
                None => ([Vec3A::ZERO; 4], None),
            };
            self.instances.push(Instance {
                blas: Arc::clone(&source.blas),
                columns,
                mask: source.mask,
                filtered: source.filtered,
                bounds,
            });
        }
        self.pad = PAD * condition as f32;
        self.extent = extent;
        let placed = &self.instances;
        self.tree.rebuild(placed.len() as u32, LEAF_SIZE, |i| {
            placed[i as usize].bounds
        });
    }

    /// Number of instances, skipped ones included.
    pub fn len(&self) -> usize {
        self.instances.len()
    }

    /// Whether there are no instances.
    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }

    /// Camera-space box of an instance, conservative; `None` if no ray can hit it.
    pub fn bounds(&self, instance: u32) -> Option<(Vec3A, Vec3A)> {
        self.instances.get(instance as usize)?.bounds
    }

    /// Nearest hit with `t_min <= t <= t_max` on instances that share a bit with `mask`. Among
    /// equal `t` the lowest instance, then the lowest triangle.
    pub fn intersect(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        dispatch!(self.level, simd => self.find::<_, false>(simd, ray, mask, None))
    }

    /// Whether anything lies between `t_min` and `t_max`.
    pub fn occluded(&self, ray: &Ray, mask: u8) -> bool {
        dispatch!(self.level, simd => self.find::<_, true>(simd, ray, mask, None)).is_some()
    }

    /// [`Tlas::intersect`] that asks `filter` about hits on filtered instances.
    pub fn intersect_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> Option<Hit> {
        dispatch!(self.level, simd => self.find::<_, false>(simd, ray, mask, Some(filter)))
    }

    /// [`Tlas::occluded`] that asks `filter` about hits on filtered instances.
    pub fn occluded_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> bool {
        dispatch!(self.level, simd => self.find::<_, true>(simd, ray, mask, Some(filter))).is_some()
    }

    /// [`Tlas::intersect`] in plain code.
    pub fn intersect_scalar(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        self.find_scalar(ray, mask, false, None)
    }

    /// [`Tlas::occluded`] in plain code.
    pub fn occluded_scalar(&self, ray: &Ray, mask: u8) -> bool {
        self.find_scalar(ray, mask, true, None).is_some()
    }

    /// [`Tlas::intersect_filtered`] in plain code.
    pub fn intersect_filtered_scalar(
        &self,
        ray: &Ray,
        mask: u8,
        filter: HitFilter<'_>,
    ) -> Option<Hit> {
        self.find_scalar(ray, mask, false, Some(filter))
    }

    /// [`Tlas::intersect`] for the lanes whose bit is set in `active`; overwrites all of `hits`.
    pub fn intersect_packet(&self, rays: &RayPacket, active: u16, mask: u8, hits: &mut HitPacket) {
        dispatch!(self.level, simd => self.find_packet(simd, rays, active, mask, None, hits));
    }

    /// [`Tlas::intersect_packet`] that asks `filter` about hits on filtered instances.
    pub fn intersect_packet_filtered(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: PacketFilter<'_>,
        hits: &mut HitPacket,
    ) {
        dispatch!(self.level, simd => {
            self.find_packet(simd, rays, active, mask, Some(filter), hits);
        });
    }

    /// [`Tlas::occluded`] for the lanes whose bit is set in `active`; their bits are set in the
    /// result where something is in the way.
    pub fn occluded_packet(&self, rays: &RayPacket, active: u16, mask: u8) -> u16 {
        dispatch!(self.level, simd => self.any_packet(simd, rays, active, mask, None))
    }

    /// [`Tlas::occluded_packet`] that asks `filter` about hits on filtered instances.
    pub fn occluded_packet_filtered(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: PacketFilter<'_>,
    ) -> u16 {
        dispatch!(self.level, simd => self.any_packet(simd, rays, active, mask, Some(filter)))
    }

    #[inline(always)]
    fn find<S: Simd, const ANY: bool>(
        &self,
        simd: S,
        ray: &Ray,
        mask: u8,
        filter: Option<HitFilter<'_>>,
    ) -> Option<Hit> {
        let mut best = nothing(ray);
        let mut candidates = Candidates::new(self, ray, mask)?;
        while let Some(index) = candidates.next(best.t) {
            let instance = &self.instances[index as usize];
            if let Some(space) = instance.enter(ray) {
                let target = instance.target(index, filter);
                if wide::walk::<S, ANY>(simd, &instance.blas, &space, target, &mut best) && ANY {
                    break;
                }
            }
        }
        (best.instance != NO_HIT).then_some(best)
    }

    fn find_scalar(
        &self,
        ray: &Ray,
        mask: u8,
        any: bool,
        filter: Option<HitFilter<'_>>,
    ) -> Option<Hit> {
        let mut best = nothing(ray);
        let mut candidates = Candidates::new(self, ray, mask)?;
        while let Some(index) = candidates.next(best.t) {
            let instance = &self.instances[index as usize];
            if let Some(space) = instance.enter(ray) {
                let target = instance.target(index, filter);
                if scalar::walk(&instance.blas, &space, target, any, &mut best) && any {
                    break;
                }
            }
        }
        (best.instance != NO_HIT).then_some(best)
    }

    #[inline(always)]
    fn find_packet<S: Simd>(
        &self,
        simd: S,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: Option<PacketFilter<'_>>,
        hits: &mut HitPacket,
    ) {
        if S::f32s::LEN >= 16 {
            let found = self.packet::<S, Sixteen, false>(simd, rays, 0, active, mask, filter);
            store(simd, &found, 0, hits);
        } else {
            for first in [0, 8] {
                let found = self.packet::<S, Eight, false>(simd, rays, first, active, mask, filter);
                store(simd, &found, first, hits);
            }
        }
    }

    #[inline(always)]
    fn any_packet<S: Simd>(
        &self,
        simd: S,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: Option<PacketFilter<'_>>,
    ) -> u16 {
        let mut occluded = 0;
        if S::f32s::LEN >= 16 {
            let found = self.packet::<S, Sixteen, true>(simd, rays, 0, active, mask, filter);
            occluded |= hit_bits(simd, &found) as u16;
        } else {
            for first in [0, 8] {
                let found = self.packet::<S, Eight, true>(simd, rays, first, active, mask, filter);
                occluded |= (hit_bits(simd, &found) as u16) << first;
            }
        }
        occluded
    }

    /// The lanes from `first` on that `W` holds. With `ANY`, a lane's instance tells only
    /// whether it was hit.
    #[inline(always)]
    fn packet<S: Simd, W: Width<S>, const ANY: bool>(
        &self,
        simd: S,
        packet: &RayPacket,
        first: usize,
        active: u16,
        mask: u8,
        filter: Option<PacketFilter<'_>>,
    ) -> Found<S, W> {
        let zero = W::F::splat(simd, 0.0);
        let load = |lanes: &[f32; 16]| W::F::from_slice(simd, &lanes[first..first + W::F::LEN]);
        let origin = [
            load(&packet.origin[0]),
            load(&packet.origin[1]),
            load(&packet.origin[2]),
        ];
        let direction = [
            load(&packet.direction[0]) + zero,
            load(&packet.direction[1]) + zero,
            load(&packet.direction[2]) + zero,
        ];
        let (t_min, t_max) = (load(&packet.t_min), load(&packet.t_max));
        let usable = packet::usable::<S, W>(simd, &origin, &direction)
            & t_min.is_finite()
            & t_min.simd_le(t_max)
            & W::M::from_bitmask(simd, u64::from(active >> first));
        // Lanes that are out must not bring NaN into minima, whose result then depends on the
        // instruction set.
        let clean = |x: W::F| usable.select(x, zero);
        let rays = Rays::<S, W> {
            origin: [clean(origin[0]), clean(origin[1]), clean(origin[2])],
            direction: [
                clean(direction[0]),
                clean(direction[1]),
                usable.select(direction[2], W::F::splat(simd, 1.0)),
            ],
            t_min: clean(t_min),
        };
        let done = W::F::splat(simd, f32::NEG_INFINITY);
        let mut found = Found::<S, W> {
            t: usable.select(t_max, done),
            u: zero,
            v: zero,
            instance: W::U::splat(simd, NO_HIT),
            triangle: W::U::splat(simd, NO_HIT),
        };
        if self.tree.nodes.is_empty() {
            return found;
        }
        let (inv, low_origin, high_origin) =
            packet::padded::<S, W>(simd, rays.origin, rays.direction, self.pad, self.extent);
        let mut stack = [0_u32; STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let node = self.tree.nodes[stack[height] as usize];
            if !reaches::<S, W>(
                simd,
                (node.low, node.high),
                [&inv, &low_origin, &high_origin],
                rays.t_min,
                found.t,
            ) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.first + 1;
                stack[height + 1] = node.first;
                height += 2;
                continue;
            }
            for &index in &self.tree.order[node.first as usize..(node.first + node.count) as usize]
            {
                let instance = &self.instances[index as usize];
                let Some(bounds) = instance.bounds.filter(|_| instance.mask & mask != 0) else {
                    continue;
                };
                if node.count > 1
                    && !reaches::<S, W>(
                        simd,
                        bounds,
                        [&inv, &low_origin, &high_origin],
                        rays.t_min,
                        found.t,
                    )
                {
                    continue;
                }
                let target = PacketTarget {
                    instance: index,
                    first_lane: first,
                    filter: filter.filter(|_| instance.filtered),
                };
                packet::walk::<S, W, ANY>(
                    simd,
                    &instance.blas,
                    &instance.columns,
                    &rays,
                    target,
                    &mut found,
                );
            }
        }
        if ANY {
            // Lanes that could have hit and are done were hit.
            let hit = usable & found.t.simd_eq(done);
            found.instance = hit.select(W::U::splat(simd, 0), found.instance);
        }
        found
    }
}

/// The hit that any hit in reach beats.
#[inline(always)]
fn nothing(ray: &Ray) -> Hit {
    Hit {
        t: ray.t_max,
        instance: NO_HIT,
        triangle: NO_HIT,
        u: 0.0,
        v: 0.0,
    }
}

/// Whether any lane enters the box before its nearest hit.
#[inline(always)]
fn reaches<S: Simd, W: Width<S>>(
    simd: S,
    (low, high): (Vec3A, Vec3A),
    [inv, low_origin, high_origin]: [&[W::F; 3]; 3],
    t_min: W::F,
    t: W::F,
) -> bool {
    let (near, far) = packet::slabs::<S, W>(
        simd,
        &low.to_array(),
        &high.to_array(),
        low_origin,
        high_origin,
        inv,
    );
    near.max(t_min).simd_le(far.min(t)).any_true()
}

#[inline(always)]
fn hit_bits<S: Simd, W: Width<S>>(simd: S, found: &Found<S, W>) -> u64 {
    found
        .instance
        .simd_ne(W::U::splat(simd, NO_HIT))
        .to_bitmask()
}

#[inline(always)]
fn store<S: Simd, W: Width<S>>(simd: S, found: &Found<S, W>, first: usize, hits: &mut HitPacket) {
    let lanes = first..first + W::F::LEN;
    let none = found.instance.simd_eq(W::U::splat(simd, NO_HIT));
    let t = none.select(W::F::splat(simd, f32::INFINITY), found.t);
    t.store_slice(&mut hits.t[lanes.clone()]);
    found.u.store_slice(&mut hits.u[lanes.clone()]);
    found.v.store_slice(&mut hits.v[lanes.clone()]);
    found
        .instance
        .store_slice(&mut hits.instance[lanes.clone()]);
    found.triangle.store_slice(&mut hits.triangle[lanes]);
}

impl Instance {
    /// The ray in the mesh's space; `None` if it can hit nothing there.
    #[inline(always)]
    fn enter(&self, ray: &Ray) -> Option<SpaceRay> {
        SpaceRay::new(
            transform_point(&self.columns, ray.origin),
            transform_vector(&self.columns, ray.direction),
            ray.t_min,
            self.blas.extent,
        )
    }

    #[inline(always)]
    fn target<'a>(&self, index: u32, filter: Option<HitFilter<'a>>) -> Target<'a> {
        Target {
            instance: index,
            filter: filter.filter(|_| self.filtered),
        }
    }
}

/// The instances that one ray may hit, nearest subtrees first.
struct Candidates<'a> {
    tlas: &'a Tlas,
    slabs: Slabs,
    mask: u8,
    stack: [u32; STACK],
    height: usize,
    /// What is left of the leaf being visited.
    leaf: std::slice::Iter<'a, u32>,
}

impl<'a> Candidates<'a> {
    /// `None` if the ray can hit nothing.
    #[inline(always)]
    fn new(tlas: &'a Tlas, ray: &Ray, mask: u8) -> Option<Self> {
        let root = tlas.tree.nodes.first()?;
        if !(ray.t_min.is_finite() && ray.t_min <= ray.t_max) {
            return None;
        }
        let slabs = Slabs::new(ray.origin, ray.direction, ray.t_min, tlas.pad, tlas.extent)?;
        // A handful of instances is one leaf, walked without a look at the node.
        let height = usize::from(root.count == 0);
        let leaf = tlas.tree.order[..root.count as usize].iter();
        Some(Self {
            tlas,
            slabs,
            mask,
            stack: [0; STACK],
            height,
            leaf,
        })
    }

    /// The next instance whose box the ray enters no later than `t`.
    #[inline(always)]
    fn next(&mut self, t: f32) -> Option<u32> {
        loop {
            for &index in self.leaf.by_ref() {
                let instance = &self.tlas.instances[index as usize];
                if instance.mask & self.mask != 0
                    && let Some((low, high)) = instance.bounds
                    && enters(&self.slabs, low, high, t).is_some()
                {
                    return Some(index);
                }
            }
            if self.height == 0 {
                return None;
            }
            self.descend(t);
        }
    }

    /// Takes the nearest waiting node: its children wait in its place, or its leaf is next.
    #[inline(never)]
    fn descend(&mut self, t: f32) {
        self.height -= 1;
        let tree = &self.tlas.tree;
        let node = &tree.nodes[self.stack[self.height] as usize];
        if node.count > 0 {
            self.leaf = tree.order[node.first as usize..(node.first + node.count) as usize].iter();
            return;
        }
        let enter = |child: u32| {
            let node = &tree.nodes[child as usize];
            enters(&self.slabs, node.low, node.high, t).map(|near| (near, child))
        };
        // The nearer one goes on top.
        let (under, top) = match (enter(node.first), enter(node.first + 1)) {
            (Some(a), Some(b)) if a.0 < b.0 => (Some(b), Some(a)),
            other => other,
        };
        for (_, child) in [under, top].into_iter().flatten() {
            self.stack[self.height] = child;
            self.height += 1;
        }
    }
}

#[inline(always)]
fn enters(slabs: &Slabs, low: Vec3A, high: Vec3A, t: f32) -> Option<f32> {
    let (near, far) = slabs.cross(low, high);
    (near.max(slabs.t_min) <= far.min(t)).then_some(near)
}

/// An instance's transform, worked out.
struct Placed {
    columns: Columns,
    bounds: (Vec3A, Vec3A),
    /// |A| |A^-1| in the maximum norm.
    condition: f64,
}

/// `None` if the mesh is empty or the transform has no finite inverse.
fn place(source: &TlasInstance) -> Option<Placed> {
    let blas = &source.blas;
    if blas.triangles() == 0 {
        return None;
    }
    // In doubles, so that the one rounding to f32 is all that the inverse loses.
    let matrix: DMat3 = source.camera_from_object.matrix3.as_dmat3();
    let centre = matrix * blas.centre.as_dvec3() + source.camera_from_object.translation.as_dvec3();
    let determinant = matrix.determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let inverse = matrix.inverse();
    let shift = -(inverse * centre);
    let columns: Columns =
        [inverse.x_axis, inverse.y_axis, inverse.z_axis, shift].map(|c| c.as_vec3a());
    let (low, high) = (blas.low.as_dvec3(), blas.high.as_dvec3());
    let middle = centre + matrix * ((low + high) * 0.5);
    let half = matrix.abs() * ((high - low) * 0.5);
    let outward = |v: DVec3, round: fn(f32) -> f32| {
        Vec3A::new(round(v.x as f32), round(v.y as f32), round(v.z as f32))
    };
    let bounds = (
        outward(middle - half, f32::next_down),
        outward(middle + half, f32::next_up),
    );
    let condition = norm(&matrix) * norm(&inverse);
    let finite = columns.iter().all(|c| c.is_finite())
        && bounds.0.is_finite()
        && bounds.1.is_finite()
        && condition.is_finite();
    finite.then_some(Placed {
        columns,
        bounds,
        condition,
    })
}

/// Maximum norm of a matrix: its largest row sum.
fn norm(matrix: &DMat3) -> f64 {
    let abs = matrix.abs();
    (0..3).map(|i| abs.row(i).element_sum()).fold(0.0, f64::max)
}

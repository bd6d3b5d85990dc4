//! Rays and hits, one at a time and sixteen together.

use glam::Vec3A;

/// Instances that are drawn.
pub const MASK_VIRTUAL: u8 = 1;
/// Instances that model real objects: they occlude, receive shadows and are reflected, but are not drawn.
pub const MASK_GHOST: u8 = 2;

/// Instance and triangle number of a lane of [`HitPacket`] that hit nothing.
pub const NO_HIT: u32 = u32::MAX;

/// Called for each candidate hit on an instance with [`TlasInstance::filtered`](super::TlasInstance::filtered);
/// `false` lets the ray pass. The result must depend on the hit alone, because candidates come in no particular
/// order.
pub type HitFilter<'a> = &'a dyn Fn(&Hit) -> bool;

/// [`HitFilter`] for packets, which also gets the lane.
pub type PacketFilter<'a> = &'a (dyn Fn(usize, &Hit) -> bool + Sync);

/// A ray in camera space.
///
/// The direction need not have unit length. A ray hits nothing if its origin or direction is not finite, if its
/// largest direction component is outside 1e-18..=1e18 in size, or if its interval is empty or NaN. Origin components
/// are assumed to be below 1e12.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Where the ray starts, metres.
    pub origin: Vec3A,
    /// Direction, metres per unit of `t`.
    pub direction: Vec3A,
    /// Nearest `t` that counts as a hit (inclusive).
    pub t_min: f32,
    /// Farthest `t` that counts as a hit (inclusive); may be infinite.
    pub t_max: f32,
}

/// Intersection of a ray with a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Position along the ray, in units of its direction.
    pub t: f32,
    /// Index into the instances of [`Tlas::rebuild`](super::Tlas::rebuild).
    pub instance: u32,
    /// Index into the triangles of the instance's mesh.
    pub triangle: u32,
    /// Barycentric weight of the triangle's vertex 1.
    pub u: f32,
    /// Barycentric weight of the triangle's vertex 2.
    pub v: f32,
}

/// Sixteen rays, one per lane. Inactive lanes may hold any values.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct RayPacket {
    /// Origins, by axis and lane; metres.
    pub origin: [[f32; 16]; 3],
    /// Directions, by axis and lane; metres per unit of `t`.
    pub direction: [[f32; 16]; 3],
    /// See [`Ray::t_min`].
    pub t_min: [f32; 16],
    /// See [`Ray::t_max`].
    pub t_max: [f32; 16],
}

impl Default for RayPacket {
    /// Sixteen rays along z with empty intervals: they hit nothing.
    fn default() -> Self {
        Self {
            origin: [[0.0; 16]; 3],
            direction: [[0.0; 16], [0.0; 16], [1.0; 16]],
            t_min: [0.0; 16],
            t_max: [f32::NEG_INFINITY; 16],
        }
    }
}

impl RayPacket {
    /// Puts a ray into a lane (0..16).
    #[inline]
    pub fn set(&mut self, lane: usize, ray: &Ray) {
        for axis in 0..3 {
            self.origin[axis][lane] = ray.origin[axis];
            self.direction[axis][lane] = ray.direction[axis];
        }
        self.t_min[lane] = ray.t_min;
        self.t_max[lane] = ray.t_max;
    }

    /// The ray in a lane (0..16).
    #[inline]
    pub fn get(&self, lane: usize) -> Ray {
        Ray {
            origin: Vec3A::from_array(self.origin.map(|axis| axis[lane])),
            direction: Vec3A::from_array(self.direction.map(|axis| axis[lane])),
            t_min: self.t_min[lane],
            t_max: self.t_max[lane],
        }
    }
}

/// The hits of a [`RayPacket`]; a lane without a hit has `instance == NO_HIT` and infinite `t`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub struct HitPacket {
    /// See [`Hit::t`].
    pub t: [f32; 16],
    /// See [`Hit::instance`]; [`NO_HIT`] for lanes without a hit.
    pub instance: [u32; 16],
    /// See [`Hit::triangle`].
    pub triangle: [u32; 16],
    /// See [`Hit::u`].
    pub u: [f32; 16],
    /// See [`Hit::v`].
    pub v: [f32; 16],
}

impl Default for HitPacket {
    fn default() -> Self {
        Self {
            t: [f32::INFINITY; 16],
            instance: [NO_HIT; 16],
            triangle: [NO_HIT; 16],
            u: [0.0; 16],
            v: [0.0; 16],
        }
    }
}

impl HitPacket {
    /// Puts a hit into a lane (0..16).
    #[inline]
    pub(crate) fn set(&mut self, lane: usize, hit: Hit) {
        self.t[lane] = hit.t;
        self.instance[lane] = hit.instance;
        self.triangle[lane] = hit.triangle;
        self.u[lane] = hit.u;
        self.v[lane] = hit.v;
    }

    /// The hit of a lane (0..16).
    #[inline]
    pub fn get(&self, lane: usize) -> Option<Hit> {
        (self.instance[lane] != NO_HIT).then(|| Hit {
            t: self.t[lane],
            instance: self.instance[lane],
            triangle: self.triangle[lane],
            u: self.u[lane],
            v: self.v[lane],
        })
    }
}

//! Rays as a renderer casts them against a depth map: the fixed sets of experiments and benches.

use std::ops::Range;

use glam::Vec3A;

use super::timer::median;
use ghostlight::accel::Ray;
use ghostlight::frame::depth_sigma_m;
use ghostlight::ghost::{GhostOutcome, GhostSurface};
use ghostlight::numerics::uniform;
use ghostlight::render::Traversal;

/// A function that traces all rays with one traversal.
pub type Tracer = fn(&GhostSurface, &[Ray], &mut [GhostOutcome]);

/// Every traversal, by name.
pub const TRACERS: [(&str, Tracer); 5] = [
    ("bresenham nearest", |surface, rays, out| {
        one_by_one(Traversal::BresenhamNearest, surface, rays, out);
    }),
    ("bresenham floor+ceil", |surface, rays, out| {
        one_by_one(Traversal::Bresenham, surface, rays, out);
    }),
    ("dda", |surface, rays, out| {
        one_by_one(Traversal::Dda, surface, rays, out);
    }),
    ("pyramid, single", |surface, rays, out| {
        one_by_one(Traversal::Pyramid, surface, rays, out);
    }),
    ("pyramid, batch", |surface, rays, out| {
        surface.trace_batch(rays, out);
    }),
];

fn one_by_one(
    traversal: Traversal,
    surface: &GhostSurface,
    rays: &[Ray],
    out: &mut [GhostOutcome],
) {
    for (ray, out) in rays.iter().zip(out) {
        *out = surface.trace(traversal, ray);
    }
}

fn reflect(direction: Vec3A, normal: Vec3A) -> Vec3A {
    direction - 2.0 * direction.dot(normal) * normal
}

/// Secondary rays start away from their surface: `t_min` is a millimetre.
fn ray(origin: Vec3A, direction: Vec3A) -> Ray {
    Ray {
        origin,
        direction,
        t_min: 1e-3,
        t_max: f32::INFINITY,
    }
}

/// A random pixel position on the surface's vertices.
fn position(surface: &GhostSurface, [x, y]: [f32; 2]) -> (f32, f32) {
    (
        x * surface.width().saturating_sub(1) as f32,
        y * surface.height().saturating_sub(1) as f32,
    )
}

/// Reflections off random normals at random points in the free space in front of the surface.
pub fn random_rays(surface: &GhostSurface, numbers: Range<u32>, seed: u32) -> Vec<Ray> {
    numbers
        .map(|k| {
            let r = |dimension| uniform(k, seed, dimension);
            let (u, v) = position(surface, [r(0), r(1)]);
            let view = surface.intrinsics().ray_direction(u, v);
            let z = surface.depth_at(u, v).unwrap_or(2.0) * (0.3 + 0.65 * r(2));
            // Uniform on the sphere, flipped towards the camera.
            let (height, angle) = (2.0 * r(3) - 1.0, std::f32::consts::TAU * r(4));
            let radius = (1.0 - height * height).sqrt();
            let normal = Vec3A::new(radius * angle.cos(), radius * angle.sin(), height);
            let normal = if normal.dot(view) > 0.0 {
                -normal
            } else {
                normal
            };
            ray(view * z, reflect(view, normal))
        })
        .collect()
}

/// A mirror ball in the middle of the picture, in front of the surface.
#[derive(Debug, Clone, Copy)]
pub struct MirrorBall {
    centre: Vec3A,
    radius: f32,
}

impl MirrorBall {
    /// At slightly less than half the surface's median depth.
    pub fn before(surface: &GhostSurface) -> Self {
        let (nx, ny) = (surface.width() / 40 + 1, surface.height() / 40 + 1);
        let mut depths: Vec<f64> = (0..nx * ny)
            .filter_map(|k| surface.w((k % nx) * 40, (k / nx) * 40))
            .map(|w| 1.0 / f64::from(w))
            .collect();
        let depth = median(&mut depths);
        let z = if depth.is_nan() {
            1.0
        } else {
            0.45 * depth as f32
        };
        let (u, v) = position(surface, [0.5, 0.6]);
        Self {
            centre: surface.intrinsics().ray_direction(u, v) * z,
            radius: 0.3 * z,
        }
    }

    /// The camera ray through a pixel position, reflected by the ball; `None` if it misses the ball.
    fn reflection(&self, surface: &GhostSurface, u: f32, v: f32) -> Option<Ray> {
        let view = surface.intrinsics().ray_direction(u, v);
        let (a, b) = (view.length_squared(), view.dot(self.centre));
        let root = b * b - a * (self.centre.length_squared() - self.radius * self.radius);
        (root > 0.0).then(|| {
            let point = view * ((b - root.sqrt()) / a);
            ray(point, reflect(view, (point - self.centre) / self.radius))
        })
    }

    /// Reflections for every pixel that sees the ball, in scan order.
    pub fn rays(&self, surface: &GhostSurface) -> Vec<Ray> {
        let (width, height) = (surface.width(), surface.height());
        (0..width * height)
            .filter_map(|pixel| {
                self.reflection(surface, (pixel % width) as f32, (pixel / width) as f32)
            })
            .collect()
    }

    /// Reflections at random points of the ball; fewer than `numbers`, because some miss.
    pub fn rays_at_random(
        &self,
        surface: &GhostSurface,
        numbers: Range<u32>,
        seed: u32,
    ) -> Vec<Ray> {
        let k = surface.intrinsics();
        let at = |offset: Vec3A| k.project((self.centre + offset).as_dvec3());
        let (left, top) = at(Vec3A::new(-self.radius, -self.radius, 0.0));
        let (right, bottom) = at(Vec3A::new(self.radius, self.radius, 0.0));
        numbers
            .filter_map(|n| {
                let r = |dimension| f64::from(uniform(n, seed, dimension));
                let (u, v) = (left + (right - left) * r(0), top + (bottom - top) * r(1));
                self.reflection(surface, u as f32, v as f32)
            })
            .collect()
    }
}

/// Shadow rays from the surface, offset by the sensor's noise, to points on a lamp above and in front of it; in
/// scan order if `numbers` are.
pub fn shadow_rays(surface: &GhostSurface, numbers: Range<u32>, seed: u32) -> Vec<Ray> {
    numbers
        .filter_map(|k| {
            let r = |dimension| uniform(k, seed, dimension);
            let (u, v) = position(surface, [r(0), r(1)]);
            let view = surface.intrinsics().ray_direction(u, v);
            let z = surface.depth_at(u, v)?;
            let origin = view * (z - 4.0 * depth_sigma_m(z));
            let lamp = Vec3A::new(0.4 + 0.2 * r(2), -0.9 + 0.2 * r(3), 0.4 + 0.2 * r(4)) * z;
            Some(Ray {
                t_max: 1.0,
                ..ray(origin, lamp - origin)
            })
        })
        .collect()
}

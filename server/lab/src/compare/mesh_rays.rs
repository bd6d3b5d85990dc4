//! Rays as a renderer casts them at a mesh: the fixed sets of experiments and benches.

use std::sync::Arc;

use fearless_simd::Level;
use glam::{Affine3A, Quat, Vec3, Vec3A};

use ghostlight::accel::{Blas, MASK_VIRTUAL, Ray, RayPacket, Tlas, TlasInstance};
use ghostlight::numerics::uniform;
use ghostlight::scene::Mesh;

/// Size of the view, pixels.
pub const VIEW: [u32; 2] = [640, 480];
/// `t_min` of the rays; the shortest distance that all compared traversals support.
const T_MIN: f32 = 1e-4;

/// Transform into the view: seen from the front and above, the object covers most of the image.
pub fn placement() -> Affine3A {
    Affine3A::from_rotation_translation(Quat::from_rotation_x(-0.9), Vec3::new(0.0, 0.0, 2.4))
}

/// A mesh placed in the view, for kernels of one instruction set.
pub fn placed(level: Level, blas: &Arc<Blas>) -> Tlas {
    let mut tlas = Tlas::with_level(level);
    tlas.rebuild(&[TlasInstance {
        blas: Arc::clone(blas),
        camera_from_object: placement(),
        mask: MASK_VIRTUAL,
        filtered: false,
    }]);
    tlas
}

/// Primary rays of the view, in blocks of 4x4 pixels, four of which form a tile of 8x8.
pub fn primary() -> Vec<Ray> {
    let [width, height] = VIEW;
    let tiles_x = width / 8;
    (0..width * height)
        .map(|i| {
            let (tile, block, lane) = (i / 64, i / 16 % 4, i % 16);
            let u = (tile % tiles_x) * 8 + block % 2 * 4 + lane % 4;
            let v = (tile / tiles_x) * 8 + block / 2 * 4 + lane / 4;
            Ray {
                origin: Vec3A::ZERO,
                direction: Vec3A::new((u as f32 - 319.5) / 525.0, (v as f32 - 239.5) / 525.0, 1.0),
                t_min: T_MIN,
                t_max: f32::INFINITY,
            }
        })
        .collect()
}

/// Rays from the hits of primary rays: to points on a small light, and in random directions of the hemisphere.
pub fn shadow_and_bounce(tlas: &Tlas, mesh: &Mesh, primary: &[Ray]) -> (Vec<Ray>, Vec<Ray>) {
    let place = placement();
    let light = Vec3A::new(0.8, -2.0, 0.5);
    let mut shadow = Vec::new();
    let mut bounce = Vec::new();
    for (i, ray) in primary.iter().enumerate() {
        let Some(hit) = tlas.intersect(ray, MASK_VIRTUAL) else {
            continue;
        };
        let [a, b, c] = mesh.triangles[hit.triangle as usize]
            .map(|k| place.transform_point3a(mesh.positions[k as usize].into()));
        let mut normal = (b - a).cross(c - a).normalize_or_zero();
        if normal.dot(ray.direction) > 0.0 {
            normal = -normal;
        }
        let origin = ray.origin + ray.direction * hit.t + normal * 1e-3;
        let sample = |k: u32| 2.0 * uniform(i as u32, 0, k) - 1.0;
        let jitter = Vec3A::new(sample(0), sample(1), sample(2)) * 0.1;
        shadow.push(Ray {
            origin,
            direction: light + jitter - origin,
            t_min: T_MIN,
            t_max: 1.0,
        });
        let ball = Vec3A::new(sample(3), sample(4), sample(5)).normalize_or_zero();
        bounce.push(Ray {
            origin,
            direction: (normal * 1.001 + ball).normalize_or_zero(),
            t_min: T_MIN,
            t_max: f32::INFINITY,
        });
    }
    (shadow, bounce)
}

/// Packets of sixteen rays, with their active lanes.
pub fn packets(rays: &[Ray]) -> Vec<(RayPacket, u16)> {
    rays.chunks(16)
        .map(|chunk| {
            let mut packet = RayPacket::default();
            for (lane, ray) in chunk.iter().enumerate() {
                packet.set(lane, ray);
            }
            (packet, ((1_u32 << chunk.len()) - 1) as u16)
        })
        .collect()
}

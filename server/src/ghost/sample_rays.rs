//! Rays for tests and the laboratory.

use glam::Vec3A;

use super::surface::GhostSurface;
use crate::accel::Ray;
use crate::numerics::uniform;

fn ray(origin: Vec3A, direction: Vec3A) -> Ray {
    Ray {
        origin,
        direction,
        t_min: 0.0,
        t_max: f32::INFINITY,
    }
}

/// `n` rays of every kind that a renderer casts, and of some that it should not cast, in equal parts;
/// deterministic for each `seed`.
pub fn mixed_rays(surface: &GhostSurface, n: u32, seed: u32) -> Vec<Ray> {
    (0..n)
        .map(|k| {
            let r = |dimension: u32| uniform(k, seed, dimension);
            let intrinsics = surface.intrinsics();
            let (u, v) = (
                r(0) * (surface.width() - 1) as f32,
                r(1) * (surface.height() - 1) as f32,
            );
            let view = intrinsics.ray_direction(u, v);
            let z = surface.depth_at(u, v).unwrap_or(1.0);
            let free = view * (z * (0.3 + 0.69 * r(2)));
            let any = Vec3A::new(r(3) - 0.5, r(4) - 0.5, r(5) - 0.5);
            let (x, y) = (u.round(), v.round());
            let vertex = intrinsics.ray_direction(x, y)
                * surface.w(x as u32, y as u32).map_or(1.0, |w| 1.0 / w);
            match k % 12 {
                // Reflections in free space.
                0 | 1 => ray(free, any),
                2 => ray(free, any * Vec3A::new(1.0, 1.0, -1e-3)),
                // Grazing: from one point of the surface, slightly offset, to another.
                3 | 4 => {
                    let (u2, v2) = (u + 60.0 * (r(6) - 0.5), v + 60.0 * (r(7) - 0.5));
                    let z2 = surface.depth_at(u2, v2).unwrap_or(z);
                    let along = intrinsics.ray_direction(u2, v2) * z2 - view * z;
                    let lift = 10f32.powf(-3.0 - 4.0 * r(8)) * if r(9) < 0.5 { 1.0 } else { -1.0 };
                    ray(
                        view * z - along * 0.5 - view * lift,
                        along + view * (lift * 0.3),
                    )
                }
                // Along an axis of the camera, with both signs of zero.
                5 => {
                    let axis = [Vec3A::X, Vec3A::Y, Vec3A::Z][(r(6) * 3.0) as usize % 3];
                    ray(free, if r(7) < 0.5 { axis } else { -axis })
                }
                // Aimed at a vertex.
                6 => ray(free, vertex - free),
                // Through the camera's centre: the ray stays in one pixel.
                7 => ray(view * (r(6) - 0.5), if r(7) < 0.5 { view } else { vertex }),
                // Behind the surface.
                8 => ray(view * (z * (1.001 + r(6))), any),
                // A shadow ray, towards a light.
                9 => Ray {
                    t_max: 1.0,
                    ..ray(vertex * 0.99, any * 3.0)
                },
                // From behind the camera.
                10 => ray(Vec3A::new(r(6) - 0.5, r(7) - 0.5, -r(8)), any.with_z(0.5)),
                // From far away, with a tiny direction.
                _ => ray(any * 1e3, (free - any * 1e3) * 1e-6),
            }
        })
        .collect()
}

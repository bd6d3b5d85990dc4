//! Closed solids let no ray through: rays aimed at edges and vertices, from inside and outside,
//! near and far, through every kernel.

use fearless_simd::Level;
use glam::{Affine3A, EulerRot, Quat, Vec3, Vec3A};
use rayon::prelude::*;

use super::kernels::{agree, levels, one};
use super::shapes::{Dice, aimed, cube, icosphere, needles, torus};
use super::{Effort, HardCase, Measured};
use ghostlight::accel::{HitPacket, Ray, RayPacket, Tlas};
use ghostlight::scene::Mesh;

/// A solid and a way to pick points well inside it.
struct Solid {
    name: &'static str,
    mesh: Mesh,
    inside: fn(&mut Dice) -> Vec3A,
}

fn solids() -> [Solid; 4] {
    [
        Solid {
            name: "icosphere",
            mesh: icosphere(4),
            inside: |dice| dice.direction() * (0.9 * dice.unit()),
        },
        Solid {
            name: "torus",
            mesh: torus(60, 40),
            inside: |dice| {
                let a = dice.unit() * std::f32::consts::TAU;
                let ring = Vec3A::new(a.cos(), a.sin(), 0.0) * 0.75;
                ring + dice.direction() * (0.2 * dice.unit())
            },
        },
        Solid {
            name: "cube",
            mesh: cube(12),
            inside: |dice| Vec3A::new(dice.signed(), dice.signed(), dice.signed()) * 0.9,
        },
        Solid {
            name: "needles",
            mesh: needles(16),
            inside: |dice| Vec3A::new(0.0, 0.0, 0.9 * dice.signed()),
        },
    ]
}

/// A vertex, or a point on an edge.
pub fn target(mesh: &Mesh, dice: &mut Dice) -> Vec3A {
    let corners = mesh.triangles[dice.below(mesh.triangles.len())];
    let k = dice.below(3);
    let [a, b] =
        [corners[k], corners[(k + 1) % 3]].map(|i| Vec3A::from(mesh.positions[i as usize]));
    match dice.below(4) {
        0 => a,
        1 => (a + b) * 0.5,
        _ => a.lerp(b, dice.unit()),
    }
}

impl Solid {
    /// A ray that must hit: from inside anywhere, or from outside through a point inside. `reach` is
    /// how far out it starts, in units of the solid's size.
    fn ray(&self, place: &Affine3A, reach: f32, dice: &mut Dice) -> Ray {
        let inside = (self.inside)(dice);
        let target = target(&self.mesh, dice);
        let place = |p: Vec3A| place.transform_point3a(p);
        if dice.below(2) == 0 {
            aimed(place(inside), place(target))
        } else {
            // From beyond the target, back through it to the point inside.
            let out = (target - inside).try_normalize().unwrap_or(Vec3A::X);
            let start = target + out * (reach * (0.5 + dice.unit()));
            aimed(place(start), place(target))
        }
    }

    /// Every kernel on `n` rays; all must hit.
    fn closed(
        &self,
        tlas: &Tlas,
        place: &Affine3A,
        reach: f32,
        n: u32,
        seed: u32,
    ) -> Result<u64, String> {
        let mut dice = Dice(seed, 0);
        let rays: Vec<Ray> = (0..n).map(|_| self.ray(place, reach, &mut dice)).collect();
        let hits = agree(tlas, &rays)?;
        match rays.iter().zip(&hits).find(|(_, hit)| hit.is_none()) {
            Some((ray, _)) => Err(format!("{}: {ray:?} leaks", self.name)),
            None => Ok(u64::from(n)),
        }
    }
}

/// Rays of one batch: each its own dice, so the threads' order does not matter.
const BATCH: u64 = 16_384;

/// The packet kernels sixteen and sixty-four at a time, the single-ray kernel on every ray; leaks of
/// the batch.
fn leaks(solid: &Solid, tlas: &Tlas, seed: u32) -> u64 {
    let mut dice = Dice(seed, 0);
    let mut leaks = 0;
    for _ in 0..BATCH / 64 {
        let mut packets = [RayPacket::default(); 4];
        for i in 0..64 {
            let ray = solid.ray(&Affine3A::IDENTITY, 3.0, &mut dice);
            leaks += u64::from(tlas.intersect(&ray, 1).is_none());
            packets[i / 16].set(i % 16, &ray);
        }
        let (mut single, mut group) = ([HitPacket::default(); 4], [HitPacket::default(); 4]);
        for (packet, hits) in packets.iter().zip(&mut single) {
            tlas.intersect_packet(packet, u16::MAX, 1, hits);
            leaks += u64::from(tlas.occluded_packet(packet, u16::MAX, 1).count_zeros());
        }
        tlas.intersect_packets(&packets, &[u16::MAX; 4], 1, &mut group);
        for hits in single.iter().chain(&group) {
            leaks += (0..16).filter(|&lane| hits.get(lane).is_none()).count() as u64;
        }
    }
    leaks
}

pub(super) const NEAR: HardCase = HardCase {
    name: "closed meshes: rays at edges and vertices",
    why: "A ray on a shared edge may round out of both triangles.",
    bound: "no ray leaks, by packets or single: triangles see shared vertices alike (Woop et al. 2013)",
    check: |effort: &Effort| {
        let solids = solids();
        let scenes: Vec<Tlas> = solids
            .iter()
            .map(|solid| one(Level::new(), &solid.mesh, Affine3A::IDENTITY))
            .collect::<Result<_, String>>()?;
        let batches = effort.watertight_rays.div_ceil(BATCH).max(4);
        let leaks: u64 = (0..batches)
            .into_par_iter()
            .map(|k| {
                let which = k as usize % solids.len();
                leaks(&solids[which], &scenes[which], 1000 + k as u32)
            })
            .sum();
        let n = batches * BATCH;
        if leaks > 0 {
            return Err(format!("{leaks} leaks of {n} rays"));
        }
        // Every instruction set, and the plain reference, on some of them.
        for level in levels() {
            for (solid, seed) in solids.iter().zip(2..) {
                let here = one(level, &solid.mesh, Affine3A::IDENTITY)?;
                solid.closed(&here, &Affine3A::IDENTITY, 3.0, 4_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

pub(super) const DISTANT: HardCase = HardCase {
    name: "closed meshes: rays from far away, and meshes far from their origin",
    why: "At 10^6 sizes an f32 origin is as coarse as the mesh's triangles.",
    bound: "no ray leaks, by any kernel",
    check: |_| {
        let mut n = 0;
        let solids = solids();
        for (reach, seed) in [30.0, 100.0, 1e4, 1e6].into_iter().zip(30..) {
            // From so far the direction itself misses a thin solid.
            for solid in solids
                .iter()
                .filter(|s| reach <= 100.0 || s.name != "needles")
            {
                let here = one(Level::new(), &solid.mesh, Affine3A::IDENTITY)?;
                n += solid.closed(&here, &Affine3A::IDENTITY, reach, 8_000, seed)?;
            }
        }
        for (offset, seed) in [1e2, 1e4, 9e5].into_iter().zip(50..) {
            for solid in solids.iter().filter(|s| s.name != "needles") {
                let shift = Vec3::new(offset, -offset, 0.5 * offset);
                // The grid of f32 is coarse out there: made large enough to survive on it.
                let scale = (offset * 1e-3).max(1.0);
                let mut far = solid.mesh.clone();
                far.positions
                    .iter_mut()
                    .for_each(|p| *p = *p * scale + shift);
                let back = Affine3A::from_translation(-shift);
                let here = one(Level::new(), &far, back)?;
                let place = Affine3A::from_scale(Vec3::splat(scale));
                n += solid.closed(&here, &place, 3.0, 8_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

pub(super) const PLACED: HardCase = HardCase {
    name: "closed meshes: scales 1e-4 to 1e4, mirrored and squeezed instances",
    why: "The ray, not the mesh, is transformed, and rounds by the transform's condition.",
    bound: "no ray leaks, by any kernel",
    check: |_| {
        let turn = Quat::from_euler(EulerRot::XYZ, 0.3, 1.1, -2.0);
        let place =
            |scale: Vec3, at: Vec3| Affine3A::from_scale_rotation_translation(scale, turn, at);
        let places = [
            place(Vec3::ONE, Vec3::new(3.0, -2.0, 5.0)),
            place(Vec3::splat(1e-4), Vec3::new(0.1, 0.2, 1.0)),
            place(Vec3::splat(1e4), Vec3::new(1e4, 3e4, 2e4)),
            place(Vec3::new(-1.0, 2.0, 0.3), Vec3::Z),
            place(Vec3::new(1e2, 1.0, -1e-2), Vec3::Z),
        ];
        let solids = solids();
        let mut n = 0;
        for (place, seed) in places.iter().zip(70..) {
            for solid in solids.iter().filter(|s| s.name != "needles") {
                let here = one(Level::new(), &solid.mesh, *place)?;
                n += solid.closed(&here, place, 3.0, 8_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

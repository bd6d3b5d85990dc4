//! Closed solids let no ray through: rays are aimed at edges and vertices, from inside and outside, near and far,
//! with every kernel. A ray that slips between two triangles of the front would still hit the back, so the first
//! hit is compared with the oracle's bounds.

use fearless_simd::Level;
use glam::{Affine3A, EulerRot, Quat, Vec3, Vec3A};
use rayon::prelude::*;

use super::kernels::{agree, levels, one, rounding};
use super::shapes::{Dice, aimed, cube, icosphere, needles, torus};
use super::{Effort, HardCase, Measured};
use crate::oracle::triangles::{OracleInstance, nearest_range};
use ghostlight::accel::{HitPacket, Ray, RayPacket, Tlas};
use ghostlight::scene::Mesh;

/// A solid, and a way to choose points well inside it.
struct Solid {
    name: &'static str,
    /// The triangles are so long that the error of an f32 hit exceeds the thickness of the solid: an edge
    /// function has a rounding error of some 3 u L^2 for an area L w, so depth has an error of 3 u L^3 / w, in
    /// units of L.
    slivers: bool,
    mesh: Mesh,
    inside: fn(&mut Dice) -> Vec3A,
}

fn solids() -> [Solid; 4] {
    [
        Solid {
            name: "icosphere",
            slivers: false,
            mesh: icosphere(4),
            inside: |dice| dice.direction() * (0.9 * dice.unit()),
        },
        Solid {
            name: "torus",
            slivers: false,
            mesh: torus(60, 40),
            inside: |dice| {
                let a = dice.unit() * std::f32::consts::TAU;
                let ring = Vec3A::new(a.cos(), a.sin(), 0.0) * 0.75;
                ring + dice.direction() * (0.2 * dice.unit())
            },
        },
        Solid {
            name: "cube",
            slivers: false,
            mesh: cube(12),
            inside: |dice| Vec3A::new(dice.signed(), dice.signed(), dice.signed()) * 0.9,
        },
        Solid {
            name: "needles",
            slivers: true,
            mesh: needles(16),
            inside: |dice| Vec3A::new(0.0, 0.0, 0.9 * dice.signed()),
        },
    ]
}

/// A vertex, or a point on an edge, of the mesh.
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
    /// A ray that must hit: from any point inside, or from outside through a point inside. `reach` is the
    /// distance of its start from the solid, in units of the solid's size.
    fn ray(&self, place: &Affine3A, reach: f32, dice: &mut Dice) -> Ray {
        let inside = (self.inside)(dice);
        let target = target(&self.mesh, dice);
        let place = |p: Vec3A| place.transform_point3a(p);
        if dice.below(2) == 0 {
            aimed(place(inside), place(target))
        } else {
            // From beyond the target, back through the target to the point inside.
            let out = (target - inside).try_normalize().unwrap_or(Vec3A::X);
            let start = target + out * (reach * (0.5 + dice.unit()));
            aimed(place(start), place(target))
        }
    }

    /// Traces `n` rays at the solid with every kernel; all must hit. `built` is the mesh and its transform as in
    /// the acceleration structure.
    fn closed(
        &self,
        tlas: &Tlas,
        built: (&Mesh, &Affine3A),
        place: &Affine3A,
        reach: f32,
        n: u32,
        seed: u32,
    ) -> Result<u64, String> {
        let mut dice = Dice(seed, 0);
        let rays: Vec<Ray> = (0..n).map(|_| self.ray(place, reach, &mut dice)).collect();
        let hits = agree(tlas, &rays)?;
        for (i, (ray, hit)) in rays.iter().zip(&hits).enumerate() {
            let Some(hit) = hit else {
                return Err(format!("{}: {ray:?} leaks", self.name));
            };
            if self.asks_oracle(hit.t, i) {
                self.is_nearest(built, ray, hit.t)?;
            }
        }
        Ok(u64::from(n))
    }

    /// Whether the oracle, which tests every triangle, is asked about ray `i`, which is aimed at a point on the
    /// surface at t = 1: always if the hit is noticeably later, as behind a hole; otherwise for some rays.
    fn asks_oracle(&self, t: f32, i: usize) -> bool {
        !self.slivers && (t > 1.0 + 1e-6 || i.is_multiple_of(1024))
    }

    /// Checks where a ray first meets the solid.
    fn is_nearest(
        &self,
        (mesh, place): (&Mesh, &Affine3A),
        ray: &Ray,
        t: f32,
    ) -> Result<(), String> {
        let instance = OracleInstance {
            mesh,
            camera_from_object: *place,
            mask: 1,
            uncertainty: rounding(mesh, place, ray),
        };
        let (low, high) = nearest_range(&[instance], ray, 1);
        if (low..=high).contains(&f64::from(t)) {
            return Ok(());
        }
        Err(format!(
            "{}: {ray:?} first meets the solid at {t}, the oracle in {low}..={high}",
            self.name
        ))
    }
}

/// Rays of one batch. Each batch has its own random numbers, so the order of threads does not matter.
const BATCH: u64 = 16_384;

/// Traces packets of sixteen and groups of sixty-four, and every ray with the single-ray kernel; an error if a
/// ray passes through the solid.
fn batch(solid: &Solid, tlas: &Tlas, seed: u32) -> Result<(), String> {
    let mut dice = Dice(seed, 0);
    for n in 0..BATCH as usize / 64 {
        let mut packets = [RayPacket::default(); 4];
        let mut expected = [None; 64];
        for i in 0..64 {
            let ray = solid.ray(&Affine3A::IDENTITY, 3.0, &mut dice);
            let Some(hit) = tlas.intersect(&ray, 1) else {
                return Err(format!("{}: {ray:?} leaks", solid.name));
            };
            if solid.asks_oracle(hit.t, 64 * n + i) {
                solid.is_nearest((&solid.mesh, &Affine3A::IDENTITY), &ray, hit.t)?;
            }
            expected[i] = Some(hit);
            packets[i / 16].set(i % 16, &ray);
        }
        let (mut single, mut group) = ([HitPacket::default(); 4], [HitPacket::default(); 4]);
        for (packet, hits) in packets.iter().zip(&mut single) {
            tlas.intersect_packet(packet, u16::MAX, 1, hits);
            if tlas.occluded_packet(packet, u16::MAX, 1) != u16::MAX {
                return Err(format!(
                    "{}: a ray of {packet:?} leaks, any hit",
                    solid.name
                ));
            }
        }
        tlas.intersect_packets(&packets, &[u16::MAX; 4], 1, &mut group);
        for i in 0..64 {
            for (kernel, hits) in [("packet", &single), ("group of packets", &group)] {
                let hit = hits[i / 16].get(i % 16);
                if hit != expected[i] {
                    let name = solid.name;
                    return Err(format!(
                        "{name}: {kernel}: {hit:?}, single {:?}",
                        expected[i]
                    ));
                }
            }
        }
    }
    Ok(())
}

pub(super) const NEAR: HardCase = HardCase {
    name: "closed meshes: rays at edges and vertices",
    why: "By rounding, a ray on a shared edge may miss both triangles.",
    bound: "no ray passes through, in packets or single, and the first hit is the oracle's except on slivers: triangles compute shared vertices alike (Woop et al. 2013)",
    check: |effort: &Effort| {
        let solids = solids();
        let scenes: Vec<Tlas> = solids
            .iter()
            .map(|solid| one(Level::new(), &solid.mesh, Affine3A::IDENTITY))
            .collect::<Result<_, String>>()?;
        let batches = effort.watertight_rays.div_ceil(BATCH).max(4);
        (0..batches).into_par_iter().try_for_each(|k| {
            let which = k as usize % solids.len();
            batch(&solids[which], &scenes[which], 1000 + k as u32)
        })?;
        let n = batches * BATCH;
        // Every instruction set and the scalar reference, for some of the rays.
        for level in levels() {
            for (solid, seed) in solids.iter().zip(2..) {
                let here = one(level, &solid.mesh, Affine3A::IDENTITY)?;
                let built = (&solid.mesh, &Affine3A::IDENTITY);
                solid.closed(&here, built, built.1, 3.0, 4_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

pub(super) const DISTANT: HardCase = HardCase {
    name: "closed meshes: rays from far away, and meshes far from their origin",
    why: "At a distance of 10^6 sizes, the spacing of f32 is as coarse as the mesh's triangles.",
    bound: "no ray passes through, with any kernel",
    check: |_| {
        let mut n = 0;
        let solids = solids();
        for (reach, seed) in [30.0, 100.0, 1e4, 1e6].into_iter().zip(30..) {
            // From this distance, rounding of the direction alone makes a ray miss a thin solid.
            for solid in solids
                .iter()
                .filter(|s| reach <= 100.0 || s.name != "needles")
            {
                let here = one(Level::new(), &solid.mesh, Affine3A::IDENTITY)?;
                let built = (&solid.mesh, &Affine3A::IDENTITY);
                n += solid.closed(&here, built, built.1, reach, 8_000, seed)?;
            }
        }
        for (offset, seed) in [1e2, 1e4, 9e5].into_iter().zip(50..) {
            for solid in solids.iter().filter(|s| s.name != "needles") {
                let shift = Vec3::new(offset, -offset, 0.5 * offset);
                // The spacing of f32 is coarse at that distance: the solid is scaled up so that it keeps its
                // shape.
                let scale = (offset * 1e-3).max(1.0);
                let mut far = solid.mesh.clone();
                far.positions
                    .iter_mut()
                    .for_each(|p| *p = *p * scale + shift);
                let back = Affine3A::from_translation(-shift);
                let here = one(Level::new(), &far, back)?;
                let place = Affine3A::from_scale(Vec3::splat(scale));
                n += solid.closed(&here, (&far, &back), &place, 3.0, 8_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

pub(super) const PLACED: HardCase = HardCase {
    name: "closed meshes: scales 1e-4 to 1e4, mirrored and squeezed instances",
    why: "The ray is transformed and not the mesh, so its rounding grows with the condition number of the transform.",
    bound: "no ray passes through, with any kernel",
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
                n += solid.closed(&here, (&solid.mesh, place), place, 3.0, 8_000, seed)?;
            }
        }
        Ok(Measured::new(n, "0 leaks"))
    },
};

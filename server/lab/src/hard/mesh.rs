//! Degenerate meshes and invalid rays.

use fearless_simd::Level;
use glam::{Affine3A, Mat3A, Vec3, Vec3A};

use super::kernels::{agree, levels, one, placed, tlas};
use super::shapes::{Dice, aimed, cube, icosphere, mesh};
use super::{HardCase, Worst};
use crate::oracle::triangles::{OracleInstance, closest};
use ghostlight::accel::{Blas, BuildLimits, MASK_VIRTUAL, Ray, Tlas, TlasInstance};
use ghostlight::numerics::gamma;
use ghostlight::scene::Mesh;

/// A mesh without a transform, on the best instruction set.
fn plain(mesh: &Mesh) -> Result<Tlas, String> {
    one(Level::new(), mesh, Affine3A::IDENTITY)
}

fn soup(corners: impl IntoIterator<Item = [Vec3; 3]>) -> Mesh {
    let positions: Vec<Vec3> = corners.into_iter().flatten().collect();
    let n = positions.len() as u32 / 3;
    mesh(
        positions,
        (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    )
}

fn corner(p: Vec3) -> [Vec3; 3] {
    [p, p + Vec3::X, p + Vec3::Y]
}

pub(super) const AXES: HardCase = HardCase {
    name: "mesh: rays along axes through grid vertices and edges, with both zeros",
    why: "Rays lie in faces of AABBs, reciprocals are infinite, and -0.0 flips their sign.",
    bound: "every ray hits, and all kernels agree; t has at most 10 roundings of its size",
    check: |_| {
        let n = 12;
        let here = plain(&cube(n))?;
        let mut rays = Vec::new();
        for axis in 0..3 {
            for (i, j) in (0..=2 * n).flat_map(|i| (0..=2 * n).map(move |j| (i, j))) {
                for (sign, zero) in [(1.0, 0.0), (1.0, -0.0), (-1.0, 0.0), (-1.0, -0.0)] {
                    // Vertices and midpoints of edges, including the border of the face.
                    let mut origin = Vec3A::ZERO;
                    origin[(axis + 1) % 3] = (i - n) as f32 / n as f32;
                    origin[(axis + 2) % 3] = (j - n) as f32 / n as f32;
                    let mut direction = Vec3A::splat(zero);
                    direction[axis] = sign;
                    for start in [-3.0, 0.0] {
                        origin[axis] = start * sign;
                        rays.push(Ray {
                            origin,
                            direction,
                            t_min: 0.0,
                            t_max: f32::INFINITY,
                        });
                    }
                }
            }
        }
        let mut worst = Worst::default();
        for (ray, hit) in rays.iter().zip(agree(&here, &rays)?) {
            let outside = ray.origin.abs().max_element() > 2.0;
            let expected = if outside { 2.0 } else { 1.0 };
            let t = hit.map_or(f64::NAN, |hit| f64::from(hit.t));
            // Weights with five roundings each, and as many for t itself.
            worst.note((t - expected).abs(), f64::from(gamma(10)) * 3.0, || {
                format!("{ray:?}")
            });
        }
        worst.bounded()
    },
};

pub(super) const SLIVERS: HardCase = HardCase {
    name: "mesh: slivers a millionth as wide as long",
    why: "Their normals and barycentrics are mostly rounding error.",
    bound: "all kernels agree; the triangle is the oracle's wherever rounding cannot change it",
    check: |_| {
        let mut worst = Worst::default();
        let mut sure = 0;
        for (width, seed) in [(1e-6, 12), (1e-4, 13)] {
            let mut dice = Dice(seed, 0);
            let slivers = soup((0..300).map(|_| {
                let a = Vec3::from(dice.direction());
                let along = Vec3::from(dice.direction());
                [
                    a,
                    a + along,
                    a + along * 0.5 + Vec3::from(dice.direction()) * width,
                ]
            }));
            let rays: Vec<Ray> = (0..3_000)
                .map(|_| {
                    let [a, b, c] = slivers.triangles[dice.below(300)]
                        .map(|i| Vec3A::from(slivers.positions[i as usize]));
                    let (u, v) = (dice.unit() * 0.5, dice.unit() * 0.5);
                    aimed(dice.direction() * 3.0, a + (b - a) * u + (c - a) * v)
                })
                .collect();
            let instance = OracleInstance {
                mesh: &slivers,
                camera_from_object: Affine3A::IDENTITY,
                mask: MASK_VIRTUAL,
                // A vertex relative to the ray has an error of 6 roundings of its distance per axis, which is at
                // most 5 here; boxes are padded by 16. That is wider than the narrowest triangles: for these,
                // only rays that miss everything are certain.
                uncertainty: f64::from(gamma(16)) * 5.0,
            };
            for (ray, hit) in rays.iter().zip(agree(&plain(&slivers)?, &rays)?) {
                let truth = closest(&[instance], ray, MASK_VIRTUAL);
                if truth.margin > 0.0 {
                    sure += 1;
                    let found = hit.map(|h| h.triangle as usize);
                    let expected = truth.hit.map(|h| h.triangle);
                    worst.require(found == expected, || {
                        format!("{ray:?}: {hit:?}, oracle {truth:?}")
                    });
                }
            }
        }
        worst.require(sure > 1_000, || {
            format!("the oracle was sure of {sure} only")
        });
        worst.told(format!(
            "the oracle was sure of {sure}, and none of those differs"
        ))
    },
};

pub(super) const FLAT: HardCase = HardCase {
    name: "mesh: triangles without area",
    why: "They have no normal and divide by zero.",
    bound: "they are left out, and every kernel hits the others",
    check: |_| {
        let flat = soup([
            [Vec3::ZERO; 3],
            [Vec3::ZERO, Vec3::X, Vec3::X],
            [Vec3::ZERO, Vec3::X, Vec3::X * 2.0],
            corner(Vec3::Z),
            [Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-20, 0.0)],
        ]);
        let mut worst = Worst::default();
        let instance = placed(&flat, Affine3A::IDENTITY)?;
        worst.require(instance.blas.triangles() == 2, || {
            format!("{} triangles kept, expected 2", instance.blas.triangles())
        });
        let here = tlas(Level::new(), &[instance]);
        let mut dice = Dice(21, 0);
        let rays: Vec<Ray> = (0..640)
            .map(|_| {
                let target = Vec3A::new(0.45 * dice.unit(), 0.05 + 0.45 * dice.unit(), 1.0);
                aimed(
                    target + Vec3A::new(dice.signed(), dice.signed(), 2.0),
                    target,
                )
            })
            .collect();
        for (ray, hit) in rays.iter().zip(agree(&here, &rays)?) {
            let found = hit.map(|h| h.triangle);
            worst.require(found == Some(3), || format!("{ray:?}: {hit:?}"));
        }
        for empty in [Mesh::default(), soup([[Vec3::ZERO; 3]])] {
            let hits = agree(&plain(&empty)?, &rays)?;
            worst.require(hits.iter().all(Option::is_none), || {
                "an empty mesh was hit".into()
            });
        }
        worst.told("3 of 5 left out")
    },
};

pub(super) const REPEATED: HardCase = HardCase {
    name: "mesh: 20,000 duplicates and coincident instances",
    why: "No plane separates them, and the hit could depend on the order of traversal.",
    bound: "one triangle is kept; every kernel returns the lowest index of equal hits",
    check: |_| {
        let mut repeated = soup((0..20_000).map(|_| corner(Vec3::ONE)));
        for (i, t) in repeated.triangles.iter_mut().enumerate() {
            t.rotate_left(i % 3);
            if i % 2 == 0 {
                t.swap(0, 1);
            }
        }
        let mut worst = Worst::default();
        let instance = placed(&repeated, Affine3A::IDENTITY)?;
        worst.require(instance.blas.triangles() == 1, || {
            format!("{} triangles kept, expected 1", instance.blas.triangles())
        });
        let here = tlas(Level::new(), &[instance]);
        let ray = aimed(Vec3A::new(1.2, 1.2, 5.0), Vec3A::new(1.2, 1.2, 1.0));
        let hit = agree(&here, &[ray])?[0];
        worst.require(hit.is_some_and(|h| h.triangle == 0), || format!("{hit:?}"));

        let block = placed(&cube(4), Affine3A::IDENTITY)?;
        let mut dice = Dice(31, 0);
        let rays: Vec<Ray> = (0..2_000)
            .map(|_| {
                // Vertices of a grid, shared by up to eight triangles.
                let mut at = || (dice.below(5) as f32 - 2.0) / 2.0;
                let target = Vec3A::new(at(), at(), -1.0);
                aimed(Vec3A::new(dice.signed(), dice.signed(), -4.0), target)
            })
            .collect();
        for level in levels() {
            let alone = agree(&tlas(level, std::slice::from_ref(&block)), &rays)?;
            let nine = agree(&tlas(level, &vec![block.clone(); 9]), &rays)?;
            worst.require(alone == nine, || {
                format!("{level:?}: eight more in the same place change the hit")
            });
        }
        worst.told("the first is hit")
    },
};

pub(super) const FAR: HardCase = HardCase {
    name: "mesh: one triangle of 200 km around a speck of 20,000, and off centre by 900 km",
    why: "One AABB contains both, and at that distance f32 has a spacing of 6 cm.",
    bound: "all kernels agree; rays at the centre of the speck hit it",
    check: |_| {
        let speck = soup((0..20_000).map(|i| {
            if i == 0 {
                corner(Vec3::splat(-1e5)).map(|p| (p + 1e5) * 2e5 - 1e5)
            } else {
                let at = Vec3::new((i % 141) as f32, (i / 141) as f32, 0.0) * 1e-3;
                [at, at + Vec3::X * 1e-3, at + Vec3::Y * 1e-3]
            }
        }));
        let here = plain(&speck)?;
        let mut dice = Dice(22, 0);
        let mut worst = Worst::default();
        let rays: Vec<Ray> = (0..1_600)
            .map(|_| {
                let k = 1 + dice.below(19_000) as u32;
                let [a, b, c] =
                    speck.triangles[k as usize].map(|i| Vec3A::from(speck.positions[i as usize]));
                let middle = (a + b + c) / 3.0;
                aimed(
                    middle + Vec3A::new(dice.signed(), dice.signed(), 2.0),
                    middle,
                )
            })
            .collect();
        let hits = agree(&here, &rays)?;
        // A neighbouring triangle may be hit instead: at that distance rounding moves corners a millimetre apart
        // by more than a millimetre.
        let met = hits.iter().flatten().count();
        worst.require(met == rays.len(), || {
            format!("{met} of 1600 rays met the speck")
        });
        let offset = Vec3::new(9e5, -9e5, 4.5e5);
        let mut ball = icosphere(3);
        ball.positions
            .iter_mut()
            .for_each(|p| *p = *p * 900.0 + offset);
        let back = Affine3A::from_translation(-offset);
        let here = one(Level::new(), &ball, back)?;
        let rays: Vec<Ray> = (0..1_600)
            .map(|_| aimed(dice.direction() * 2700.0, dice.direction() * 450.0))
            .collect();
        for (ray, hit) in rays.iter().zip(agree(&here, &rays)?) {
            worst.require(hit.is_some(), || {
                format!("{ray:?} misses a ball 900 km off centre")
            });
        }
        worst.told(format!("the ball by every ray, the speck by {met} of 1600"))
    },
};

pub(super) const SCALES: HardCase = HardCase {
    name: "mesh: coordinates from 1e-9 to 1e9, instances from 1e-4 to 1e4, mirrored and uneven",
    why: "Products of three coordinates span 54 decimal orders.",
    bound: "every ray hits, and all kernels agree; t of a cube has at most 20 roundings of its size",
    check: |_| {
        let mut worst = Worst::default();
        let mut dice = Dice(23, 0);
        for scale in [1e-9_f32, 1e-4, 1.0, 1e4, 9e5, 1e9] {
            let mut ball = icosphere(3);
            ball.positions.iter_mut().for_each(|p| *p *= scale);
            let rays: Vec<Ray> = (0..640)
                .map(|_| {
                    aimed(
                        dice.direction() * (3.0 * scale),
                        dice.direction() * (0.5 * scale),
                    )
                })
                .collect();
            for (ray, hit) in rays.iter().zip(agree(&plain(&ball)?, &rays)?) {
                worst.require(hit.is_some(), || format!("scale {scale}: {ray:?} misses"));
            }
        }
        let block = placed(&cube(2), Affine3A::IDENTITY)?;
        for scale in [
            Vec3::ONE,
            Vec3::splat(1e-4),
            Vec3::splat(1e4),
            Vec3::new(-1.0, 2.0, 0.5),
            Vec3::new(1e2, -1.0, 1e-2),
        ] {
            let instance = TlasInstance {
                camera_from_object: Affine3A::from_scale(scale),
                ..block.clone()
            };
            let here = tlas(Level::new(), &[instance]);
            for speed in [1e-3, 1.0, 7.0] {
                let ray = Ray {
                    origin: Vec3A::new(0.0, 0.0, -3.0 * scale.z),
                    direction: Vec3A::new(0.0, 0.0, speed * scale.z),
                    t_min: 0.0,
                    t_max: f32::INFINITY,
                };
                let t = agree(&here, &[ray])?[0].map_or(f64::NAN, |hit| f64::from(hit.t));
                let expected = 2.0 / f64::from(speed);
                worst.note(
                    (t - expected).abs(),
                    f64::from(gamma(20)) * 2.0 * expected,
                    || format!("scale {scale}, speed {speed}"),
                );
            }
        }
        worst.bounded()
    },
};

pub(super) const TRANSFORMS: HardCase = HardCase {
    name: "mesh: instances flattened, infinite, vanishing, or NaN",
    why: "Their transforms have no inverse, so no ray can be transformed to object space.",
    bound: "they are skipped, and every kernel hits the others",
    check: |_| {
        let ball = placed(&icosphere(1), Affine3A::IDENTITY)?;
        let infinite = Mat3A::from_diagonal(Vec3::splat(f32::INFINITY));
        let places = [
            Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0)),
            Affine3A::from_translation(Vec3::new(f32::NAN, 0.0, 0.0)),
            Affine3A::from_mat3(infinite.into()),
            Affine3A::from_scale(Vec3::splat(1e-40)),
            Affine3A::IDENTITY,
        ];
        let mut worst = Worst::default();
        for level in levels() {
            let instances = places.map(|camera_from_object| TlasInstance {
                camera_from_object,
                ..ball.clone()
            });
            let here = tlas(level, &instances);
            for (k, place) in (0u32..).zip(&places) {
                let usable = k == 4;
                worst.require(here.bounds(k).is_some() == usable, || format!("{place:?}"));
            }
            let hit = agree(&here, &[aimed(Vec3A::Z * 3.0, Vec3A::ZERO)])?[0];
            worst.require(hit.is_some_and(|h| h.instance == 4), || format!("{hit:?}"));
        }
        worst.told("4 of 5 skipped")
    },
};

pub(super) const RAYS: HardCase = HardCase {
    name: "mesh: NaN, infinite, vanishing and empty rays",
    why: "One NaN lane may affect the other fifteen rays of a packet.",
    bound: "they hit nothing, and a valid ray among them has the same hit as alone",
    check: |_| {
        let here = plain(&icosphere(2))?;
        let good = aimed(Vec3A::Z * 3.0, Vec3A::ZERO);
        let alone = agree(&here, &[good])?[0];
        let mut rays = vec![
            Ray {
                t_max: f32::NAN,
                ..good
            },
            Ray {
                t_max: f32::NEG_INFINITY,
                ..good
            },
            Ray {
                t_min: 0.9,
                t_max: 0.1,
                ..good
            },
            Ray {
                direction: Vec3A::ZERO,
                ..good
            },
            Ray {
                direction: Vec3A::splat(-0.0),
                ..good
            },
            Ray {
                direction: Vec3A::splat(1e-30),
                ..good
            },
            Ray {
                direction: Vec3A::splat(1e-42),
                ..good
            },
            Ray {
                direction: Vec3A::splat(1e30),
                ..good
            },
        ];
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for axis in 0..3 {
                let mut ray = good;
                ray.origin[axis] = bad;
                rays.push(ray);
                let mut ray = good;
                ray.direction[axis] = bad;
                rays.push(ray);
            }
            rays.push(Ray { t_min: bad, ..good });
        }
        let mut worst = Worst::default();
        for (ray, hit) in rays.iter().zip(agree(&here, &rays)?) {
            worst.require(hit.is_none(), || format!("{ray:?}: {hit:?}"));
        }
        for lane in 0..16 {
            let mut beside = rays[..15].to_vec();
            beside.insert(lane, good);
            let hit = agree(&here, &beside)?[lane];
            worst.require(alone.is_some() && hit == alone, || {
                format!("lane {lane}: {hit:?}")
            });
        }
        worst.told("none hits; the good ray is untouched")
    },
};

pub(super) const VERTICES: HardCase = HardCase {
    name: "mesh: NaN, infinite and enormous vertices, indices out of range",
    why: "A single one would spread to every AABB above it.",
    bound: "refused, naming the vertex or triangle",
    check: |_| {
        let good = icosphere(0);
        let mut worst = Worst::default();
        let mut refused = |mesh: &Mesh, named: &str| {
            let told = Blas::build(mesh, BuildLimits::default())
                .err()
                .map(|e| e.to_string());
            worst.require(told.as_ref().is_some_and(|t| t.contains(named)), || {
                format!("expected an error about {named}, got {told:?}")
            });
        };
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e11] {
            let mut mesh = good.clone();
            mesh.positions[7].y = bad;
            refused(&mesh, "vertex 7");
        }
        for index in [12, u32::MAX] {
            let mut mesh = good.clone();
            mesh.triangles[3][1] = index;
            refused(&mesh, "triangle 3");
        }
        // Harmless values are kept: denormal numbers and negative zero.
        let mut mesh = good;
        mesh.positions.push(Vec3::new(1e-42, -0.0, -1e-45));
        let kept = Blas::build(&mesh, BuildLimits::default()).is_ok();
        worst.require(kept, || "denormal coordinates are refused".into());
        worst.told("each refused by name")
    },
};

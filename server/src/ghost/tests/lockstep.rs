//! Tests rays in batches against single rays: the same bits, on every instruction set.

use fearless_simd::Level;
use rayon::prelude::*;

use super::recorded::{recorded_maps, sets_of_recordings};
use super::*;
use crate::ghost::traverse::batch::segments::{GROUP, LANES};
use crate::ghost::traverse::batch::trace::Batch;
use crate::ghost::traverse::segment::Clipped;

/// An outcome as bits, so that any difference is found.
fn bits(outcome: &GhostOutcome) -> [u32; 4] {
    match outcome {
        GhostOutcome::Environment => [0; 4],
        GhostOutcome::Unknown => [1, 0, 0, 0],
        GhostOutcome::Hit(hit) => [
            2 + u32::from(hit.from_front),
            hit.t.to_bits(),
            hit.u.to_bits(),
            hit.v.to_bits(),
        ],
    }
}

/// Compares batches of all rays with the plain walk; returns the number of hits.
fn compare(name: &str, surface: &GhostSurface, rays: &[Ray]) -> usize {
    rays.par_chunks(3000)
        .map(|rays| {
            let mut outcomes = vec![GhostOutcome::Unknown; rays.len()];
            surface.trace_batch(rays, &mut outcomes);
            let mut occluded = vec![false; rays.len()];
            surface.occluded_batch(rays, &mut occluded);
            for ((ray, outcome), &occluded) in rays.iter().zip(&outcomes).zip(&occluded) {
                let dda = surface.trace(Traversal::Dda, ray);
                assert_eq!(bits(outcome), bits(&dda), "{name}: {ray:?}");
                let hit = matches!(dda, GhostOutcome::Hit(_));
                assert_eq!(occluded, hit, "{name}: {ray:?}");
            }
            occluded.iter().filter(|&&occluded| occluded).count()
        })
        .sum()
}

/// Rays that cross the image close to a corner of the grid: at a distance of 1e-8 to 1e-2 pixels, around the
/// resolution of f32, in any direction, including those of the grid and the diagonals.
fn rays_near_corners(surface: &GhostSurface, n: u32, seed: u32) -> Vec<Ray> {
    let intrinsics = surface.intrinsics();
    let (width, height) = (surface.width() as f32, surface.height() as f32);
    (0..n)
        .map(|k| {
            let r = |dimension: u32| f64::from(uniform(k, seed, dimension));
            let near = |size: f32, dimension: u32| {
                let corner = (r(dimension) * f64::from(size)).floor();
                let off = 10f64.powf(-2.0 - 6.0 * r(dimension + 1));
                corner + if r(dimension + 2) < 0.5 { off } else { -off }
            };
            let (u, v) = (near(width, 0), near(height, 3));
            let z = f64::from(surface.depth_at(u as f32, v as f32).unwrap_or(1.0));
            let angle = match k % 4 {
                0 => std::f64::consts::TAU * r(6),
                1 => std::f64::consts::FRAC_PI_4 * (r(6) * 8.0).floor(),
                2 => (r(6) * 4.0).floor() * std::f64::consts::FRAC_PI_2 + 1e-3 * (r(7) - 0.5),
                _ => std::f64::consts::FRAC_PI_4 + 1e-5 * (r(7) - 0.5),
            };
            let reach = 40.0 * r(8);
            let (du, dv) = (reach * angle.cos(), reach * angle.sin());
            // Both ends are near the surface, so that the content of a single cell decides.
            let from = intrinsics.unproject(u - du, v - dv, z * (0.97 + 0.06 * r(9)));
            let to = intrinsics.unproject(u + du, v + dv, z * (0.97 + 0.06 * r(10)));
            ray(from.as_vec3a(), (to - from).as_vec3a())
        })
        .collect()
}

/// A surface that is rough from cell to cell, yet connected.
fn rough(width: u32, height: u32) -> GhostSurface {
    let f = 0.9 * f64::from(width.max(height));
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    let intrinsics = Intrinsics::new(f, f, cx, cy, width, height).unwrap();
    let z_m = (0..width * height)
        .map(|k| 1.0 + 0.02 * uniform(k, 31, 0))
        .collect();
    surface_of(&DepthImage::from_metres(width, height, z_m), &intrinsics)
}

#[test]
fn a_million_rays_in_batches_agree_with_the_plain_walk() {
    let mut n = 0;
    let mut check = |name: &str, surface: &GhostSurface, rays: &[Ray]| {
        let hits = compare(name, surface, rays);
        assert!(hits * 10 > rays.len(), "{name}: {hits} hits");
        n += rays.len();
    };
    for (name, sensed) in [("clean room", false), ("sensed room", true)] {
        let (depth, intrinsics) = room(160, 120, sensed);
        let surface = surface_of(&depth, &intrinsics);
        check(name, &surface, &mixed_rays(&surface, 250_000, 41));
        check(name, &surface, &rays_near_corners(&surface, 100_000, 42));
    }
    for (width, height) in [(120, 90), (2000, 6), (5, 2500)] {
        let surface = rough(width, height);
        let name = format!("rough {width}x{height}");
        check(&name, &surface, &rays_near_corners(&surface, 100_000, 43));
    }
    for (folder, depth, intrinsics) in recorded_maps(sets_of_recordings(), 1, 160, 120) {
        let surface = surface_of(&depth, &intrinsics);
        compare(folder, &surface, &mixed_rays(&surface, 60_000, 44));
        compare(folder, &surface, &rays_near_corners(&surface, 20_000, 45));
    }
    assert!(n >= 1_000_000, "{n}");
}

/// Rays that pass behind the surface; most of them leave the picture.
fn rays_behind(surface: &GhostSurface, n: u32, seed: u32) -> Vec<Ray> {
    let intrinsics = surface.intrinsics();
    let (width, height) = (surface.width() as f32, surface.height() as f32);
    (0..n)
        .map(|k| {
            let r = |dimension: u32| uniform(k, seed, dimension);
            let (u, v) = (r(0) * (width - 1.0), r(1) * (height - 1.0));
            let z = surface.depth_at(u, v).unwrap_or(2.0);
            let angle = std::f32::consts::TAU * r(2);
            // From in front of, on or behind the surface, by up to a tenth of its depth.
            let from = intrinsics.ray_direction(u, v) * z * (0.98 + 0.12 * r(3));
            let along = Vec3A::new(angle.cos(), angle.sin(), 0.2 * (r(4) - 0.5));
            Ray {
                t_max: if k % 3 == 0 { z * r(5) } else { f32::INFINITY },
                ..ray(from, along)
            }
        })
        .collect()
}

/// Batches decide whether a ray was behind the depth surface from whole tiles if they are full, and cell by cell
/// elsewhere: the result is always that of the plain walk.
#[test]
fn torn_sheets_hide_the_same_from_batches_and_the_plain_walk() {
    let (width, height) = (210, 150);
    let f = 200.0;
    let intrinsics = Intrinsics::new(f, f, 104.5, 74.5, width, height).unwrap();
    let at = |k: u32| (k % width, k / width);
    let hole = |k: u32| uniform(k, 71, 0) < 0.01;
    let wavy = |k: u32| 1.5 + 0.01 * uniform(k, 72, 0) + 0.002 * at(k).0 as f32;
    let maps: [(&str, &dyn Fn(u32) -> f32); 6] = [
        ("whole", &|k| wavy(k)),
        ("holes", &|k| if hole(k) { 0.0 } else { wavy(k) }),
        ("single pixels", &|k| {
            let (x, y) = at(k);
            if (x + y) % 2 == 0 { wavy(k) } else { 0.0 }
        }),
        ("squares near and far", &|k| {
            let (x, y) = at(k);
            if (x / 9 + y / 9) % 2 == 0 { 1.0 } else { 3.0 }
        }),
        ("islands", &|k| {
            let (x, y) = at(k);
            let (dx, dy) = ((x % 40) as f32 - 20.0, (y % 40) as f32 - 20.0);
            if dx.hypot(dy) < 17.0 { wavy(k) } else { 0.0 }
        }),
        ("nearest and farthest", &|k| {
            if at(k).1 / 30 % 2 == 0 { 1e-3 } else { 1e4 }
        }),
    ];
    for (name, z) in maps {
        let z_m = (0..width * height).map(z).collect();
        let depth = DepthImage::from_metres(width, height, z_m);
        let surface = surface_of(&depth, &intrinsics);
        let rays = [
            rays_behind(&surface, 30_000, 73),
            mixed_rays(&surface, 20_000, 74),
        ];
        compare(name, &surface, &rays.concat());
        let mut outcomes = vec![GhostOutcome::Environment; rays[0].len()];
        surface.trace_batch(&rays[0], &mut outcomes);
        let count = |wanted| {
            outcomes
                .iter()
                .filter(|&&outcome| outcome == wanted)
                .count()
        };
        let (unknown, free) = (
            count(GhostOutcome::Unknown),
            count(GhostOutcome::Environment),
        );
        assert!(unknown > 3_000 && free > 300, "{name}: {unknown}, {free}");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let best = Level::new();
    let mut levels = vec![best, Level::fallback()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
    }
    let (depth, intrinsics) = room(160, 120, true);
    let mut outcomes = Vec::new();
    for level in levels {
        let mut surface = GhostSurface::new();
        surface.level = level;
        surface.rebuild(&depth, &intrinsics, &GhostSettings::default());
        let mut rays = mixed_rays(&surface, 12_000, 51);
        rays.extend(rays_near_corners(&surface, 8_000, 52));
        let traced: Vec<_> = exact(&surface, &rays, "levels").iter().map(bits).collect();
        outcomes.push(traced);
    }
    assert!(outcomes.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn places_beyond_the_last_ray_are_left_alone() {
    let (depth, intrinsics) = room(160, 120, true);
    let surface = surface_of(&depth, &intrinsics);
    let rays = mixed_rays(&surface, GROUP as u32 + 5, 55);
    // Fills the buffers with results of an earlier group.
    exact(&surface, &rays, "groups");
    for n in [0, 3, 16, 21, GROUP, GROUP + 5] {
        let mark = GhostOutcome::Hit(GhostHit {
            t: -7.0,
            u: 0.0,
            v: 0.0,
            from_front: false,
        });
        let mut outcomes = vec![mark; 2 * GROUP + 9];
        let mut occluded = vec![true; 2 * GROUP + 9];
        surface.trace_batch(&rays[..n], &mut outcomes);
        surface.occluded_batch(&rays[..n], &mut occluded);
        assert!(outcomes[..n].iter().all(|outcome| *outcome != mark), "{n}");
        assert!(outcomes[n..].iter().all(|outcome| *outcome == mark), "{n}");
        assert!(occluded[n..].iter().all(|&occluded| occluded), "{n}");
        for (ray, outcome) in rays[..n].iter().zip(&outcomes) {
            assert_eq!(bits(outcome), bits(&surface.trace(Traversal::Dda, ray)));
        }
    }
}

#[test]
fn sixteen_rays_are_clipped_as_one_is() {
    let (depth, intrinsics) = room(160, 120, true);
    let surface = surface_of(&depth, &intrinsics);
    let mut rays = mixed_rays(&surface, 40_000, 61);
    rays.extend(rays_near_corners(&surface, 10_000, 62));
    let mut batch = Batch::EMPTY;
    let mut n_inside = 0;
    for rays in rays.chunks(GROUP) {
        if !surface.trace_group(&mut batch, rays, &[], false, &mut []) {
            println!("SKIPPED: no vectors on this processor");
            return;
        }
        let group = &batch.group;
        for (k, ray) in rays.iter().enumerate() {
            let bit = |bits: &[u16]| bits[k / LANES] >> (k % LANES) & 1 != 0;
            let (invalid, inside) = (bit(&group.invalid), bit(&group.inside));
            match surface.frustum.clip(ray) {
                Clipped::Invalid => assert_eq!((invalid, inside), (true, false), "{ray:?}"),
                Clipped::Outside => assert_eq!((invalid, inside), (false, false), "{ray:?}"),
                Clipped::Inside(segment) => {
                    assert_eq!((invalid, inside), (false, true), "{ray:?}");
                    // Debug output distinguishes all floats, including signs of zeros.
                    let lanes = group.segment(k);
                    assert_eq!(format!("{lanes:?}"), format!("{segment:?}"), "{ray:?}");
                    n_inside += 1;
                }
            }
        }
    }
    assert!(n_inside > 20_000, "{n_inside}");
}

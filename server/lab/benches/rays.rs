//! Rays per second of every traversal and of the eight-wide BVH of obvhs, in one run.
//!
//! Three fixed ray sets over procedural meshes: `primary` (a 640x480 view, in tiles of 8x8 of four 4x4 blocks),
//! `shadow` (from the primary hits to a point on a small light) and `bounce` (from the primary hits in random
//! directions over the hemisphere). One thread. Kernels take turns; each is timed in pieces of a few hundred packets
//! and the fastest round of each piece counts, so that other load on the machine affects the ratios as little as
//! possible.
//!
//! `cargo bench -p ghostlight-lab --bench rays [-- --levels] [-- --rounds N] [-- --mesh 16K] [-- --kernel wide]`

use std::cell::RefCell;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use fearless_simd::Level;
use ghostlight::accel::{Blas, BuildLimits, HitPacket, MASK_VIRTUAL, NO_HIT, Ray, RayPacket, Tlas};
use ghostlight::scene::Mesh;
use ghostlight::shapes::ripples;
use ghostlight_lab::compare::mesh_rays::{packets, placed, placement, primary, shadow_and_bounce};
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::{BvhBuildParams, ray::Ray as ObvhsRay, ray::RayHit, triangle::Triangle};

/// Packets timed at once: well under a scheduler's time slice.
const PIECE: usize = 240;

/// A way to trace a ray set; returns the number of hits.
type Kernel<'a> = (String, Box<dyn Fn() -> usize + 'a>);

fn kernels<'a>(
    tlas: &'a Tlas,
    rays: &'a [Ray],
    packets: &'a [(RayPacket, u16)],
    any: bool,
) -> Vec<Kernel<'a>> {
    let level = format!("{:?}", tlas.level());
    let level = level.split('(').next().unwrap_or_default().to_owned();
    let hit = |hits: &HitPacket| hits.instance.iter().filter(|&&i| i != NO_HIT).count();
    let (grouped, active): (Vec<RayPacket>, Vec<u16>) = packets.iter().copied().unzip();
    let hits = RefCell::new(vec![HitPacket::default(); packets.len()]);
    if any {
        vec![
            (
                format!("wide {level}"),
                Box::new(move || {
                    rays.iter()
                        .filter(|r| tlas.occluded(r, MASK_VIRTUAL))
                        .count()
                }),
            ),
            (
                format!("packet {level}"),
                Box::new(move || {
                    packets
                        .iter()
                        .map(|(p, active)| {
                            tlas.occluded_packet(p, *active, MASK_VIRTUAL).count_ones() as usize
                        })
                        .sum()
                }),
            ),
        ]
    } else {
        vec![
            (
                format!("wide {level}"),
                Box::new(move || {
                    rays.iter()
                        .filter(|r| tlas.intersect(r, MASK_VIRTUAL).is_some())
                        .count()
                }),
            ),
            (
                format!("packet {level}"),
                Box::new(move || {
                    let mut hits = HitPacket::default();
                    packets
                        .iter()
                        .map(|(p, active)| {
                            tlas.intersect_packet(p, *active, MASK_VIRTUAL, &mut hits);
                            hit(&hits)
                        })
                        .sum()
                }),
            ),
            (
                format!("group {level}"),
                Box::new(move || {
                    let hits = &mut hits.borrow_mut()[..grouped.len()];
                    tlas.intersect_packets(&grouped, &active, MASK_VIRTUAL, hits);
                    hits.iter().map(hit).sum()
                }),
            ),
        ]
    }
}

fn scalar<'a>(tlas: &'a Tlas, rays: &'a [Ray], any: bool) -> Kernel<'a> {
    (
        "scalar".to_owned(),
        Box::new(move || {
            rays.iter()
                .filter(|r| {
                    if any {
                        tlas.occluded_scalar(r, MASK_VIRTUAL)
                    } else {
                        tlas.intersect_scalar(r, MASK_VIRTUAL).is_some()
                    }
                })
                .count()
        }),
    )
}

/// obvhs on the placed mesh, with triangles in leaf order as its documentation recommends.
struct Peer {
    tree: CwBvh,
    triangles: Vec<Triangle>,
}

impl Peer {
    fn new(mesh: &Mesh) -> Self {
        let place = placement();
        let corner = |i: u32| place.transform_point3a(mesh.positions[i as usize].into());
        let triangles: Vec<Triangle> = mesh
            .triangles
            .iter()
            .map(|t| Triangle {
                v0: corner(t[0]),
                v1: corner(t[1]),
                v2: corner(t[2]),
            })
            .collect();
        let tree = build_cwbvh_from_tris(
            &triangles,
            BvhBuildParams::medium_build(),
            &mut Duration::default(),
        );
        let triangles = tree
            .primitive_indices
            .iter()
            .map(|&i| triangles[i as usize])
            .collect();
        Self { tree, triangles }
    }

    fn kernel<'a>(&'a self, rays: &'a [Ray], any: bool) -> Kernel<'a> {
        (
            "obvhs cwbvh".to_owned(),
            Box::new(move || {
                rays.iter()
                    .filter(|r| {
                        let ray = ObvhsRay::new(r.origin, r.direction, r.t_min, r.t_max);
                        let test = |ray: &ObvhsRay, id: usize| self.triangles[id].intersect(ray);
                        if any {
                            !self.tree.ray_traverse_miss(ray, test)
                        } else {
                            self.tree.ray_traverse(ray, &mut RayHit::none(), test)
                        }
                    })
                    .count()
            }),
        )
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let after = |flag: &str| {
        let at = arguments.iter().position(|a| a == flag)?;
        arguments.get(at + 1)
    };
    let rounds: usize = after("--rounds").and_then(|n| n.parse().ok()).unwrap_or(7);
    let only = after("--mesh");
    let mut levels = vec![Level::new()];
    #[cfg(target_arch = "x86_64")]
    if arguments.iter().any(|a| a == "--levels") {
        let best = Level::new();
        levels.clear();
        levels.extend(best.as_avx512().map(Level::Avx512));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
        levels.push(Level::fallback());
    }
    for (name, n, m) in [("16K", 128, 64), ("100K", 320, 160), ("1M", 1000, 500)] {
        if only.is_some_and(|only| only != name) {
            continue;
        }
        let mesh = ripples(n, m);
        let start = Instant::now();
        let blas = match Blas::build(&mesh, BuildLimits::default()) {
            Ok(blas) => Arc::new(blas),
            Err(error) => {
                eprintln!("{name}: {error}");
                std::process::exit(1);
            }
        };
        println!(
            "{name}: {} triangles, built in {:.0} ms, {:.1} MB",
            blas.triangles(),
            start.elapsed().as_secs_f64() * 1e3,
            blas.memory() as f64 / 1e6
        );
        let tlases: Vec<Tlas> = levels.iter().map(|&level| placed(level, &blas)).collect();
        let peer = Peer::new(&mesh);
        let primary = primary();
        let (shadow, bounce) = shadow_and_bounce(&tlases[0], &mesh, &primary);
        for (set, rays, any) in [
            ("primary", primary, false),
            ("shadow", shadow, true),
            ("bounce", bounce, false),
        ] {
            let packets = packets(&rays);
            // The kernels of each piece.
            let pieces: Vec<Vec<Kernel<'_>>> = packets
                .chunks(PIECE)
                .zip(rays.chunks(16 * PIECE))
                .map(|(packets, rays)| {
                    let mut kernels: Vec<Kernel<'_>> = tlases
                        .iter()
                        .flat_map(|tlas| kernels(tlas, rays, packets, any))
                        .collect();
                    kernels.insert(0, peer.kernel(rays, any));
                    kernels.insert(1, scalar(&tlases[0], rays, any));
                    if let Some(wanted) = after("--kernel") {
                        kernels
                            .retain(|(name, _)| name.starts_with("obvhs") || name.contains(wanted));
                    }
                    kernels
                })
                .collect();
            let names: Vec<&str> = pieces[0].iter().map(|(name, _)| name.as_str()).collect();
            let mut times = vec![vec![f64::INFINITY; pieces.len()]; names.len()];
            let mut found = vec![0; names.len()];
            for _ in 0..rounds {
                for kernel in 0..names.len() {
                    found[kernel] = 0;
                    for (piece, best) in pieces.iter().zip(&mut times[kernel]) {
                        let start = Instant::now();
                        found[kernel] += black_box(piece[kernel].1());
                        *best = best.min(start.elapsed().as_secs_f64());
                    }
                }
            }
            let best: Vec<(f64, usize)> = times
                .iter()
                .zip(found)
                .map(|(times, hits)| (times.iter().sum(), hits))
                .collect();
            println!("  {set}: {} rays", rays.len());
            for ((seconds, hits), name) in best.iter().zip(names) {
                println!(
                    "    {name:<18} {:7.2} Mray/s  {:5.2}x obvhs  {:5.1} % hit",
                    rays.len() as f64 / seconds / 1e6,
                    best[0].0 / seconds,
                    *hits as f64 / rays.len() as f64 * 1e2
                );
            }
        }
    }
}

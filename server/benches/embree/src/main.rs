//! Compares Ghostlight's ray kernels with Embree 4: same rays, same process, one thread.
//!
//! ```text
//! EMBREE_LIB=/path/to/libembree4.so cargo run --release [-- ROUNDS]
//! ```
//!
//! The Python wheel `embreex` contains such a library. Ray sets and meshes are those of
//! `cargo bench -p ghostlight-lab --bench rays`. All kernels take turns; each is timed in pieces of a few hundred
//! packets, and the fastest round of each piece counts, so that other load on the machine affects the ratios as
//! little as possible. Ratios are relative to Embree's single rays in robust mode, which is nearly as watertight as
//! Ghostlight.

mod embree;

use std::cell::RefCell;
use std::hint::black_box;
use std::ops::Range;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use fearless_simd::Level;
use ghostlight::accel::{Blas, BuildLimits, HitPacket, MASK_VIRTUAL, NO_HIT};
use ghostlight::shapes::ripples;
use ghostlight_lab::compare::mesh_rays::{
    packets, placed, placement, primary, shadow_and_bounce,
};
use glam::Vec3A;

/// Traces some packets of a ray set, or the same rays one by one; returns the number of hits.
type Kernel<'a> = (&'static str, Box<dyn Fn(Range<usize>) -> usize + 'a>);

/// Packets timed at once: well under a scheduler's time slice.
const PIECE: usize = 240;

/// The rays of some packets.
fn rays_of<T>(rays: &[T], packets: Range<usize>) -> &[T] {
    &rays[16 * packets.start..(16 * packets.end).min(rays.len())]
}

fn count(hits: &HitPacket) -> usize {
    hits.instance.iter().filter(|&&i| i != NO_HIT).count()
}

fn main() -> ExitCode {
    let Some(path) = std::env::var_os("EMBREE_LIB") else {
        eprintln!("EMBREE_LIB: expected the path of a libembree4.so, got nothing");
        return ExitCode::from(2);
    };
    // SAFETY: the user names an Embree library, whose initialisers are trusted.
    let library = match unsafe { libloading::Library::new(&path) } {
        Ok(library) => Box::leak(Box::new(library)),
        Err(error) => {
            eprintln!("EMBREE_LIB: {error}");
            return ExitCode::from(2);
        }
    };
    let rounds = std::env::args()
        .nth(1)
        .and_then(|rounds| rounds.parse().ok())
        .unwrap_or(9);
    for (name, n, m) in [
        ("16 K", 128, 64),
        ("70 K", 256, 137),
        ("100 K", 320, 160),
        ("1 M", 1000, 500),
    ] {
        let mesh = ripples(n, m);
        let start = Instant::now();
        let blas = match Blas::build(&mesh, BuildLimits::default()) {
            Ok(blas) => Arc::new(blas),
            Err(error) => {
                eprintln!("{name}: {error}");
                return ExitCode::FAILURE;
            }
        };
        let built = start.elapsed();
        let tlas = &placed(Level::new(), &blas);
        let place = placement();
        let corners: Vec<Vec3A> = mesh
            .positions
            .iter()
            .map(|&p| place.transform_point3a(p.into()))
            .collect();
        let start = Instant::now();
        let scenes = [true, false]
            .map(|robust| embree::Scene::new(library, &corners, &mesh.triangles, robust));
        let embree_built = start.elapsed() / 2;
        let [Ok(robust), Ok(default)] = &scenes else {
            eprintln!("EMBREE_LIB: not Embree 4, a function is missing");
            return ExitCode::from(2);
        };
        println!(
            "{name}: {} triangles, built in {:.0} ms, Embree {:.0} ms (one thread each)",
            mesh.triangles.len(),
            built.as_secs_f64() * 1e3,
            embree_built.as_secs_f64() * 1e3,
        );
        let primary = primary();
        let (shadow, bounce) = shadow_and_bounce(tlas, &mesh, &primary);
        for (set, rays, any) in [
            ("primary", primary, false),
            ("shadow", shadow, true),
            ("bounce", bounce, false),
        ] {
            let packets = packets(&rays);
            let singles: Vec<_> = rays.iter().map(embree::single).collect();
            let sixteens: Vec<_> = packets.iter().map(embree::sixteen).collect();
            let mut kernels: Vec<Kernel<'_>> = vec![
                (
                    "Embree robust, single",
                    Box::new(|at| robust.singles(rays_of(&singles, at), any)),
                ),
                (
                    "Embree default, single",
                    Box::new(|at| default.singles(rays_of(&singles, at), any)),
                ),
                (
                    "Embree robust, packets",
                    Box::new(|at| robust.packets(&sixteens[at], any)),
                ),
                (
                    "Embree default, packets",
                    Box::new(|at| default.packets(&sixteens[at], any)),
                ),
                (
                    "ours, single",
                    Box::new(|at| {
                        rays_of(&rays, at)
                            .iter()
                            .filter(|ray| {
                                if any {
                                    tlas.occluded(ray, MASK_VIRTUAL)
                                } else {
                                    tlas.intersect(ray, MASK_VIRTUAL).is_some()
                                }
                            })
                            .count()
                    }),
                ),
                (
                    "ours, packets",
                    Box::new(|at| {
                        let mut hits = HitPacket::default();
                        packets[at]
                            .iter()
                            .map(|(packet, active)| {
                                if any {
                                    tlas.occluded_packet(packet, *active, MASK_VIRTUAL)
                                        .count_ones() as usize
                                } else {
                                    tlas.intersect_packet(packet, *active, MASK_VIRTUAL, &mut hits);
                                    count(&hits)
                                }
                            })
                            .sum()
                    }),
                ),
            ];
            if !any {
                let (rays, active): (Vec<_>, Vec<_>) = packets.iter().copied().unzip();
                let hits = RefCell::new(vec![HitPacket::default(); PIECE]);
                kernels.push((
                    "Ghostlight, groups of packets",
                    Box::new(move |at| {
                        let hits = &mut hits.borrow_mut()[..at.len()];
                        let (rays, active) = (&rays[at.clone()], &active[at]);
                        tlas.intersect_packets(rays, active, MASK_VIRTUAL, hits);
                        hits.iter().map(count).sum()
                    }),
                ));
            }
            let pieces = packets.len().div_ceil(PIECE);
            let mut times = vec![vec![f64::INFINITY; pieces]; kernels.len()];
            let mut found = vec![0; kernels.len()];
            for _ in 0..rounds {
                for (i, (_, kernel)) in kernels.iter().enumerate() {
                    found[i] = 0;
                    for (piece, best) in times[i].iter_mut().enumerate() {
                        let first = piece * PIECE;
                        let start = Instant::now();
                        let at = first..(first + PIECE).min(packets.len());
                        found[i] += black_box(kernel(at));
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
            for ((seconds, hits), (name, _)) in best.iter().zip(&kernels) {
                println!(
                    "    {name:<24} {:7.2} Mray/s  {:5.2}x  {hits} hits",
                    rays.len() as f64 / seconds / 1e6,
                    best[0].0 / seconds,
                );
            }
        }
    }
    ExitCode::SUCCESS
}

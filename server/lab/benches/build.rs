//! Time to build the BVH of a mesh, on one thread and on two, compared with the binary builder of obvhs (PLOC and
//! reinsertion, its fast and medium presets, without a collapse to a wide BVH).
//!
//! `cargo bench -p ghostlight-lab --bench build [-- --rounds N]`

use std::hint::black_box;
use std::time::{Duration, Instant};

use ghostlight::accel::{Blas, BuildLimits};
use ghostlight::scene::Mesh;
use ghostlight::shapes::ripples;
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

/// Shortest time of some rounds, milliseconds.
fn least_ms(rounds: usize, mut run: impl FnMut()) -> f64 {
    (0..rounds)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::INFINITY, f64::min)
}

fn triangles(mesh: &Mesh) -> Vec<Triangle> {
    let corner = |i: u32| mesh.positions[i as usize].into();
    mesh.triangles
        .iter()
        .map(|t| Triangle {
            v0: corner(t[0]),
            v1: corner(t[1]),
            v2: corner(t[2]),
        })
        .collect()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let rounds = arguments
        .iter()
        .position(|a| a == "--rounds")
        .and_then(|at| arguments.get(at + 1)?.parse().ok())
        .unwrap_or(7);
    for (name, n, m) in [("16K", 128, 64), ("100K", 320, 160), ("1M", 1000, 500)] {
        let mesh = ripples(n, m);
        let triangles = triangles(&mesh);
        for threads in [1, 2] {
            let pool = match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
                Ok(pool) => pool,
                Err(error) => {
                    eprintln!("{error}");
                    std::process::exit(1);
                }
            };
            pool.install(|| {
                let ours = least_ms(rounds, || {
                    black_box(Blas::build(&mesh, BuildLimits::default()).is_ok());
                });
                let peer = |params: BvhBuildParams| {
                    least_ms(rounds, || {
                        let spent = &mut Duration::default();
                        black_box(build_bvh2_from_tris(&triangles, params, spent));
                    })
                };
                println!(
                    "{name:>5}, {threads} threads: {ours:7.1} ms; obvhs fast {:7.1} ms, medium {:7.1} ms",
                    peer(BvhBuildParams::fast_build()),
                    peer(BvhBuildParams::medium_build()),
                );
            });
        }
    }
}

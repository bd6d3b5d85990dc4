//! Bloom and glare at 640x480, with a few highlights and with a picture full of highlights.
//!
//! `cargo bench -p ghostlight --bench post`

use criterion::{Criterion, criterion_group, criterion_main};
use ghostlight::clock::render_clock;
use ghostlight::render::cpu::post::bloom::{BloomScratch, bloom};
use ghostlight::render::cpu::post::glare::{GlareScratch, glare};
use ghostlight::render::{BloomMethod, BloomSettings, GlareSettings, Threads};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Highlights like the reflection of a lamp: discs of radiance 40.
fn highlights(discs: &[(f32, f32, f32)]) -> Vec<[f32; 3]> {
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = ((i % WIDTH) as f32, (i / WIDTH) as f32);
            let lit = discs.iter().any(|&(cx, cy, r)| (x - cx).hypot(y - cy) <= r);
            if lit { [40.0, 36.0, 30.0] } else { [0.1; 3] }
        })
        .collect()
}

fn post(c: &mut Criterion) {
    let threads = match Threads::new(2, render_clock) {
        Ok(threads) => threads,
        Err(error) => panic!("threads: {error}"),
    };
    let pictures = [
        ("none", highlights(&[])),
        ("one", highlights(&[(300.0, 220.0, 5.0)])),
        (
            "teapot",
            highlights(&[
                (300.0, 220.0, 5.0),
                (340.0, 260.0, 8.0),
                (280.0, 290.0, 3.0),
            ]),
        ),
        (
            "corners",
            highlights(&[(5.0, 5.0, 4.0), (630.0, 470.0, 4.0)]),
        ),
        ("full", highlights(&[(320.0, 240.0, 500.0)])),
    ];
    let mut added = vec![[0.0f32; 3]; WIDTH * HEIGHT];
    for (name, source) in &pictures {
        for method in [BloomMethod::Pyramid, BloomMethod::Gaussians] {
            let settings = BloomSettings {
                method,
                ..BloomSettings::default()
            };
            let mut scratch = BloomScratch::default();
            c.bench_function(&format!("bloom {method:?} {name}").to_lowercase(), |b| {
                b.iter(|| {
                    bloom(
                        source,
                        WIDTH,
                        HEIGHT,
                        &settings,
                        &mut scratch,
                        &mut added,
                        &threads,
                    )
                });
            });
        }
        let settings = GlareSettings {
            enabled: true,
            ..GlareSettings::default()
        };
        let mut scratch = GlareScratch::default();
        c.bench_function(&format!("glare {name}"), |b| {
            b.iter(|| {
                glare(
                    source,
                    WIDTH,
                    HEIGHT,
                    &settings,
                    &mut scratch,
                    &mut added,
                    &threads,
                )
            });
        });
    }
}

criterion_group!(benches, post);
criterion_main!(benches);

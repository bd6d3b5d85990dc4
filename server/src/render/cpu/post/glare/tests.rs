use super::super::highlight::MAX_HIGHLIGHT;
use super::*;
use crate::numerics::gamma;

fn pool(threads: usize) -> Threads {
    Threads::new(threads, || 0).unwrap()
}

fn settings() -> GlareSettings {
    GlareSettings {
        enabled: true,
        ..GlareSettings::default()
    }
}

fn run(source: &[[f32; 3]], width: usize, s: &GlareSettings) -> Option<Vec<[f32; 3]>> {
    let mut added = vec![[0.0; 3]; source.len()];
    let height = source.len() / width;
    let mut scratch = GlareScratch::default();
    glare(source, width, height, s, &mut scratch, &mut added, &pool(2)).then_some(added)
}

/// The impulse response at each distance along a diagonal: the paper's passes expanded, in f64.
fn response(s: &GlareSettings, reach: usize) -> Vec<f64> {
    let a = f64::from(s.attenuation);
    let mut response = vec![0.0; reach];
    response[0] = 1.0;
    for n in 1..=s.passes {
        let b = 4usize.pow(n - 1);
        let weights = (0..s.samples as usize).map(|i| (b * i, a.powi((b * i) as i32)));
        let total: f64 = weights.clone().map(|(_, w)| w).sum();
        let mut next = vec![0.0; reach];
        for (offset, weight) in weights {
            for d in offset..reach {
                next[d] += response[d - offset] * weight / total;
            }
        }
        response = next;
    }
    response
}

#[test]
fn the_impulse_response_is_the_papers_formula() {
    for (passes, samples, attenuation) in [
        (1, 4, 0.92),
        (2, 4, 0.9),
        (3, 4, 0.92),
        (3, 1, 0.9),
        (2, 7, 0.85),
        (5, 16, 0.95),
        (4, 3, 0.95),
    ] {
        let s = GlareSettings {
            passes,
            samples,
            attenuation,
            ..settings()
        };
        let (width, height) = (203, 151);
        for (px, py) in [(101, 75), (0, 0), (202, 150), (5, 140)] {
            let mut source = vec![[0.0; 3]; width * height];
            source[py * width + px] = [11.5; 3];
            let added = run(&source, width, &s).unwrap();
            let expected = response(&s, width);
            for y in 0..height {
                for x in 0..width {
                    let (dx, dy) = (x.abs_diff(px), y.abs_diff(py));
                    let directions = if (dx, dy) == (0, 0) { 4.0 } else { 1.0 };
                    let weight = if dx == dy {
                        expected[dx] * directions
                    } else {
                        0.0
                    };
                    let expected = 10.0 * f64::from(s.intensity) * 0.25 * weight;
                    // Roundings: the bright pass, then for each pass a rounded weight, a product and up to
                    // `samples` sums, and the final scale and sums. The smallest normal number covers weights
                    // that are out of the range of f32.
                    let bound = expected * f64::from(gamma(12 + passes * (samples + 2)))
                        + f64::from(f32::MIN_POSITIVE);
                    let got = f64::from(added[y * width + x][0]);
                    assert!(
                        (got - expected).abs() <= bound,
                        "{s:?} at {x},{y}: {got} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn with_four_samples_a_streak_falls_off_as_a_to_the_distance() {
    let s = settings();
    let expected = response(&s, 64);
    for d in 0..64 {
        let ratio = expected[d] / expected[0];
        assert!((ratio / f64::from(s.attenuation).powi(d as i32) - 1.0).abs() < 1e-12);
    }
    // The response sums to one: intensity is the share of light that goes into streaks.
    assert!((expected.iter().sum::<f64>() - 1.0).abs() < 1e-12);
}

#[test]
fn nothing_over_the_threshold_writes_nothing() {
    let s = settings();
    assert!(run(&[[1.5; 3]; 12], 4, &s).is_none());
    assert!(run(&[[1.6; 3]; 12], 4, &s).is_some());
    assert!(
        run(
            &[[1.6; 3]; 12],
            4,
            &GlareSettings {
                enabled: false,
                ..s
            }
        )
        .is_none()
    );
    assert!(run(&[], 1, &s).is_none());
}

#[test]
fn light_that_no_number_can_hold_stays_finite() {
    let wild = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e6,
        f32::MAX,
        -5.0,
        2.0,
    ];
    for (width, height) in [(1, 1), (1, 9), (9, 1), (7, 5), (64, 33)] {
        let source: Vec<[f32; 3]> = (0..width * height)
            .map(|i| {
                [
                    wild[(i + 1) % 7],
                    wild[(i / 7 + 3) % 7],
                    wild[(i * 3 + 1) % 7],
                ]
            })
            .collect();
        for passes in [0, 1, 5, 99] {
            let s = GlareSettings {
                passes,
                samples: 99,
                ..settings()
            };
            let added = run(&source, width, &s).unwrap();
            for c in added.as_flattened() {
                assert!(
                    (0.0..=MAX_HIGHLIGHT * s.intensity * 1.001).contains(c),
                    "{c}"
                );
            }
        }
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_in_used_buffers() {
    let (width, height) = (317, 289);
    let mut used = GlareScratch::default();
    for share in [0.3, 0.001] {
        let source: Vec<[f32; 3]> = (0..width * height)
            .map(|i| {
                let u = |d| crate::numerics::uniform(i as u32, 1, d);
                if u(0) < share {
                    [u(1) * 9.0, u(2) * 9.0, u(3) * 9.0]
                } else {
                    [0.0; 3]
                }
            })
            .collect();
        let fresh = run(&source, width, &settings()).unwrap();
        for threads in [1, 2, 5] {
            let mut added = vec![[0.0; 3]; source.len()];
            let s = settings();
            assert!(glare(
                &source,
                width,
                height,
                &s,
                &mut used,
                &mut added,
                &pool(threads)
            ));
            assert!(fresh == added, "{threads} threads");
        }
    }
}

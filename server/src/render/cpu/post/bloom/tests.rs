use super::super::highlight::MAX_HIGHLIGHT;
use super::*;
use crate::numerics::gamma;
use proptest::prelude::*;

fn pool(threads: usize) -> Threads {
    Threads::new(threads, || 0).unwrap()
}

fn settings(method: BloomMethod) -> BloomSettings {
    BloomSettings {
        method,
        ..BloomSettings::default()
    }
}

fn run(source: &[[f32; 3]], width: usize, s: &BloomSettings) -> Option<Vec<[f32; 3]>> {
    let mut added = vec![[0.0; 3]; source.len()];
    let height = source.len() / width;
    let mut scratch = BloomScratch::default();
    bloom(source, width, height, s, &mut scratch, &mut added, &pool(2)).then_some(added)
}

fn sum(image: &[[f32; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for px in image {
        for c in 0..3 {
            sum[c] += f64::from(px[c]);
        }
    }
    sum
}

const METHODS: [BloomMethod; 2] = [BloomMethod::Gaussians, BloomMethod::Pyramid];

/// Number of roundings of a light path: the bright pass, two passes of at most 2 * 5 each down and 2 * 3 up per
/// level, and the final scale and sum.
fn roundings(levels: u32) -> u32 {
    8 + levels * 16 + levels + 3
}

#[test]
fn energy_in_the_interior_is_the_intensity_of_the_bright_pass() {
    for (width, height) in [(333, 301), (320, 310)] {
        for levels in 1..=5 {
            let mut source = vec![[0.2, 0.3, 0.1]; width * height];
            for (x, y, light) in [
                (160, 150, [7.0, 3.0, 0.0]),
                (161, 150, [1.0, 2.0, 9.0]),
                (163, 153, [1e6, 0.0, 1.0]),
                (155, 159, [1.1, 1.1, 1.1]),
            ] {
                source[y * width + x] = light;
            }
            let pass = BrightPass::knee(1.0, 0.5);
            let bright: Vec<[f32; 3]> = source.iter().map(|&c| pass.filter(c).into()).collect();
            let s = BloomSettings {
                levels,
                ..settings(BloomMethod::Pyramid)
            };
            let got = sum(&run(&source, width, &s).unwrap());
            let expected = sum(&bright).map(|e| e * f64::from(s.intensity));
            for c in 0..3 {
                let bound = expected[c] * f64::from(gamma(roundings(levels)));
                assert!(
                    (got[c] - expected[c]).abs() <= bound,
                    "{levels} levels, channel {c}: {} against {}",
                    got[c],
                    expected[c]
                );
            }
        }
    }
}

#[test]
fn the_papers_gaussians_keep_energy_too() {
    let (width, height) = (401, 399);
    let mut source = vec![[0.0; 3]; width * height];
    source[200 * width + 201] = [5.0, 2.0, 1.0];
    let s = BloomSettings {
        levels: 4,
        ..settings(BloomMethod::Gaussians)
    };
    let got = sum(&run(&source, width, &s).unwrap());
    for (got, light) in got.into_iter().zip([5.0, 2.0, 1.0]) {
        let expected = light * f64::from(s.intensity);
        assert!((got - expected).abs() <= expected * f64::from(gamma(roundings(4))));
    }
}

/// The pyramid from its definition, in f64, over a sufficiently large plane.
fn pyramid_by_definition(bright: &[f64], n: usize, levels: usize) -> Vec<f64> {
    let tap = |d: i64| [0.125, 0.375, 0.375, 0.125][d as usize];
    let mut planes = vec![(n, bright.to_vec())];
    for _ in 0..levels {
        let (n, fine) = planes.last().unwrap().clone();
        let m = n / 2;
        let mut coarse = vec![0.0; m * m];
        for (i, value) in coarse.iter_mut().enumerate() {
            let (cx, cy) = ((i % m) as i64, (i / m) as i64);
            for dy in 0..4 {
                for dx in 0..4 {
                    let (x, y) = (2 * cx - 1 + dx, 2 * cy - 1 + dy);
                    if (0..n as i64).contains(&x) && (0..n as i64).contains(&y) {
                        *value += tap(dx) * tap(dy) * fine[y as usize * n + x as usize];
                    }
                }
            }
        }
        planes.push((m, coarse));
    }
    let mut sum = vec![0.0; bright.len()];
    for (level, plane) in planes.into_iter().enumerate().skip(1) {
        let mut light = plane;
        for _ in 0..level {
            let (m, coarse) = light;
            let n = m * 2;
            let mut fine = vec![0.0; n * n];
            for cy in 0..m as i64 {
                for cx in 0..m as i64 {
                    for dy in 0..4 {
                        for dx in 0..4 {
                            let (x, y) = (2 * cx - 1 + dx, 2 * cy - 1 + dy);
                            if (0..n as i64).contains(&x) && (0..n as i64).contains(&y) {
                                fine[y as usize * n + x as usize] +=
                                    4.0 * tap(dx) * tap(dy) * coarse[cy as usize * m + cx as usize];
                            }
                        }
                    }
                }
            }
            light = (n, fine);
        }
        for (sum, light) in sum.iter_mut().zip(light.1) {
            *sum += light / levels as f64;
        }
    }
    sum
}

#[test]
fn the_pyramid_is_what_it_is_defined_to_be_everywhere() {
    // The picture is the middle of the plane on which the definition is evaluated.
    let (n, margin, levels) = (256usize, 96usize, 3);
    let (width, height) = (61, 47);
    for (px, py) in [(0, 0), (30, 20), (60, 46), (59, 3), (1, 46)] {
        let mut source = vec![[0.0; 3]; width * height];
        source[py * width + px] = [9.0, 9.0, 9.0];
        let mut bright = vec![0.0; n * n];
        bright[(margin + py) * n + margin + px] = 8.0;
        let expected = pyramid_by_definition(&bright, n, levels);
        let s = BloomSettings {
            levels: levels as u32,
            ..settings(BloomMethod::Pyramid)
        };
        let got = run(&source, width, &s).unwrap();
        for y in 0..height {
            for x in 0..width {
                let expected = expected[(margin + y) * n + margin + x] * f64::from(s.intensity);
                let got = f64::from(got[y * width + x][1]);
                let bound = expected * f64::from(gamma(roundings(levels as u32)));
                assert!(
                    (got - expected).abs() <= bound,
                    "impulse {px},{py} at {x},{y}: {got} against {expected}"
                );
            }
        }
    }
}

#[test]
fn nothing_over_the_threshold_writes_nothing() {
    for method in METHODS {
        let s = settings(method);
        // The pyramid's knee begins at half the threshold.
        let start = if method == BloomMethod::Pyramid {
            0.49
        } else {
            0.99
        };
        let dark = vec![[start; 3]; 35];
        assert!(run(&dark, 7, &s).is_none());
        let mut one = dark.clone();
        one[17] = [1.5; 3];
        assert!(run(&one, 7, &s).is_some());
        let off = BloomSettings {
            enabled: false,
            ..s
        };
        assert!(run(&one, 7, &off).is_none());
        let nan = BloomSettings {
            threshold: f32::NAN,
            ..s
        };
        assert!(run(&one, 7, &nan).is_none());
        assert!(run(&[], 1, &s).is_none());
    }
}

#[test]
fn the_knee_is_smooth_and_never_adds_light() {
    let pass = BrightPass::knee(1.0, 0.5);
    let excess = |l: f32| f64::from(pass.filter([l; 3]).y);
    assert_eq!(excess(0.5), 0.0);
    assert!((excess(1.5) - 0.5).abs() < 1e-6 && (excess(1.0) - 0.125).abs() < 1e-6);
    let step = 1.0 / 256.0;
    for i in 0..1024u16 {
        let l = f32::from(i) * step;
        let rise = (excess(l + step) - excess(l)) / f64::from(step);
        // The slope is between 0 and 1; a quotient of values that are each rounded at about 1e-7.
        assert!((-1e-4..=1.0 + 1e-4).contains(&rise), "{l}: {rise}");
        assert!(excess(l) <= f64::from(l));
    }
}

#[test]
fn light_that_no_display_or_number_can_hold_stays_finite() {
    let wild = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e6,
        f32::MAX,
        -5.0,
        2.0,
    ];
    for method in METHODS {
        for (width, height) in [(1, 1), (1, 9), (9, 1), (7, 5), (64, 33)] {
            let source: Vec<[f32; 3]> = (0..width * height)
                .map(|i| [wild[i % 7], wild[(i / 7 + 3) % 7], wild[(i * 3 + 1) % 7]])
                .collect();
            for levels in [0, 1, 5, 8, 99] {
                let s = BloomSettings {
                    levels,
                    ..settings(method)
                };
                let Some(added) = run(&source, width, &s) else {
                    assert_eq!((width, height), (1, 1), "{method:?}");
                    continue;
                };
                for c in added.as_flattened() {
                    assert!(
                        (0.0..=MAX_HIGHLIGHT * s.intensity * 1.001).contains(c),
                        "{c}"
                    );
                }
            }
        }
        assert!(run(&[[f32::INFINITY; 3]], 1, &settings(method)).is_some());
        assert!(run(&[[f32::NAN; 3]], 1, &settings(method)).is_none());
    }
}

fn scattered(width: usize, height: usize, share: f32) -> Vec<[f32; 3]> {
    (0..width * height)
        .map(|i| {
            let u = |d| crate::numerics::uniform(i as u32, 1, d);
            if u(0) < share {
                [u(1) * 9.0, u(2) * 9.0, u(3) * 9.0]
            } else {
                [u(1) * 0.4; 3]
            }
        })
        .collect()
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_in_used_buffers() {
    let (width, height) = (517, 389);
    for method in METHODS {
        let s = settings(method);
        let mut used = BloomScratch::default();
        for share in [0.5, 0.0001] {
            let source = scattered(width, height, share);
            let mut first: Option<Vec<[f32; 3]>> = None;
            for threads in [1, 2, 5] {
                let mut added = vec![[0.25; 3]; source.len()];
                assert!(bloom(
                    &source,
                    width,
                    height,
                    &s,
                    &mut used,
                    &mut added,
                    &pool(threads)
                ));
                match &first {
                    None => first = Some(added),
                    Some(first) => assert!(*first == added, "{method:?} {threads} threads"),
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn any_size_is_finite_and_gains_no_energy(
        width in 1usize..70, height in 1usize..70, share in 0.001..1f32, levels in 1u32..=8,
    ) {
        let source = scattered(width, height, share);
        for method in METHODS {
            let s = BloomSettings { levels, ..settings(method) };
            let Some(added) = run(&source, width, &s) else { continue };
            let (all, got) = (sum(&source), sum(&added));
            for c in 0..3 {
                let most = all[c] * f64::from(s.intensity);
                prop_assert!(got[c] <= most * (1.0 + f64::from(gamma(roundings(levels)))));
            }
        }
    }
}

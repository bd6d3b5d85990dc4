//! Depth-map traversals against brute force in double precision.

use anyhow::Result;
use rayon::prelude::*;

use super::ghost_rays::{MirrorBall, TRACERS, random_rays, shadow_rays};
use super::{Axis, Bound, Curve, Lab, Section, median, number, quantile, take_turns};
use crate::accel::Ray;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::ghost::{GhostOutcome, GhostSurface};
use crate::oracle::ghost::{GhostOracle, Verdict};
use crate::render::{GhostSettings, Traversal};
use crate::synth::room_depth;

/// A depth map to trace.
struct Map {
    name: String,
    surface: GhostSurface,
    oracle: GhostOracle,
    ball: MirrorBall,
}

impl Map {
    fn new(name: impl Into<String>, depth: &DepthImage, intrinsics: &Intrinsics) -> Self {
        let settings = GhostSettings::default();
        let mut surface = GhostSurface::new();
        surface.rebuild(depth, intrinsics, &settings);
        Self {
            name: name.into(),
            oracle: GhostOracle::new(depth, intrinsics, &settings),
            ball: MirrorBall::before(&surface),
            surface,
        }
    }
}

/// Ray sets: what they are called, and which they are. The ball's timed rays are in scan order.
const SETS: [&str; 3] = ["random reflections", "mirror ball", "shadow rays"];

fn timed_rays(map: &Map, set: usize, n: u32) -> Vec<Ray> {
    match set {
        0 => random_rays(&map.surface, 0..n, 3),
        1 => {
            let all = map.ball.rays(&map.surface);
            // A band across the middle: coherent as a picture's rows are.
            let skip = all.len().saturating_sub(n as usize) / 2;
            all.into_iter().skip(skip).take(n as usize).collect()
        }
        _ => shadow_rays(&map.surface, 0..n, 5),
    }
}

fn checked_rays(map: &Map, set: usize, numbers: std::ops::Range<u32>) -> Vec<Ray> {
    match set {
        0 => random_rays(&map.surface, numbers, 7),
        1 => map.ball.rays_at_random(&map.surface, numbers, 8),
        _ => shadow_rays(&map.surface, numbers, 9),
    }
}

/// What went wrong with how many rays.
#[derive(Debug, Default, Clone)]
struct Tally {
    rays: usize,
    ambiguous: usize,
    missed: usize,
    false_hits: usize,
    /// Hits off by more than 1 %.
    wrong: usize,
    /// Environment for unknown or the reverse, with no hit either way.
    confused: usize,
    /// Rays that pyramid and walk end differently, in any bit.
    differ: usize,
    /// Largest relative error of a hit.
    largest: f64,
    /// Relative error of each hit, if kept.
    relative: Vec<f64>,
}

impl Tally {
    fn judge(&mut self, verdict: Verdict, outcome: GhostOutcome, keep: bool) {
        self.rays += 1;
        match (verdict, outcome) {
            (Verdict::AmbiguousHit, _) => self.ambiguous += 1,
            (Verdict::Hit { t, .. }, GhostOutcome::Hit(hit)) => {
                let error = (f64::from(hit.t) - t).abs() / t.abs();
                self.wrong += usize::from(error > 1e-2);
                self.largest = self.largest.max(error);
                if keep {
                    self.relative.push(error);
                }
            }
            (Verdict::Hit { .. }, _) => self.missed += 1,
            (_, GhostOutcome::Hit(_)) => self.false_hits += 1,
            (Verdict::Environment, GhostOutcome::Unknown)
            | (Verdict::Unknown, GhostOutcome::Environment) => self.confused += 1,
            (Verdict::AmbiguousMiss, _) => self.ambiguous += 1,
            _ => {}
        }
    }

    fn add(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.ambiguous += other.ambiguous;
        self.missed += other.missed;
        self.false_hits += other.false_hits;
        self.wrong += other.wrong;
        self.confused += other.confused;
        self.differ += other.differ;
        self.largest = self.largest.max(other.largest);
        self.relative.extend(other.relative);
        self
    }
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let maps = maps(lab)?;
    let mut section = Section::new();
    section.prose(
        "In (u, v, 1/z) a ray is a straight segment and the depth map a height field of triangles. RT2AR walks it by \
         one sample per pixel (`bresenham`); `dda` visits every cell; `pyramid` skips what a min/max pyramid rules \
         out, one ray at a time or in batches as frames do. Truth is every triangle, in camera space, in double \
         precision; rays that rounding decides (told by the truth itself) count for nobody. One thread.",
    );
    let mut ratios = Vec::new();
    for (set, name) in SETS.iter().enumerate() {
        let columns = [
            ("time", "ns/ray"),
            ("rays wrong", "%"),
            ("missed", ""),
            ("false hits", ""),
            ("off by > 1 %", ""),
            ("median error of t", ""),
            ("99th percentile", ""),
            ("largest", ""),
            ("rays checked", ""),
        ];
        let mut curve = Curve::new(format!("Traversal of depth maps: {name}"), columns)
            .plot(Axis::Log(0), Axis::Log(1))
            .scattered();
        for map in &maps {
            lab.phase(&format!("{name}, {}", map.name));
            let ns = measure(lab, map, set, &mut curve);
            ratios.push((map.name.clone(), set, ns));
        }
        section.curve(curve);
    }
    section.curve(speedups(&ratios));
    check(lab, &maps, &mut section);
    Ok(section)
}

/// The bundled room sensed and exact, and whatever was recorded.
fn maps(lab: &mut Lab) -> Result<Vec<Map>> {
    lab.phase("depth maps");
    let mut maps = Vec::new();
    for view in lab.views()? {
        let name = if view.real {
            view.name.to_owned()
        } else {
            format!("{}, sensed", view.name)
        };
        maps.push(Map::new(name, &view.frame.depth, &view.frame.intrinsics));
        if !view.real {
            let room = room_depth(view.frame.depth.width, view.frame.depth.height, 0)?;
            let name = format!("{}, exact", view.name);
            maps.push(Map::new(name, &room.exact, &room.intrinsics));
        }
    }
    Ok(maps)
}

/// Adds a point per traversal; returns nanoseconds per ray.
fn measure(lab: &Lab, map: &Map, set: usize, curve: &mut Curve) -> Vec<f64> {
    let rays = timed_rays(map, set, lab.pick(2_000, 40_000));
    let mut variants: Vec<_> = TRACERS
        .iter()
        .map(|(_, tracer)| (tracer, vec![GhostOutcome::Unknown; rays.len()]))
        .collect();
    let seconds = take_turns(lab.rounds(), &mut variants, |(tracer, out)| {
        tracer(&map.surface, std::hint::black_box(&rays), out);
    });
    let verdicts: Vec<Verdict> = lab
        .pool()
        .install(|| rays.par_iter().map(|ray| map.oracle.verdict(ray)).collect());
    let mut all = Vec::new();
    for (((name, _), (_, outcomes)), seconds) in TRACERS.iter().zip(&variants).zip(seconds) {
        let mut tally = Tally::default();
        for (verdict, outcome) in verdicts.iter().zip(outcomes) {
            tally.judge(*verdict, *outcome, true);
        }
        let ns = seconds * 1e9 / rays.len().max(1) as f64;
        let wrong = tally.missed + tally.false_hits + tally.wrong;
        let sure = tally.rays - tally.ambiguous;
        curve.point(
            *name,
            map.name.as_str(),
            [
                ns,
                wrong as f64 / sure.max(1) as f64 * 100.0,
                tally.missed as f64,
                tally.false_hits as f64,
                tally.wrong as f64,
                median(&mut tally.relative),
                quantile(&mut tally.relative, 0.99),
                tally.largest,
                sure as f64,
            ],
        );
        all.push(ns);
    }
    all
}

/// The batch form against the others, per map and set.
fn speedups(measured: &[(String, usize, Vec<f64>)]) -> Curve {
    let columns = [
        ("/ bresenham nearest", "x"),
        ("/ bresenham floor+ceil", "x"),
        ("/ dda", "x"),
        ("/ pyramid single", "x"),
    ];
    let mut curve = Curve::new("How many times faster `pyramid, batch` is", columns);
    for (map, set, ns) in measured {
        let batch = ns[4];
        let ratios: Vec<f64> = ns[..4].iter().map(|ns| ns / batch).collect();
        curve.point(SETS[*set], map.as_str(), ratios);
    }
    curve
}

/// Many rays by pyramid, walk and brute force: the bounds.
fn check(lab: &Lab, maps: &[Map], section: &mut Section) {
    let total: u32 = lab.pick(90_000, 10_000_000);
    let share = total / (maps.len() * SETS.len()).max(1) as u32;
    let mut all = Tally::default();
    for map in maps {
        for (set, name) in SETS.iter().enumerate() {
            lab.phase(&format!(
                "{} checked rays, {name}, {}",
                number(f64::from(share)),
                map.name
            ));
            // A ball fills pi/4 of its square.
            let n = if set == 1 { share / 157 * 200 } else { share };
            all = all.add(check_set(lab, map, set, n));
        }
    }
    section.prose(format!(
        "Beyond the timed rays, {} random ones over all maps were traced by `pyramid` (single, batch) and by `dda`, \
         compared bit for bit, and against brute force; for {} of them rounding decides. The largest relative error \
         of a hit is {}.",
        number(all.rays as f64),
        number(all.ambiguous as f64),
        number(all.largest)
    ));
    let n = all.rays;
    section.bound(Bound::none_of(
        "`pyramid` differs from `dda` in any bit",
        all.differ,
        n,
    ));
    section.bound(Bound::none_of("`pyramid` misses", all.missed, n));
    section.bound(Bound::none_of(
        "`pyramid` hits what is not there",
        all.false_hits,
        n,
    ));
    section.bound(Bound::none_of(
        "`pyramid` is off by more than 1 %",
        all.wrong,
        n,
    ));
    section.bound(Bound::none_of(
        "`pyramid` takes environment for unknown or the reverse",
        all.confused,
        n,
    ));
}

fn check_set(lab: &Lab, map: &Map, set: usize, n: u32) -> Tally {
    const CHUNK: u32 = 2048;
    lab.pool().install(|| {
        (0..n.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let numbers = chunk * CHUNK..((chunk + 1) * CHUNK).min(n);
                let rays = checked_rays(map, set, numbers);
                let mut batch = vec![GhostOutcome::Unknown; rays.len()];
                map.surface.trace_batch(&rays, &mut batch);
                let mut tally = Tally::default();
                for (ray, &outcome) in rays.iter().zip(&batch) {
                    let dda = map.surface.trace(Traversal::Dda, ray);
                    let single = map.surface.trace(Traversal::Pyramid, ray);
                    tally.differ += usize::from(dda != outcome || single != outcome);
                    tally.judge(map.oracle.verdict(ray), outcome, false);
                }
                tally
            })
            .reduce(Tally::default, Tally::add)
    })
}

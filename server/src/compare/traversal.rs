//! Depth-map traversals against brute force in double precision.

use std::ops::Range;

use anyhow::Result;
use rayon::prelude::*;

use super::ghost_rays::{MirrorBall, TRACERS, random_rays, shadow_rays};
use super::{Axis, Bound, Curve, Lab, Section, median, number, quantile, take_turns};
use crate::accel::Ray;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::ghost::{GhostOutcome, GhostSurface};
use crate::numerics::uniform;
use crate::oracle::ghost::{GhostOracle, Verdict};
use crate::render::{GhostSettings, Traversal};
use crate::synth::room_depth;

/// A depth map to trace.
struct Map {
    name: String,
    depth: DepthImage,
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
            depth: depth.clone(),
            oracle: GhostOracle::new(depth, intrinsics, &settings),
            ball: MirrorBall::before(&surface),
            surface,
        }
    }

    /// A window of it, of a size and at a place that follow from a number.
    fn window(&self, number: u32) -> Self {
        let r = |dimension| uniform(number, 11, dimension);
        let side = |of: u32, dimension| (16 + (r(dimension) * 105.0) as u32).min(of);
        let (width, height) = (side(self.depth.width, 0), side(self.depth.height, 1));
        let x0 = (r(2) * (self.depth.width - width + 1) as f32) as u32;
        let y0 = (r(3) * (self.depth.height - height + 1) as f32) as u32;
        let z_m = (y0..y0 + height)
            .flat_map(|y| (x0..x0 + width).map(move |x| (x, y)))
            .map(|(x, y)| self.depth.z_m[(y * self.depth.width + x) as usize])
            .collect();
        let k = self.surface.intrinsics();
        let intrinsics = Intrinsics {
            cx: k.cx - f64::from(x0),
            cy: k.cy - f64::from(y0),
            width,
            height,
            ..*k
        };
        Self::new(
            "",
            &DepthImage::from_metres(width, height, z_m),
            &intrinsics,
        )
    }

    /// A number of rays, fewer for maps larger than 640x480.
    fn fewer(&self, n: u32) -> u32 {
        let pixels = self.depth.width * self.depth.height;
        (u64::from(n) * 640 * 480 / u64::from(pixels.max(640 * 480))) as u32
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

fn checked_rays(map: &Map, set: usize, numbers: Range<u32>) -> Vec<Ray> {
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
    let rays = timed_rays(map, set, map.fewer(lab.pick(1_000, 20_000)));
    let mut variants: Vec<_> = TRACERS
        .iter()
        .map(|(_, tracer)| (tracer, vec![GhostOutcome::Unknown; rays.len()]))
        .collect();
    let seconds = take_turns(3 * lab.rounds(), &mut variants, |(tracer, out)| {
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

/// Many rays by pyramid, walk and brute force: the bounds. Brute force over whole maps is slow, so
/// most rays are cast at windows cut out of them, each a depth map of its own.
fn check(lab: &Lab, maps: &[Map], section: &mut Section) {
    let whole: u32 = lab.pick(6_000, 120_000);
    let total: u32 = lab.pick(90_000, 10_000_000);
    let per_map = total.saturating_sub(whole) / maps.len().max(1) as u32;
    let mut on_whole = Tally::default();
    let mut on_windows = Tally::default();
    for map in maps {
        lab.phase(&format!("checked rays, {}", map.name));
        for set in 0..SETS.len() {
            // Brute force takes longer on larger maps.
            let share = whole / (maps.len() * SETS.len()) as u32;
            on_whole = on_whole.add(check_whole(lab, map, set, map.fewer(share)));
        }
        lab.phase(&format!("checked rays, windows of {}", map.name));
        on_windows = on_windows.add(check_windows(lab, map, per_map));
    }
    let all = on_whole.clone().add(on_windows.clone());
    section.prose(format!(
        "Beyond the timed rays, {} more were traced by `pyramid` (single, batch) and by `dda`, compared bit for bit, and \
         against brute force: {} over whole maps, the others over windows of 16 to 120 pixels cut out of them, where \
         brute force is quick. For {} of them rounding decides. The largest relative error of a hit is {}.",
        number(all.rays as f64),
        number(on_whole.rays as f64),
        number(all.ambiguous as f64),
        number(all.largest)
    ));
    let n = all.rays;
    for (what, got) in [
        ("`pyramid` differs from `dda` in any bit", all.differ),
        ("`pyramid` misses", all.missed),
        ("`pyramid` hits what is not there", all.false_hits),
        ("`pyramid` is off by more than 1 %", all.wrong),
        (
            "`pyramid` takes environment for unknown or the reverse",
            all.confused,
        ),
    ] {
        section.bound(Bound::none_of(what, got, n));
    }
}

fn check_whole(lab: &Lab, map: &Map, set: usize, n: u32) -> Tally {
    const CHUNK: u32 = 256;
    lab.pool().install(|| {
        (0..n.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| check_rays(map, set, chunk * CHUNK..((chunk + 1) * CHUNK).min(n)))
            .reduce(Tally::default, Tally::add)
    })
}

fn check_windows(lab: &Lab, map: &Map, n: u32) -> Tally {
    /// Rays of one set at one window.
    const RAYS: u32 = 700;
    lab.pool().install(|| {
        (0..n.div_ceil(RAYS * SETS.len() as u32))
            .into_par_iter()
            .map(|k| {
                let window = map.window(k);
                let tallies = (0..SETS.len()).map(|set| {
                    // A ball fills pi/4 of the square that its rays are sought in.
                    let n = if set == 1 { RAYS * 4 / 3 } else { RAYS };
                    // Other numbers for every window.
                    check_rays(&window, set, k * n..(k + 1) * n)
                });
                tallies.fold(Tally::default(), Tally::add)
            })
            .reduce(Tally::default, Tally::add)
    })
}

fn check_rays(map: &Map, set: usize, numbers: Range<u32>) -> Tally {
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
}

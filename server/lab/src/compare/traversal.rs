//! Depth-map traversals against brute force in double precision.

mod map;
mod tally;

use std::ops::Range;

use anyhow::Result;
use rayon::prelude::*;

use self::map::{Map, SETS, checked_rays, timed_rays};
use self::tally::Tally;
use super::ghost_rays::TRACERS;
use super::{Axis, Bound, Curve, Lab, Section, median, number, quantile, take_turns};
use crate::oracle::ghost::Verdict;
use crate::synth::room_depth;
use ghostlight::ghost::GhostOutcome;
use ghostlight::render::Traversal;

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let maps = maps(lab)?;
    let mut section = Section::new();
    section.prose(
        "In (u, v, 1/z) a ray is a straight segment and the depth map is a height field of triangles. RT2AR's \
         traversal takes one sample per pixel (`bresenham`); `dda` visits every cell; `pyramid` skips tiles that \
         a min/max pyramid excludes, one ray at a time or in batches as frames do. The reference tests every \
         triangle, in camera space and double precision; rays whose outcome depends on rounding, according to the \
         reference, are ignored. One thread.",
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

/// The bundled room with sensed and with exact depth, and the real recordings.
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

/// Adds a point for each traversal; returns nanoseconds per ray.
fn measure(lab: &Lab, map: &Map, set: usize, curve: &mut Curve) -> Vec<f64> {
    let rays = timed_rays(map, set, map.fewer(lab.pick(1_000, 10_000)));
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

/// Speed of the batch traversal relative to the others, for each map and set.
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

/// Checks the bounds: many rays with pyramid, plain walk and brute force. Brute force over whole maps is slow, so
/// most rays are cast at windows of them, each treated as a depth map of its own.
fn check(lab: &Lab, maps: &[Map], section: &mut Section) {
    let whole: u32 = lab.pick(6_000, 100_000);
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
        "In addition to the timed rays, {} more were traced with `pyramid` (single, batch) and with `dda`, \
         compared bit for bit, and compared with brute force: {} over whole maps, the others over windows of 8 to \
         72 pixels of them, for which brute force is fast. For {} of them the outcome depends on rounding. The \
         largest relative error of a hit is {}.",
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
    /// Rays of one set for one window.
    const RAYS: u32 = 700;
    lab.pool().install(|| {
        (0..n.div_ceil(RAYS * SETS.len() as u32))
            .into_par_iter()
            .map(|k| {
                let window = map.window(k);
                let tallies = (0..SETS.len()).map(|set| {
                    // A ball covers pi/4 of the square from which its rays are chosen.
                    let n = if set == 1 { RAYS * 4 / 3 } else { RAYS };
                    // Different random numbers for every window.
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

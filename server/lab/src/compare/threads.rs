//! One thread against several: the output must be identical.

use anyhow::Result;

use super::frames::at_most;
use super::{Axis, Bound, Curve, Lab, Section, clock, take_turns};
use ghostlight::render::{Engine, RenderSettings};

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let frame = at_most(&desk.frame, lab.pick(320, 640))?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut counts = vec![1, 2, 3, 5, 8, cores];
    counts.sort_unstable();
    counts.dedup();

    let mut section = Section::new();
    section.prose(format!(
        "Work is distributed by tiles, and the result of a tile does not depend on the thread. More threads than \
         the {cores} hardware threads are used to disturb the order."
    ));
    for (name, file) in [
        ("mirror teapot", "teapot.json"),
        ("seven solids", "materials.json"),
    ] {
        lab.phase(name);
        let scene = lab.bundled_scene(file, &desk.frame)?;
        let mut variants = Vec::new();
        for &threads in &counts {
            let engine = Engine::new(lab.engine().backend(), threads, clock)?;
            variants.push((engine.renderer(&scene)?, None));
        }
        let settings = RenderSettings::default();
        let seconds = take_turns(lab.rounds(), &mut variants, |(renderer, last)| {
            let rendered = renderer.render(&frame, &settings, &[]).ok();
            *last = rendered.map(|rendered| rendered.color);
        });
        let columns = [
            ("threads", ""),
            ("frame", "ms"),
            ("times faster than one", "x"),
        ];
        let mut curve = Curve::new(
            format!("{} ({}x{})", name, frame.color.width, frame.color.height),
            columns,
        )
        .plot(Axis::Linear(0), Axis::Linear(1));
        for (&threads, &s) in counts.iter().zip(&seconds) {
            let label = format!("{threads}");
            curve.point("", label, [threads as f64, s * 1e3, seconds[0] / s]);
        }
        section.curve(curve);
        let differ = variants.iter().filter(|(_, last)| *last != variants[0].1);
        section.bound(Bound::none_of(
            format!("{name}: thread counts whose picture differs from one thread's in any byte"),
            differ.count(),
            counts.len(),
        ));
    }
    Ok(section)
}

//! The hard cases, each with its measured result.

use std::time::Instant;

use anyhow::Result;

use super::{Bound, Curve, Lab, Section, number};
use crate::hard::{CASES, Effort};

/// Runs the experiment.
pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let effort = lab.pick(Effort::QUICK, Effort::FULL);
    let mut section = Section::new();
    section.prose(format!(
        "Each case states its bound and from what it follows; `cargo test` runs the same list. \
         Closed meshes are tried with {} rays aimed at edges and vertices.",
        number(effort.watertight_rays as f64)
    ));
    let columns = [
        ("measured", ""),
        ("tried", ""),
        ("bound", ""),
        ("why it is hard", ""),
        ("time", "s"),
        ("rate", "1/s"),
    ];
    let mut curve = Curve::new("Hard cases", columns);
    for case in CASES {
        lab.phase(case.name);
        let start = Instant::now();
        let outcome = lab.pool().install(|| (case.check)(&effort));
        let seconds = start.elapsed().as_secs_f64();
        let (got, trials, kept) = match outcome {
            Ok(measured) => (measured.got, measured.trials as f64, true),
            Err(broken) => (broken, f64::NAN, false),
        };
        curve.point(
            "",
            case.name,
            [
                got.as_str().into(),
                trials.into(),
                case.bound.into(),
                case.why.into(),
                seconds.into(),
                super::Cell::from((trials / seconds).round()),
            ],
        );
        section.bound(Bound::new(case.name, case.bound, got, kept));
    }
    section.curve(curve);
    Ok(section)
}

//! The laboratory: measures every approximation as a point of time against error, beside its reference.
//!
//! `ghostlight compare` runs [`EXPERIMENTS`] and writes a page, tables and JSON. An experiment is
//! a function from a [`Lab`] to a [`Section`]; adding one is a file and a line in that list:
//!
//! ```
//! use ghostlight_lab::compare::{Axis, Bound, Curve, Lab, Section, take_turns};
//!
//! /// The square root, by Newton's steps.
//! fn run(lab: &mut Lab) -> anyhow::Result<Section> {
//!     let mut section = Section::new();
//!     section.prose("Newton's steps from `x / 2`, against the processor's square root.");
//!     let newton = |steps: u32| (0..steps).fold(1.0, |y, _| 0.5 * (y + 2.0 / y));
//!     let mut variants: Vec<(u32, f64)> = (1..=4).map(|steps| (steps, 0.0)).collect();
//!     // Variants run in turn within each round; the median round counts.
//!     let seconds = take_turns(lab.rounds(), &mut variants, |(steps, y)| *y = newton(*steps));
//!     let columns = [("time", "ns"), ("relative error", "")];
//!     let mut curve = Curve::new("Square root of two", columns).plot(Axis::Linear(0), Axis::Log(1));
//!     for ((steps, y), seconds) in variants.iter().zip(seconds) {
//!         let error = (y / 2f64.sqrt() - 1.0).abs();
//!         curve.point("newton", format!("{steps} steps"), [seconds * 1e9, error]);
//!     }
//!     curve.point("", "f64::sqrt", [f64::NAN, 0.0]).reference();
//!     section.curve(curve);
//!     let last = (variants[3].1 / 2f64.sqrt() - 1.0).abs();
//!     section.bound(Bound::at_most("relative error after 4 steps", 1e-10, last, ""));
//!     Ok(section)
//! }
//! # let options = ghostlight_lab::compare::LabOptions {
//! #     quick: true, threads: 1, backend: Default::default(), home: "../..".into(), data: None, quiet: true,
//! # };
//! # run(&mut Lab::new(options).unwrap()).unwrap();
//! ```
//!
//! Rules for experiments:
//! - A [`Bound`] is on errors or counts, never on times.
//! - Errors are measured against a reference that shares no approximation with the variants.
//! - A figure from a paper states its [`Printed`] source and machine.
//! - [`Lab::pick`] makes the quick run quick; its bounds are the same.

mod bloom;
mod caustics;
mod cost;
mod detail;
mod edges;
mod frames;
pub mod ghost_rays;
mod glossy;
mod hard;
mod kernels;
mod lab;
mod lens;
mod machine;
pub mod mesh_rays;
mod output;
mod picture;
mod pipeline;
mod reflections;
mod report;
mod section;
mod shadows;
mod threads;
mod timer;
mod traversal;

use anyhow::Result;
use serde::Serialize;

pub use frames::{Shot, at_most, once, resized, rmse, rmse_gray, shadow_term, shoot, shoot_all};
pub use ghostlight::clock::render_clock as clock;
use ghostlight::render::Backend;
pub use lab::{Lab, LabOptions, View};
pub use machine::Machine;
pub use output::Output;
pub use picture::{Picture, Window};
pub use section::{Axis, Bound, Cell, Curve, Point, Printed, Section, number};
pub use timer::{median, quantile, take_turns};

/// A question that a measurement answers.
#[derive(Debug, Clone, Copy)]
pub struct Experiment {
    /// Name for `--only`; also the name of its CSV file.
    pub name: &'static str,
    /// Heading.
    pub title: &'static str,
    /// The question, in one sentence.
    pub question: &'static str,
    /// Runs the experiment.
    pub run: fn(&mut Lab) -> Result<Section>,
}

/// Every experiment, in the order of the report.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "traversal",
        title: "Depth-map traversal",
        question: "How fast are traversals of the ghost surface, and how often are they wrong?",
        run: traversal::run,
    },
    Experiment {
        name: "kernels",
        title: "Ray kernels",
        question: "Do all instruction sets find the same hits, and how fast?",
        run: kernels::run,
    },
    Experiment {
        name: "shadows",
        title: "Soft shadows",
        question: "How much error do fewer shadow rays cause?",
        run: shadows::run,
    },
    Experiment {
        name: "reflections",
        title: "Reflection depth",
        question: "How many bounces are enough?",
        run: reflections::run,
    },
    Experiment {
        name: "glossy",
        title: "Rough reflections",
        question: "How many rays does a rough reflection need?",
        run: glossy::run,
    },
    Experiment {
        name: "caustics",
        title: "Caustics",
        question: "How many photons does a caustic need, and how wide a kernel?",
        run: caustics::run,
    },
    Experiment {
        name: "edges",
        title: "Anti-aliasing",
        question: "Where are more rays worth their time?",
        run: edges::run,
    },
    Experiment {
        name: "detail",
        title: "Levels of detail",
        question: "How many triangles does a frame need?",
        run: detail::run,
    },
    Experiment {
        name: "lens",
        title: "Depth of field",
        question: "How many rays does a pixel out of focus need?",
        run: lens::run,
    },
    Experiment {
        name: "bloom",
        title: "Bloom and glare",
        question: "How large is the error of the fast methods relative to the sums that they approximate?",
        run: bloom::run,
    },
    Experiment {
        name: "threads",
        title: "Threads",
        question: "Is the picture the same for any number of threads?",
        run: threads::run,
    },
    Experiment {
        name: "cost",
        title: "Cost against size",
        question: "How does the time of a frame grow with the size of its scene?",
        run: cost::run,
    },
    Experiment {
        name: "pipeline",
        title: "Whole pipeline",
        question: "How large is the error of a composite relative to path tracing, and does it come from the sensor or the renderer?",
        run: pipeline::run,
    },
    Experiment {
        name: "hard",
        title: "Hard cases",
        question: "Do known hard cases keep their bounds?",
        run: hard::run,
    },
];

/// An experiment that was run.
#[derive(Debug, Serialize)]
pub struct Finding {
    name: &'static str,
    title: &'static str,
    question: &'static str,
    /// How long the experiment took.
    seconds: f64,
    /// The error, if the experiment could not be finished.
    failed: Option<String>,
    section: Section,
}

/// The complete report.
#[derive(Debug, Serialize)]
pub struct Report {
    machine: Machine,
    settings: Settings,
    findings: Vec<Finding>,
}

#[derive(Debug, Serialize)]
struct Settings {
    quick: bool,
    threads: usize,
    backend: Backend,
    /// Names of the recordings used.
    views: Vec<&'static str>,
}

/// Error: bounds are broken, or experiments could not be finished.
#[derive(Debug, thiserror::Error)]
#[error("{broken} broken, {bounds} bounds in all; {page} shows them")]
pub struct BoundsBroken {
    /// Number of broken bounds and unfinished experiments.
    pub broken: usize,
    /// Number of all bounds.
    pub bounds: usize,
    /// Path of the report.
    pub page: String,
}

/// Runs experiments in order. One that fails is reported, and the others still run.
pub fn run(lab: &mut Lab, experiments: &[&Experiment]) -> Result<Report> {
    // Read at the start, because a checkout may change while its program runs.
    let machine = Machine::here();
    let views = lab.views()?.iter().map(|view| view.name).collect();
    let mut findings = Vec::with_capacity(experiments.len());
    for experiment in experiments {
        lab.begin(experiment.name);
        let start = clock();
        let result = (experiment.run)(lab);
        let seconds = (clock() - start) as f64 * 1e-9;
        let (section, failed) = match result {
            Ok(section) => (section, None),
            Err(error) => (Section::new(), Some(format!("{error:#}"))),
        };
        lab.phase(&format!("done in {seconds:.1} s"));
        lab.end();
        findings.push(Finding {
            name: experiment.name,
            title: experiment.title,
            question: experiment.question,
            seconds,
            failed,
            section,
        });
    }
    Ok(Report {
        machine,
        settings: Settings {
            quick: lab.quick(),
            threads: lab.pool().current_num_threads(),
            backend: lab.engine().backend(),
            views,
        },
        findings,
    })
}

impl Report {
    /// Broken bounds and failed experiments, one line each.
    pub fn broken(&self) -> Vec<String> {
        let mut told = Vec::new();
        for finding in &self.findings {
            if let Some(failed) = &finding.failed {
                told.push(format!("{}: {failed}", finding.name));
            }
            for bound in finding.section.bounds.iter().filter(|bound| !bound.kept) {
                told.push(format!(
                    "{}: {}: expected {}, got {}",
                    finding.name, bound.what, bound.expected, bound.got
                ));
            }
        }
        told
    }

    /// Number of all bounds, kept or broken.
    pub fn n_bounds(&self) -> usize {
        self.findings
            .iter()
            .map(|finding| finding.section.bounds.len())
            .sum()
    }

    /// Name and content of every file: the page, the JSON, one CSV per experiment.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>> {
        let mut files = vec![
            ("index.html".to_owned(), report::html(self).into_bytes()),
            ("compare.json".to_owned(), serde_json::to_vec_pretty(self)?),
        ];
        for finding in &self.findings {
            let csv = report::csv(&finding.section).into_bytes();
            files.push((format!("{}.csv", finding.name), csv));
        }
        Ok(files)
    }
}

#[cfg(test)]
mod tests;

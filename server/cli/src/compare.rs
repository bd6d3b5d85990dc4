//! `ghostlight compare`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use ghostlight::output;
use ghostlight::render::Backend;
use ghostlight_lab::compare::{
    self, BoundsBroken, EXPERIMENTS, Experiment, Lab, LabOptions, Output,
};

use super::bundled::Home;

/// Measure speed against error for every approximation.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight compare --out report                  everything, tens of minutes
  ghostlight compare --quick --out report          under two minutes
  ghostlight compare --only traversal,shadows --out report
  ghostlight compare --list

Writes index.html, compare.json and a CSV per experiment; a second run into the same folder
replaces them. Exit code 0 only if every bound is kept, else 1, with each broken one named.
Bounds are on errors and counts, never on times. Real recordings are used where GHOSTLIGHT_DATA
or --data names their folder.")]
pub(crate) struct CompareArgs {
    /// Folder for the report
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Fewer rays, smaller pictures, fewer rounds; the same bounds
    #[arg(long)]
    quick: bool,
    /// Run only these experiments
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = experiment)]
    only: Vec<&'static Experiment>,
    /// List the experiments
    #[arg(long)]
    list: bool,
    /// Folder of real recordings
    #[arg(long, value_name = "DIR", env = "GHOSTLIGHT_DATA")]
    data: Option<PathBuf>,
    /// Threads; 0 for one per core
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=1024))]
    threads: u16,
    /// Rendering backend
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
}

pub(crate) fn run(args: &CompareArgs) -> Result<()> {
    if args.list {
        for experiment in EXPERIMENTS {
            let (name, question) = (experiment.name, experiment.question);
            output::print(format_args!("{name:<12} {question}"))?;
        }
        return Ok(());
    }
    let out = args.out.as_ref().context("--out: expected a folder")?;
    output::clean_up_on_signals()?;
    // Before the work, so that minutes of it are not lost because a folder cannot be written.
    let output = Output::new(out)?;
    let home = Home::find()?;
    let mut lab = Lab::new(LabOptions {
        quick: args.quick,
        threads: usize::from(args.threads),
        backend: args.backend,
        home: home.path().to_owned(),
        data: args
            .data
            .clone()
            .filter(|folder| !folder.as_os_str().is_empty()),
        quiet: args.quiet,
    })?;
    let chosen: Vec<&Experiment> = EXPERIMENTS
        .iter()
        .filter(|experiment| {
            args.only.is_empty() || args.only.iter().any(|only| only.name == experiment.name)
        })
        .collect();
    let report = compare::run(&mut lab, &chosen)?;
    output.write(&report.files()?)?;
    let page = out.join("index.html").display().to_string();
    let broken = report.broken();
    for line in &broken {
        output::tell(format_args!("broken: {line}"));
    }
    if !broken.is_empty() {
        return Err(BoundsBroken {
            broken: broken.len(),
            bounds: report.n_bounds(),
            page,
        }
        .into());
    }
    if !args.quiet {
        let bounds = report.n_bounds();
        output::print(format_args!("{page}: all {bounds} bounds are kept"))?;
    }
    Ok(())
}

/// An experiment by its name.
fn experiment(name: &str) -> Result<&'static Experiment, String> {
    let found = EXPERIMENTS
        .iter()
        .find(|experiment| experiment.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = EXPERIMENTS
            .iter()
            .map(|experiment| experiment.name)
            .collect();
        format!("expected some of {}, got {name:?}", names.join(", "))
    })
}

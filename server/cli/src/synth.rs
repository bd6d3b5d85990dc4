//! `ghostlight synth`.

use std::path::PathBuf;

use anyhow::Result;
use ghostlight::output;
use ghostlight_lab::synth::{self, SynthOptions};

use super::replay::progress_bar;

/// Render a recording of a desk with exact depth, poses and sensor noise.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight synth --out recordings/desk
  ghostlight synth --out small --frames 10 --size 320x240 --quick

Writes TUM's layout: rgb/, depth/ (as a Kinect senses it), depth_exact/, poses, and a manifest.")]
pub(crate) struct SynthArgs {
    /// Folder to create; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of frames
    #[arg(long, value_name = "N", default_value_t = SynthOptions::default().frames)]
    frames: u32,
    /// Image size, pixels
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = size)]
    size: (u32, u32),
    /// Seed of the camera's path and of sensor noise; the room stays the same
    #[arg(long, default_value_t = SynthOptions::default().seed)]
    seed: u32,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value_t = SynthOptions::default().rate_hz)]
    rate: f64,
    /// Rays per pixel of colour: N x N
    #[arg(long, value_name = "N", default_value_t = SynthOptions::default().samples)]
    samples: u32,
    /// Do not write depth_exact/
    #[arg(long)]
    no_exact_depth: bool,
    /// Coarse lighting: seconds instead of minutes
    #[arg(long)]
    quick: bool,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
}

pub(crate) fn run(args: &SynthArgs) -> Result<()> {
    let options = SynthOptions {
        out: args.out.clone(),
        frames: args.frames,
        width: args.size.0,
        height: args.size.1,
        seed: args.seed,
        rate_hz: args.rate,
        samples: args.samples,
        exact_depth: !args.no_exact_depth,
        quick: args.quick,
    };
    output::clean_up_on_signals()?;
    let bar = progress_bar(args.quiet);
    let summary = synth::run(&options, &bar);
    bar.finish_and_clear();
    let summary = summary?;
    if !args.quiet {
        output::print(format_args!(
            "{} frames in {}, {:.1} MB; {:.1} % of the depth is holes",
            summary.frames,
            args.out.display(),
            summary.bytes as f64 * 1e-6,
            summary.hole_share * 100.0
        ))?;
    }
    Ok(())
}

/// Parses `WxH`, pixels.
fn size(text: &str) -> Result<(u32, u32), String> {
    text.split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)))
        .ok_or_else(|| format!("expected WxH as in 640x480, got {text:?}"))
}

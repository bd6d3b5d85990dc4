//! `ghostlight inspect`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use ghostlight::output;
use ghostlight::recording::OpenOptions;
use ghostlight::scene::inspect_scene;

use super::input;

/// Say what is in a recording or scene, and what is odd about it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight inspect recordings/desk
  ghostlight inspect recordings/scenes/teapot.json
  ghostlight inspect teapot.glb

A folder is taken for a recording, a file for a scene document or a mesh.")]
pub(super) struct Args {
    /// Folder of a recording, scene document, or mesh file
    #[arg(value_name = "RECORDING|SCENE")]
    path: PathBuf,
    /// Intrinsics of the colour camera in pixels, instead of the recording's
    #[arg(long, value_name = "fx,fy,cx,cy", value_parser = input::intrinsics)]
    intrinsics: Option<[f64; 4]>,
    /// Depth units per metre, instead of the recording's
    #[arg(long, value_name = "UNITS_PER_METRE", value_parser = input::depth_scale)]
    depth_scale: Option<f64>,
}

pub(super) fn run(args: &Args) -> Result<()> {
    let path = &args.path;
    if path.is_dir() {
        let options = OpenOptions {
            intrinsics: args.intrinsics,
            depth_units_per_metre: args.depth_scale,
            ..OpenOptions::default()
        };
        let recording = input::open_recording(path, &options)?;
        // Ends in a line break or not, as it likes.
        output::print(recording.inspect()?.to_string().trim_end())?;
    } else if path.is_file() {
        output::print(inspect_scene(path)?.to_string().trim_end())?;
    } else {
        bail!("{}: expected a folder or file, found none", path.display());
    }
    Ok(())
}

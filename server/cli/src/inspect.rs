//! `ghostlight inspect`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use ghostlight::output;
use ghostlight::recording::{Recording, RecordingArgs};
use ghostlight::scene::inspect_scene;

use super::input;

/// Describe a recording, scene or mesh, and list anything unusual.
#[derive(Debug, clap::Args)]
#[command(after_help = help())]
pub(crate) struct InspectArgs {
    /// Folder or zip archive of a recording, scene document, or mesh file
    #[arg(value_name = "RECORDING|SCENE")]
    path: PathBuf,
    #[command(flatten)]
    recording: RecordingArgs,
}

fn help() -> String {
    let mut help = "Examples:
  ghostlight inspect recordings/desk
  ghostlight inspect recordings/scenes/teapot.json
  ghostlight inspect teapot.glb

A folder or a zip archive is taken for a recording, another file for a scene document or a mesh.
Recordings are told by what is in them:"
        .to_owned();
    for (name, looked_for) in Recording::layouts() {
        help += &format!("\n  {name:<17} {looked_for}");
    }
    help
}

pub(crate) fn run(args: &InspectArgs) -> Result<()> {
    let path = &args.path;
    if Recording::is_container(path) {
        let recording = input::open_recording(path, &args.recording.options())?;
        // The report may end in a line break, and `print` adds one.
        output::print(recording.inspect()?.to_string().trim_end())?;
    } else if let Some(error) = Recording::container_error(path) {
        return Err(error.into());
    } else if path.is_file() {
        output::print(inspect_scene(path)?.to_string().trim_end())?;
    } else {
        bail!("{}: expected a folder or file, found none", path.display());
    }
    Ok(())
}

//! The bundled recording, meshes and scenes: those of the checkout, or otherwise the copy embedded in the
//! program, unpacked to a temporary folder while it runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use ghostlight::output::Draft;
use include_dir::{Dir, include_dir};

/// The recording, relative to the home folder.
pub(crate) const RECORDING: &str = "recordings/desk";
/// Its scenes, relative to the home folder.
pub(crate) const SCENES: &str = "recordings/scenes";
/// The scene that a viewer sees first.
pub(crate) const SCENE: &str = "recordings/scenes/teapot.json";

/// The parts of `recordings/` that the program embeds; pictures for the documentation are left out.
static PARTS: [(&str, Dir<'_>); 4] = [
    (
        "desk",
        include_dir!("$CARGO_MANIFEST_DIR/../../recordings/desk"),
    ),
    (
        "meshes",
        include_dir!("$CARGO_MANIFEST_DIR/../../recordings/meshes"),
    ),
    (
        "scenes",
        include_dir!("$CARGO_MANIFEST_DIR/../../recordings/scenes"),
    ),
    (
        "settings",
        include_dir!("$CARGO_MANIFEST_DIR/../../recordings/settings"),
    ),
];

/// A folder that holds `recordings/`.
#[derive(Debug)]
pub(crate) struct Home {
    path: PathBuf,
    /// Removed when this is dropped, by a signal handler, or by the next run if the process was killed.
    _unpacked: Option<Draft>,
}

impl Home {
    /// The first of these that holds the recording: the working directory, the checkout from which this program
    /// was built, the folder of the executable. Otherwise a temporary folder with the embedded copy.
    pub(crate) fn find() -> Result<Self> {
        let mut tried = vec![PathBuf::new()];
        tried.push(Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."));
        if let Ok(program) = std::env::current_exe() {
            tried.extend(program.parent().map(Path::to_owned));
        }
        let found = tried.into_iter().find(|home| home.join(RECORDING).is_dir());
        match found {
            Some(path) => Ok(Self {
                path,
                _unpacked: None,
            }),
            None => Self::unpack(&std::env::temp_dir()),
        }
    }

    fn unpack(into: &Path) -> Result<Self> {
        let name = format!("ghostlight-recordings-{}", std::process::id());
        let context = || format!("{}: unpacking the bundled recording", into.display());
        let draft = Draft::private_folder(&into.join(name)).with_context(context)?;
        for (name, part) in &PARTS {
            let folder = draft.path().join("recordings").join(name);
            std::fs::create_dir_all(&folder)
                .and_then(|()| part.extract(&folder))
                .with_context(context)?;
        }
        Ok(Self {
            path: draft.path().to_owned(),
            _unpacked: Some(draft),
        })
    }

    /// A path relative to the home folder.
    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The folder.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_carried_is_what_the_checkout_has() {
        let folder = std::env::temp_dir().join(format!("ghostlight-test-{}", std::process::id()));
        std::fs::create_dir(&folder).unwrap();
        let home = Home::unpack(&folder).unwrap();
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let recording = ghostlight::recording::Recording::open(
            &home.join(RECORDING),
            &ghostlight::recording::OpenOptions::default(),
        );
        assert_eq!(recording.unwrap().len(), 72);
        for name in [
            SCENE,
            "recordings/meshes/teapot.ply",
            "recordings/settings/caustics.json",
        ] {
            let carried = std::fs::read(home.join(name)).unwrap();
            assert_eq!(
                carried,
                std::fs::read(checkout.join(name)).unwrap(),
                "{name}"
            );
        }
        drop(home);
        // Fails unless the folder is empty.
        std::fs::remove_dir(&folder).unwrap();
    }
}

//! Command-line flags that describe a scene: meshes without a document, and changes to a document.

use std::path::{Path, PathBuf};

use super::document::{MaterialSpec, Object, PicturePoint, Preset, SceneDocument};
use super::error::SceneError;
use super::spot::LOWER_MIDDLE;
use crate::json;

/// Distance between objects without a given place, as a share of the picture's width.
const APART: f64 = 0.2;

impl std::str::FromStr for PicturePoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected =
            || format!("expected two numbers U,V (pixels) or U%,V% (of the picture), got {text:?}");
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let [u, v] = parts[..] else {
            return Err(expected());
        };
        let number = |text: &str| {
            let x = text.trim().parse().ok();
            x.filter(|x: &f64| x.is_finite()).ok_or_else(expected)
        };
        match (u.strip_suffix('%'), v.strip_suffix('%')) {
            (Some(u), Some(v)) => {
                let picture = [number(u)? / 100.0, number(v)? / 100.0];
                if picture.iter().all(|x| (0.0..=1.0).contains(x)) {
                    Ok(Self::Share(picture))
                } else {
                    Err(format!("expected 0% to 100%, got {text:?}"))
                }
            }
            (None, None) => Ok(Self::Pixel([number(u)?, number(v)?])),
            _ => Err(expected()),
        }
    }
}

/// Parses a length in metres, over zero.
fn size(text: &str) -> Result<f64, String> {
    match text.trim().parse() {
        Ok(size) if (1e-6..=1e6).contains(&size) => Ok(size),
        _ => Err(format!("expected metres over 0, as in 0.25, got {text:?}")),
    }
}

/// Parses the name of a preset.
fn material(text: &str) -> Result<Preset, String> {
    let name = text.trim().to_lowercase().replace([' ', '-'], "_");
    let found = Preset::ALL.into_iter().find(|preset| preset.name() == name);
    found.ok_or_else(|| {
        let names = Preset::ALL.map(Preset::name);
        match json::nearest(&name, names) {
            Some(meant) => format!("unknown material {text:?}, did you mean {meant:?}?"),
            None => format!("expected one of {}, got {text:?}", names.join(", ")),
        }
    })
}

/// Objects given on the command line.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ObjectFlags {
    /// Mesh to add (.glb, .gltf, .obj, .ply), as in --object duck.glb; repeatable, no document
    /// needed
    #[arg(long = "object", value_name = "FILE")]
    pub objects: Vec<PathBuf>,
    /// Largest side of each --object (else of the scene's first object), metres, as in --size 0.25;
    /// without it a mesh over 1 m or under 2 cm is brought to 0.25 m
    #[arg(long, value_name = "M", value_parser = size, allow_negative_numbers = true)]
    pub size: Option<f64>,
    /// Material of each --object (else of the scene's first object), as in --material gold;
    /// `ghostlight presets` lists them
    #[arg(long, value_name = "PRESET", value_parser = material)]
    pub material: Option<Preset>,
    /// Stand the --object (else the scene's first object) on the real surface at this pixel of the
    /// first frame, as in --place 320,300, or at shares of its size, as in --place 50%,65%; without
    /// it an --object stands on the level surface nearest to the picture's lower middle
    #[arg(long, value_name = "U,V|U%,V%")]
    pub place: Option<PicturePoint>,
}

impl ObjectFlags {
    /// Whether no flag is given.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
            && self.size.is_none()
            && self.material.is_none()
            && self.place.is_none()
    }

    /// The document of a scene file (or the one made for a mesh), with the additions and changes of the flags, and
    /// the folder that its paths are relative to. Objects of the command line come first.
    pub fn document(&self, scene: Option<&Path>) -> Result<(SceneDocument, PathBuf), SceneError> {
        let (mut document, folder) = match scene {
            Some(scene) => SceneDocument::load(scene)?,
            None => (
                SceneDocument::of_objects(Vec::new(), "--object".to_owned()),
                PathBuf::new(),
            ),
        };
        let added = self.added()?;
        let n_changed = added.len().max(1);
        document.objects.splice(0..0, added);
        self.change(&mut document, n_changed)?;
        Ok((document, folder))
    }

    /// The meshes as objects, side by side.
    fn added(&self) -> Result<Vec<Object>, SceneError> {
        let n = self.objects.len();
        let mut added = Vec::with_capacity(n);
        for (i, mesh) in self.objects.iter().enumerate() {
            // Absolute, because the document's paths are relative to another folder.
            let path = std::path::absolute(mesh).map_err(|error| SceneError::File {
                file: mesh.display().to_string(),
                reason: error.to_string(),
            })?;
            let path = path.to_str().ok_or_else(|| SceneError::File {
                file: mesh.display().to_string(),
                reason: "expected a path that is UTF-8".to_owned(),
            })?;
            let mut object = Object::of_mesh(path.to_owned());
            if n > 1 {
                let [x, y] = match self.place {
                    Some(PicturePoint::Share(picture)) => picture,
                    _ => LOWER_MIDDLE,
                };
                let aside = (i as f64 - (n - 1) as f64 / 2.0) * APART;
                object.place.picture = Some([(x + aside).clamp(0.0, 1.0), y]);
            }
            added.push(object);
        }
        Ok(added)
    }

    /// Sets size, material and place of the first `n` objects.
    fn change(&self, document: &mut SceneDocument, n: usize) -> Result<(), SceneError> {
        let flags = [
            ("--size", self.size.is_some()),
            ("--material", self.material.is_some()),
            ("--place", self.place.is_some()),
        ];
        let given = flags.into_iter().find(|(_, given)| *given);
        let refuse = |file: &str, flag: &str, problem: &str| SceneError::Field {
            file: file.to_owned(),
            path: flag.to_owned(),
            problem: problem.to_owned(),
        };
        if let (true, Some((flag, _))) = (document.objects.is_empty(), given) {
            let problem = "expected an object that it is for, got none: add one with --object";
            return Err(refuse(&document.file, flag, problem));
        }
        if n > 1 && matches!(self.place, Some(PicturePoint::Pixel(_))) {
            let problem = "expected U%,V% for several objects, which are placed side by side there";
            return Err(refuse(&document.file, "--place", problem));
        }
        for object in document.objects.iter_mut().take(n) {
            if let Some(size) = self.size {
                object.place.scale = None;
                object.place.size_m = Some(size);
            }
            if let Some(preset) = self.material {
                object.material = Some(MaterialSpec {
                    preset: Some(preset),
                    ..MaterialSpec::default()
                });
            }
            if let (1, Some(place)) = (n, self.place) {
                object.place = object.place.on_surface_at(place);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flags(args: &[&str]) -> Result<ObjectFlags, String> {
        #[derive(clap::Parser)]
        struct Whole {
            #[command(flatten)]
            flags: ObjectFlags,
        }
        let args = std::iter::once("test").chain(args.iter().copied());
        let whole: Result<Whole, _> = clap::Parser::try_parse_from(args);
        whole.map(|whole| whole.flags).map_err(|e| e.to_string())
    }

    #[test]
    fn places_are_pixels_or_shares() {
        let place = |text: &str| text.parse::<PicturePoint>();
        assert_eq!(place("320,300"), Ok(PicturePoint::Pixel([320.0, 300.0])));
        assert_eq!(place(" 50%, 70 % "), Ok(PicturePoint::Share([0.5, 0.7])));
        for text in ["5", "5,6,7", "50%,7", "101%,5%", "nan,1", "a,b", ""] {
            assert!(place(text).is_err(), "{text}");
        }
    }

    #[test]
    fn values_that_are_none_are_refused_with_what_was_meant() {
        for (args, words) in [
            (["--material", "silver"], "expected one of matte"),
            (["--material", "goldd"], "did you mean \"gold\"?"),
            (["--size", "-1"], "expected metres over 0"),
            (["--size", "nan"], "expected metres over 0"),
        ] {
            let error = flags(&args).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        let spelt = flags(&["--material", "Brushed-Metal"]).unwrap();
        assert_eq!(spelt.material, Some(Preset::BrushedMetal));
    }

    #[test]
    fn objects_come_first_and_take_what_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene.json");
        let text = r#"{"version": 1, "objects": [{"mesh": "a.obj", "place": {"scale": 2}}]}"#;
        std::fs::write(&scene, text).unwrap();
        let given = ["--size", "0.2", "--material", "gold", "--place", "50%,70%"];
        let changed = flags(&given).unwrap();
        let (document, base) = changed.document(Some(&scene)).unwrap();
        assert_eq!(base, folder.path());
        let place = &document.objects[0].place;
        assert_eq!((place.scale, place.size_m), (None, Some(0.2)));
        assert_eq!(place.picture, Some([0.5, 0.7]));
        // Objects added to a scene do not change the scene's own objects.
        let added = flags(&[&given[..], &["--object", "b.glb"]].concat()).unwrap();
        let (document, _) = added.document(Some(&scene)).unwrap();
        assert_eq!(document.objects.len(), 2);
        assert!(document.objects[0].mesh.ends_with("b.glb"));
        assert!(Path::new(&document.objects[0].mesh).is_absolute());
        assert_eq!(document.objects[1].place.scale.map(|s| s.0), Some([2.0; 3]));
        assert_eq!(document.objects[1].material, None);
        // Several objects are placed side by side, in order.
        let three = [
            "--object", "a.glb", "--object", "b.glb", "--object", "c.glb",
        ];
        let (document, _) = flags(&three).unwrap().document(None).unwrap();
        let objects = document.objects.iter();
        let x: Vec<f64> = objects.map(|o| o.place.picture.unwrap()[0]).collect();
        assert!(
            x[0] < x[1] && x[1] < x[2] && x[1] == LOWER_MIDDLE[0],
            "{x:?}"
        );
        let at = [&three[..], &["--place", "3,4"]].concat();
        let error = flags(&at).unwrap().document(None).unwrap_err();
        assert!(error.to_string().contains("U%,V%"), "{error}");
    }

    #[test]
    fn without_an_object_there_is_nothing_to_change() {
        for flag in [["--size", "1"], ["--material", "gold"], ["--place", "1,1"]] {
            let error = flags(&flag)
                .unwrap()
                .document(None)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains(flag[0]) && error.contains("--object"),
                "{error}"
            );
        }
    }
}

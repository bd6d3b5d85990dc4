//! A session's scene: its document, its uploads, where its objects were put since, and the
//! renderer that holds it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ghostlight_proto::control::{ObjectInfo, SceneChoice, Stands};
use ghostlight_proto::{Code, WireError};
use glam::{DAffine3, DQuat};
use tempfile::TempDir;

use super::backend::{Assets, EncodedFrame, SceneRenderer, Unrendered};
use super::clock;
use super::scene_stand::{Object, Sensed, Stand, objects, pose_of};
use crate::frame::RgbdFrame;
use crate::render::{Aov, Checkpoint, RenderError, RenderSettings, Rendered, Renderer};
use crate::scene::{
    LoadContext, PlaceFrame, ResolveOptions, Resolved, Scene, SceneDocument, SceneError,
};

/// Said of an object that was put where nothing was measured.
const NOTHING_MEASURED: &str = "Nothing measured there: put nearby.";

/// A document and the folder that its paths are relative to.
#[derive(Clone)]
struct Source {
    name: Option<String>,
    document: SceneDocument,
    folder: PathBuf,
}

/// Where a scene on offer comes from.
#[derive(Debug, Clone)]
pub(super) enum OfferedScene {
    /// A document or mesh, read whenever it is chosen: it may have changed.
    File(PathBuf),
    /// The command line's, with absolute paths.
    Flags(Arc<SceneDocument>),
}

impl OfferedScene {
    fn load(&self) -> Result<(SceneDocument, PathBuf), SceneError> {
        match self {
            Self::File(path) => SceneDocument::load(path),
            Self::Flags(document) => Ok((SceneDocument::clone(document), PathBuf::new())),
        }
    }
}

/// A scene and its renderer.
pub(super) struct SceneRoom {
    scenes: Arc<[(String, OfferedScene)]>,
    threads: usize,
    max_triangles: usize,
    renderer: Renderer,
    source: Option<Source>,
    /// Objects of the resolved scene, as the document has them; none before the first frame.
    objects: Vec<Object>,
    scene: Scene,
    /// The document waits for a frame to be placed in.
    pending: bool,
    uploads: Option<Uploads>,
}

/// Uploads as files, where the loaders look for them; gone with the session.
struct Uploads {
    folder: TempDir,
    written: BTreeMap<String, Arc<Vec<u8>>>,
}

impl SceneRoom {
    /// Without a scene.
    pub(super) fn new(
        scenes: Arc<[(String, OfferedScene)]>,
        threads: usize,
        max_triangles: usize,
    ) -> Result<Self, WireError> {
        let scene = Scene::default();
        Ok(Self {
            scenes,
            threads,
            max_triangles,
            renderer: build(&scene, threads)?,
            source: None,
            objects: Vec::new(),
            scene,
            pending: false,
            uploads: None,
        })
    }

    fn load(&mut self, scene: &SceneChoice, assets: &Assets) -> Result<Source, WireError> {
        match scene {
            SceneChoice::Name(name) => {
                let known = self.scenes.iter().find(|(known, _)| known == name);
                let Some((_, path)) = known else {
                    return Err(WireError::new(
                        Code::NotFound,
                        "scene",
                        "one of /api/v1/scenes",
                        name,
                    ));
                };
                let (document, folder) = path.load().map_err(refused)?;
                Ok(Source {
                    name: Some(name.clone()),
                    document,
                    folder,
                })
            }
            SceneChoice::Document(map) => {
                let text = serde_json::to_string(map)
                    .map_err(|e| WireError::new(Code::Scene, "scene", "a document", e))?;
                let document = SceneDocument::parse(&text, "scene").map_err(refused)?;
                check_names(&document, assets)?;
                Ok(Source {
                    name: None,
                    document,
                    folder: self.write_uploads(assets)?,
                })
            }
        }
    }

    /// Brings the folder of uploads up to date.
    fn write_uploads(&mut self, assets: &Assets) -> Result<PathBuf, WireError> {
        let failed =
            |e: std::io::Error| WireError::new(Code::Internal, "asset", "room for it on disk", e);
        let uploads = match &mut self.uploads {
            Some(uploads) => uploads,
            none => none.insert(Uploads {
                folder: TempDir::with_prefix("ghostlight-").map_err(failed)?,
                written: BTreeMap::new(),
            }),
        };
        for (name, content) in assets {
            let same = uploads
                .written
                .get(name)
                .is_some_and(|w| Arc::ptr_eq(w, content));
            if !same {
                // The name was checked when it was announced: one plain file name.
                std::fs::write(uploads.folder.path().join(name), content.as_slice())
                    .map_err(failed)?;
                uploads.written.insert(name.clone(), Arc::clone(content));
            }
        }
        Ok(uploads.folder.path().to_owned())
    }

    fn resolve(&mut self, source: Source, frame: &RgbdFrame) -> Result<(), WireError> {
        let surface = Sensed::new(frame);
        let options = ResolveOptions {
            place_pixel: None,
            first_frame: frame,
            surface: &surface,
        };
        let Resolved {
            scene,
            notes,
            standings,
        } = source
            .document
            .resolve_with(&source.folder, &options, &LoadContext::default())
            .map_err(refused)?;
        for note in notes {
            tracing::info!(note, "scene");
        }
        let stored: usize = scene.meshes.iter().map(|m| m.triangles.len()).sum();
        if stored > self.max_triangles {
            return Err(WireError::new(
                Code::TooLarge,
                "scene, triangles",
                format_args!("at most {}", self.max_triangles),
                stored,
            ));
        }
        let renderer = build(&scene, self.threads)?;
        self.objects = objects(&source.document, &scene, &standings);
        self.renderer = renderer;
        self.scene = scene;
        self.source = Some(source);
        self.pending = false;
        Ok(())
    }

    fn find(&self, object: &str) -> Result<usize, WireError> {
        let names: Vec<String> = self.objects().into_iter().map(|o| o.name).collect();
        match names.iter().position(|name| name == object) {
            Some(i) if i < self.objects.len() => Ok(i),
            Some(_) => Err(WireError::new(
                Code::Object,
                "object",
                "a scene that is placed",
                "one that waits for its first frame",
            )),
            None => Err(WireError::new(
                Code::Object,
                "object",
                format_args!("one of {names:?}"),
                format_args!("{object:?}"),
            )),
        }
    }

    fn turn_instances(&mut self, i: usize, angle: f64) {
        let stand = self.objects[i].stand;
        let turn = DAffine3::from_translation(stand.point)
            * DAffine3::from_quat(DQuat::from_axis_angle(stand.axis, angle))
            * DAffine3::from_translation(-stand.point);
        self.move_instances(i, turn);
    }

    /// Moves an object by a rigid motion of the world.
    fn move_instances(&mut self, i: usize, motion: DAffine3) {
        for i in self.objects[i].instances.clone() {
            let world_from_object = &mut self.scene.instances[i].world_from_object;
            *world_from_object = motion * *world_from_object;
            self.renderer.set_transform(i, *world_from_object);
        }
    }
}

impl SceneRenderer for SceneRoom {
    fn set_scene(
        &mut self,
        scene: &SceneChoice,
        assets: &Assets,
        frame: Option<&RgbdFrame>,
    ) -> Result<(), WireError> {
        let source = self.load(scene, assets)?;
        match frame {
            Some(frame) => self.resolve(source, frame),
            None => {
                self.renderer = build(&Scene::default(), self.threads)?;
                self.scene = Scene::default();
                self.objects.clear();
                self.source = Some(source);
                self.pending = true;
                Ok(())
            }
        }
    }

    fn scene_settings(&self) -> Option<RenderSettings> {
        self.source.as_ref().and_then(|s| s.document.settings)
    }

    fn scene_name(&self) -> Option<String> {
        self.source.as_ref().and_then(|source| source.name.clone())
    }

    fn objects(&self) -> Vec<ObjectInfo> {
        let documents = self.source.iter().flat_map(|s| &s.document.objects);
        documents
            .enumerate()
            .map(|(i, document)| ObjectInfo {
                name: SceneDocument::name_of(document),
                stands: self.objects.get(i).and_then(|o| o.stands(&self.scene)),
            })
            .collect()
    }

    fn place(
        &mut self,
        object: &str,
        pixel: [f64; 2],
        frame: &RgbdFrame,
    ) -> Result<Option<String>, WireError> {
        let i = self.find(object)?;
        let Some(source) = &self.source else {
            return Ok(None);
        };
        // The object alone, placed in this frame: the others stay where they are.
        let mut document = source.document.clone();
        document.objects = vec![document.objects.swap_remove(i)];
        document.lights.clear();
        document.environment = None;
        let place = &mut document.objects[0].place;
        let on_surface = matches!(
            place.effective_frame(),
            PlaceFrame::Pixel | PlaceFrame::Surface
        );
        if !on_surface {
            place.translation = [0.0; 3];
        }
        place.frame = Some(PlaceFrame::Pixel);
        place.pixel = Some(pixel);
        place.picture = None;
        let surface = Sensed::new(frame);
        let options = ResolveOptions {
            place_pixel: None,
            first_frame: frame,
            surface: &surface,
        };
        let Resolved {
            scene: alone,
            standings,
            ..
        } = document
            .resolve_with(&source.folder, &options, &LoadContext::default())
            .map_err(|e| object_refused(&e))?;
        let nearest = standings.iter().any(|standing| standing.nearest);
        let placed = objects(&document, &alone, &standings).pop();
        let range = self.objects[i].instances.clone();
        let (Some(placed), true) = (placed, alone.instances.len() == range.len()) else {
            return Err(WireError::new(
                Code::Object,
                format_args!("object {object:?}"),
                "the mesh that the scene was loaded with",
                "another",
            ));
        };
        for (instance, from) in self.scene.instances[range].iter_mut().zip(&alone.instances) {
            instance.world_from_object = from.world_from_object;
        }
        self.objects[i].stand = placed.stand;
        self.turn_instances(i, self.objects[i].turned);
        Ok(nearest.then(|| NOTHING_MEASURED.to_owned()))
    }

    fn put_back(&mut self, object: &str, stands: &Stands) -> Result<(), WireError> {
        let i = self.find(object)?;
        // An object without instances is nowhere, and cannot be elsewhere.
        let Some(now) = self.objects[i].rigid(&self.scene) else {
            return Ok(());
        };
        let then = pose_of(stands)?;
        let motion = then * now.inverse();
        self.move_instances(i, motion);
        let object = &mut self.objects[i];
        object.stand = Stand {
            point: motion.transform_point3(object.stand.point),
            axis: motion.transform_vector3(object.stand.axis),
        };
        object.turned = stands.turned % std::f64::consts::TAU;
        Ok(())
    }

    fn turn(&mut self, object: &str, angle: f64) -> Result<(), WireError> {
        let i = self.find(object)?;
        if !angle.is_finite() {
            return Err(WireError::new(
                Code::Object,
                "turn, angle",
                "a finite number",
                angle,
            ));
        }
        self.turn_instances(i, angle);
        let turned = &mut self.objects[i].turned;
        // Whole turns are none; kept small, the sum stays exact and finite.
        *turned = (*turned + angle) % std::f64::consts::TAU;
        Ok(())
    }

    fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Unrendered> {
        if self.pending
            && let Some(source) = self.source.take()
        {
            self.pending = false;
            self.resolve(source, frame)?;
        }
        let rendered = self
            .renderer
            .render_while(frame, settings, aovs, checkpoint);
        rendered.map_err(unrendered)
    }

    fn render_encoded(
        &mut self,
        encoded: &dyn EncodedFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, Unrendered>), WireError> {
        if self.pending {
            // The scene is resolved with the whole frame before anything is rendered.
            let frame = encoded.whole()?;
            let rendered = self.render(&frame, settings, aovs, checkpoint);
            return Ok((frame, rendered));
        }
        let (geometry, color) = (|| encoded.geometry(), || encoded.color());
        let (frame, rendered) = self
            .renderer
            .render_decoding(geometry, color, settings, aovs, checkpoint)?;
        Ok((frame, rendered.map_err(unrendered)))
    }
}

fn unrendered(error: RenderError) -> Unrendered {
    match error {
        RenderError::Cancelled => Unrendered::Cancelled,
        other => Unrendered::Scene(WireError::new(
            Code::Scene,
            "scene",
            "one that can be rendered",
            other,
        )),
    }
}

/// Names in a client's document must be those of its own uploads: nothing else of this machine
/// can be reached.
fn check_names(document: &SceneDocument, assets: &Assets) -> Result<(), WireError> {
    let meshes = document.objects.iter().enumerate();
    let meshes = meshes.map(|(i, o)| (format!("objects[{i}].mesh"), &o.mesh));
    let map = document.environment.iter();
    let map = map.map(|e| ("environment.map".to_owned(), &e.map));
    for (field, name) in meshes.chain(map) {
        if !assets.contains_key(name) {
            return Err(WireError::new(
                Code::Scene,
                format_args!("scene, {field}"),
                format_args!("an uploaded asset, one of {:?}", assets.keys()),
                format_args!("{name:?}"),
            ));
        }
    }
    Ok(())
}

fn build(scene: &Scene, threads: usize) -> Result<Renderer, WireError> {
    Renderer::cpu(scene, threads, clock::render_clock)
        .map_err(|e| WireError::new(Code::Scene, "scene", "one that can be rendered", e))
}

/// The message names file, field, expected and got; paths of this machine are none of the
/// client's business beyond the file's name.
fn told(error: &SceneError) -> String {
    let text = error.to_string();
    text.split(' ')
        .map(|word| {
            let path = Path::new(word);
            match (path.is_absolute(), path.file_name()) {
                (true, Some(name)) => name.to_string_lossy().into_owned(),
                _ => word.to_owned(),
            }
        })
        .collect::<Vec<_>>()
        .join(" ")
}

fn refused(error: SceneError) -> WireError {
    WireError::new(
        Code::Scene,
        "scene",
        "a scene that can be used",
        told(&error),
    )
}

fn object_refused(error: &SceneError) -> WireError {
    WireError::new(
        Code::Object,
        "place, pixel",
        "a pixel with a measured surface",
        told(error),
    )
}

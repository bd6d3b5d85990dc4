//! A session's scene: its document, its uploads, the poses to which its objects were moved, and the renderer that
//! holds it.

mod refused;
mod stands;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use ghostlight_proto::control::{ObjectInfo, SceneChoice, Stands};
use ghostlight_proto::{Code, WireError};
use glam::{DAffine3, DQuat};

use self::refused::{load_refused, place_refused, refused};
use self::stands::{pose_of, stands, world_from_rigid};
use super::catalog::{Assets, EncodedFrame, SceneLoad, SceneRenderer, Unrendered};
use super::upload_folder::UploadFolder;
use crate::frame::RgbdFrame;
use crate::ghost::DepthPlanes;
use crate::memory::Budget;
use crate::render::{Aov, Checkpoint, Engine, RenderError, RenderSettings, Rendered, Renderer};
use crate::scene::{
    LoadContext, LoadError, PicturePoint, Pivot, PlacementFrame, Scene, SceneDocument, SceneError,
};

/// The note about an object that was put at a pixel without depth.
const NOTHING_MEASURED: &str = "Nothing measured there: put nearby.";

/// Where a scene on offer comes from.
#[derive(Debug, Clone)]
pub(super) enum OfferedScene {
    /// A document or mesh; read each time it is chosen, because it may have changed.
    File(PathBuf),
    /// The scene given by command-line flags, with absolute paths.
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

/// Data shared by all scenes of a session.
#[derive(Clone)]
pub(super) struct Shared {
    /// Name and source of each of the server's scenes.
    pub(super) scenes: Arc<[(String, OfferedScene)]>,
    /// Creates renderers, for all sessions.
    pub(super) engine: Engine,
    /// Most triangles stored for a scene.
    pub(super) max_triangles: usize,
    /// Memory budget of its scenes.
    pub(super) memory: Budget,
    /// Uploads as files, once there are any; removed with the session.
    pub(super) uploads: Arc<OnceLock<UploadFolder>>,
}

/// A scene and its renderer.
pub(super) struct SessionScene {
    shared: Shared,
    renderer: Renderer,
    name: Option<String>,
    /// Settings of its document.
    settings: Option<RenderSettings>,
    scene: Scene,
    /// How far each object was turned since it was placed, radians.
    turned: Vec<f64>,
    /// Holds the part of the memory budget that the fields above use; dropped after them.
    _context: LoadContext,
}

impl SessionScene {
    /// A session without a scene.
    pub(super) fn new(shared: Shared) -> Result<Self, WireError> {
        let scene = Scene::default();
        let context = LoadContext::new(shared.memory.clone(), Arc::default());
        Ok(Self {
            renderer: build(&scene, &shared, &context)?,
            shared,
            name: None,
            settings: None,
            scene,
            turned: Vec::new(),
            _context: context,
        })
    }

    fn load(&self, scene: &SceneChoice, assets: &Assets) -> Result<SceneToLoad, WireError> {
        let (name, document, files) = match scene {
            SceneChoice::Name(name) => {
                let known = self.shared.scenes.iter().find(|(known, _)| known == name);
                let Some((_, path)) = known else {
                    return Err(WireError::new(
                        Code::NotFound,
                        "scene",
                        "one of /api/v1/scenes",
                        name,
                    ));
                };
                let (document, folder) = path.load().map_err(refused)?;
                (Some(name.clone()), document, Files::Folder(folder))
            }
            SceneChoice::Document(map) => {
                let text = serde_json::to_string(map)
                    .map_err(|e| WireError::new(Code::Scene, "scene", "a document", e))?;
                let document = SceneDocument::parse(&text, "scene").map_err(refused)?;
                check_names(&document, assets)?;
                (None, document, Files::Uploads(assets.clone()))
            }
        };
        Ok(SceneToLoad {
            shared: self.shared.clone(),
            name,
            document,
            files,
        })
    }

    fn find(&self, object: &str) -> Result<usize, WireError> {
        let objects = &self.scene.objects;
        objects
            .iter()
            .position(|known| known.name == object)
            .ok_or_else(|| {
                let names: Vec<&str> = objects.iter().map(|o| o.name.as_str()).collect();
                WireError::new(
                    Code::Object,
                    "object",
                    format_args!("one of {names:?}"),
                    format_args!("{object:?}"),
                )
            })
    }

    /// Turns an object about its pivot, radians.
    fn turn_by(&mut self, i: usize, angle: f64) {
        let Pivot { point, axis } = self.scene.objects[i].pivot();
        let turn = DAffine3::from_translation(point)
            * DAffine3::from_quat(DQuat::from_axis_angle(axis, angle))
            * DAffine3::from_translation(-point);
        self.scene.move_object(i, turn);
    }

    /// Updates an object's pose in the renderer.
    fn update_renderer(&mut self, i: usize) {
        for i in self.scene.objects[i].instances.clone() {
            let world_from_object = self.scene.instances[i].world_from_object;
            self.renderer.set_transform(i, world_from_object);
        }
    }
}

impl SceneRenderer for SessionScene {
    fn begin_scene(
        &mut self,
        scene: &SceneChoice,
        assets: &Assets,
    ) -> Result<Box<dyn SceneLoad>, WireError> {
        Ok(Box::new(self.load(scene, assets)?))
    }

    fn scene_settings(&self) -> Option<RenderSettings> {
        self.settings
    }

    fn scene_name(&self) -> Option<String> {
        self.name.clone()
    }

    fn objects(&self) -> Vec<ObjectInfo> {
        let objects = self.scene.objects.iter().zip(&self.turned);
        objects
            .map(|(object, &turned)| ObjectInfo {
                name: object.name.clone(),
                stands: stands(object, &self.scene, turned),
            })
            .collect()
    }

    fn place(
        &mut self,
        object: &str,
        pixel: [f64; 2],
        frame: &RgbdFrame,
        settings: &RenderSettings,
    ) -> Result<Option<String>, WireError> {
        let i = self.find(object)?;
        let surface = DepthPlanes::new(&frame.depth, &frame.intrinsics, &settings.ghost);
        let frame = PlacementFrame {
            frame,
            surface: &surface,
        };
        let placed = self.scene.objects[i]
            .at(PicturePoint::Pixel(pixel), &frame)
            .map_err(place_refused)?;
        self.scene.put(i, &placed);
        self.turn_by(i, self.turned[i]);
        self.update_renderer(i);
        Ok(placed.nearest_px.map(|_| NOTHING_MEASURED.to_owned()))
    }

    fn put_back(&mut self, object: &str, stands: &Stands) -> Result<(), WireError> {
        let i = self.find(object)?;
        // An object without instances has no pose to restore.
        let Some(now) = world_from_rigid(&self.scene.objects[i], &self.scene) else {
            return Ok(());
        };
        let then = pose_of(stands)?;
        self.scene.move_object(i, then * now.inverse());
        self.turned[i] = stands.turned % std::f64::consts::TAU;
        self.update_renderer(i);
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
        self.turn_by(i, angle);
        self.update_renderer(i);
        // Whole turns are removed, so that the sum stays exact and finite.
        self.turned[i] = (self.turned[i] + angle) % std::f64::consts::TAU;
        Ok(())
    }

    fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Unrendered> {
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

/// Checks that a client's document refers only to the client's own uploads: it must not reach other files of this
/// machine.
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

/// Where a scene's files are.
enum Files {
    /// A folder of the server.
    Folder(PathBuf),
    /// Uploads, to be written to a folder first.
    Uploads(Assets),
}

/// A scene whose document is valid, as far as it can be checked without its files.
struct SceneToLoad {
    shared: Shared,
    name: Option<String>,
    document: SceneDocument,
    files: Files,
}

impl SceneToLoad {
    /// The folder with its files; uploads are written to it first.
    fn folder(&self) -> Result<PathBuf, WireError> {
        let assets = match &self.files {
            Files::Folder(folder) => return Ok(folder.clone()),
            Files::Uploads(assets) => assets,
        };
        let failed =
            |e: std::io::Error| WireError::new(Code::Internal, "asset", "room for it on disk", e);
        let uploads = match self.shared.uploads.get() {
            Some(uploads) => uploads,
            None => {
                let new = UploadFolder::new().map_err(failed)?;
                self.shared.uploads.get_or_init(|| new)
            }
        };
        uploads.write(assets).map_err(failed)
    }
}

impl SceneLoad for SceneToLoad {
    fn name(&self) -> Option<String> {
        self.name.clone()
    }

    fn objects(&self) -> Vec<ObjectInfo> {
        let info = |object| ObjectInfo {
            name: SceneDocument::name_of(object),
            stands: None,
        };
        self.document.objects.iter().map(info).collect()
    }

    fn settings(&self) -> Option<RenderSettings> {
        self.document.settings
    }

    fn run(
        self: Box<Self>,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn SceneRenderer>, WireError> {
        let folder = self.folder()?;
        let Self {
            shared,
            name,
            document,
            ..
        } = *self;
        let context = LoadContext::new(shared.memory.clone(), Arc::clone(stop))
            .with_max_triangles(shared.max_triangles);
        let surface = DepthPlanes::new(&frame.depth, &frame.intrinsics, &settings.ghost);
        let frame = PlacementFrame {
            frame,
            surface: &surface,
        };
        let resolve = || document.resolve_with(&folder, &frame, &context);
        let (scene, notes) = shared
            .engine
            .load(resolve)
            .map_err(unready)?
            .map_err(refused)?;
        let renderer = build(&scene, &shared, &context)?;
        for note in notes.iter().chain(renderer.notes()) {
            tracing::info!(note, "scene");
        }
        Ok(Box::new(SessionScene {
            shared,
            renderer,
            name,
            settings: document.settings,
            turned: vec![0.0; scene.objects.len()],
            scene,
            _context: context,
        }))
    }
}

/// A checkpoint that continues until the load is cancelled.
struct WhileWanted<'a>(&'a LoadContext);

impl Checkpoint for WhileWanted<'_> {
    fn go_on(&self) -> bool {
        !self.0.is_cancelled()
    }
}

fn unready(error: RenderError) -> WireError {
    WireError::new(Code::Scene, "scene", "one that can be rendered", error)
}

/// Builds a renderer for a scene; its memory is taken from the context's budget.
fn build(scene: &Scene, shared: &Shared, context: &LoadContext) -> Result<Renderer, WireError> {
    let over = |error: LoadError| load_refused(&error);
    let mut building = context.scratch("trees and coarser meshes, while they are built");
    building
        .hold(Renderer::building_bytes(scene))
        .map_err(over)?;
    let checkpoint = WhileWanted(context);
    let renderer = shared
        .engine
        .renderer_while(scene, &checkpoint)
        .map_err(unready)?;
    drop(building);
    context
        .keep(renderer.memory(), "trees and coarser meshes")
        .map_err(over)?;
    Ok(renderer)
}

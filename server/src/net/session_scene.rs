//! A session's scene: its document, its uploads, where its objects were put since, and the
//! renderer that holds it.

mod refused;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use ghostlight_proto::control::{ObjectInfo, SceneChoice, Stands};
use ghostlight_proto::{Code, WireError};
use glam::{DAffine3, DQuat};

use self::refused::{load_refused, object_refused, refused};
use super::backend::{Assets, EncodedFrame, SceneLoad, SceneRenderer, Unrendered};
use super::clock;
use super::scene_stand::{Object, Sensed, Stand, objects, pose_of};
use super::upload_folder::UploadFolder;
use crate::frame::RgbdFrame;
use crate::memory::Budget;
use crate::render::{Aov, Checkpoint, RenderError, RenderSettings, Rendered, Renderer};
use crate::scene::{
    LoadContext, LoadError, PlaceFrame, ResolveOptions, Resolved, Scene, SceneDocument, SceneError,
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

/// What a session's scenes have in common, one after the other.
#[derive(Clone)]
pub(super) struct Shared {
    /// Name and file of each scene of the server's.
    pub(super) scenes: Arc<[(String, OfferedScene)]>,
    /// Render threads; 0: one per core.
    pub(super) threads: usize,
    /// Most triangles stored.
    pub(super) max_triangles: usize,
    /// What scenes are taken from.
    pub(super) memory: Budget,
    /// Uploads as files, once there are any; gone with the session.
    pub(super) uploads: Arc<OnceLock<UploadFolder>>,
}

/// A scene and its renderer.
pub(super) struct SessionScene {
    shared: Shared,
    renderer: Renderer,
    source: Option<Source>,
    /// Objects of the resolved scene, as the document has them.
    objects: Vec<Object>,
    scene: Scene,
    /// What the above take of the budget: dropped after them. Keeps the mesh files that were read, too.
    context: Arc<LoadContext>,
}

impl SessionScene {
    /// Without a scene.
    pub(super) fn new(shared: Shared) -> Result<Self, WireError> {
        let scene = Scene::default();
        let context = Arc::new(LoadContext::new(shared.memory.clone(), Arc::default()));
        Ok(Self {
            renderer: build(&scene, &shared, &context)?,
            shared,
            source: None,
            objects: Vec::new(),
            scene,
            context,
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
        let names: Vec<String> = self.objects().into_iter().map(|o| o.name).collect();
        match names.iter().position(|name| name == object) {
            Some(i) => Ok(i),
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

impl SceneRenderer for SessionScene {
    fn begin_scene(
        &mut self,
        scene: &SceneChoice,
        assets: &Assets,
    ) -> Result<Box<dyn SceneLoad>, WireError> {
        Ok(Box::new(self.load(scene, assets)?))
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
            .resolve_with(&source.folder, &options, &self.context)
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

/// Where a scene's files are.
enum Files {
    /// A folder of the server's.
    Folder(PathBuf),
    /// Uploads, to be written first.
    Uploads(Assets),
}

/// A scene whose document is good as far as can be told without its files.
struct SceneToLoad {
    shared: Shared,
    name: Option<String>,
    document: SceneDocument,
    files: Files,
}

impl SceneToLoad {
    /// Where its files are; uploads are written there if they are not yet.
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

    fn run(
        self: Box<Self>,
        frame: &RgbdFrame,
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
        let context = Arc::new(context);
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
        } = document
            .resolve_with(&folder, &options, &context)
            .map_err(refused)?;
        let renderer = build(&scene, &shared, &context)?;
        for note in notes.iter().chain(renderer.notes()) {
            tracing::info!(note, "scene");
        }
        Ok(Box::new(SessionScene {
            shared,
            renderer,
            objects: objects(&document, &scene, &standings),
            source: Some(Source {
                name,
                document,
                folder,
            }),
            scene,
            context,
        }))
    }
}

/// Goes on while the scene is wanted.
struct WhileWanted<'a>(&'a LoadContext);

impl Checkpoint for WhileWanted<'_> {
    fn go_on(&self) -> bool {
        !self.0.is_cancelled()
    }
}

/// A renderer of a scene; what it holds is taken from the context's budget.
fn build(scene: &Scene, shared: &Shared, context: &LoadContext) -> Result<Renderer, WireError> {
    let over = |error: LoadError| load_refused(&error);
    let mut building = context.scratch("trees and coarser meshes, while they are built");
    building
        .hold(Renderer::building_bytes(scene))
        .map_err(over)?;
    let checkpoint = WhileWanted(context);
    let renderer = Renderer::cpu_while(scene, shared.threads, clock::render_clock, &checkpoint)
        .map_err(|e| WireError::new(Code::Scene, "scene", "one that can be rendered", e))?;
    drop(building);
    context
        .keep(renderer.memory(), "trees and coarser meshes")
        .map_err(over)?;
    Ok(renderer)
}

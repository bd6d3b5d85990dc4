//! Virtual content of the camera's world: meshes, materials, lights, environment.
//!
//! A [`Scene`] is resolved: every file is loaded, every placement is a world transform.
//! It is immutable while frames are rendered with it.

mod check;

mod document;
mod draco;
mod environment;
mod environment_spec;
mod error;
mod file;
mod gltf;
mod inside;
mod inspect;
mod key_light;
mod light;
mod load;
mod material;
mod median_cut;
mod mesh;
mod mesh_file;
mod model;
mod mtl;
mod normals;
mod obj;
mod object;
mod object_flags;
mod odd;
mod openexr;
mod parts;
mod picture_cache;
mod place;
mod ply;
mod polygons;
mod preset;
mod radiance;
mod read;
mod resolve;
mod sanitise;
mod simplify;
mod spot;
#[cfg(test)]
pub(crate) mod test_data;
mod texture;
mod texture_file;
mod triple;

pub use document::{
    LightFrame, LightKind, LightSpec, Marker, MaterialSpec, Object, PicturePoint, PlaceFrame,
    Placement, Preset, SceneDocument, UpAxis,
};
pub use environment::Harmonics;
pub(crate) use environment::basis;
pub use environment_spec::EnvironmentSpec;
pub use error::{LoadError, MeshError, SceneError};
pub use inspect::{ObjectInspection, SceneInspection, inspect_scene};
pub use light::{Environment, Light};
pub use load::{LoadContext, Scratch};
pub use material::{AlphaMode, Material};
pub use median_cut::EnvironmentLights;
pub use mesh::Mesh;
pub use mesh_file::{is_mesh, load_meshes};
pub use model::{MAX_FILE_BYTES, MAX_TRIANGLES};
pub use normals::CREASE_ANGLE_DEG;
pub use object::{Pivot, SceneObject};
pub use object_flags::ObjectFlags;
pub use place::{PlaceError, Placed, PlacementFrame, Surface};
pub use resolve::{FIT_SIZE_M, PLAUSIBLE_M};
pub use sanitise::{MAX_COORDINATE, SanitiseReport, sanitise};
pub(crate) use simplify::{coarser, takes_forever};
pub use spot::LOWER_MIDDLE;
pub use texture::{Footprint, Reading, Texture, Wrap};
pub use triple::Triple;

use std::sync::Arc;

use glam::DAffine3;

/// One placed mesh.
#[derive(Debug, Clone)]
pub struct Instance {
    /// Name of the object in the scene document, for messages.
    pub name: String,
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// Object space to world, metres; may mirror and scale non-uniformly.
    pub world_from_object: DAffine3,
    /// A model of a real object: it occludes and is shaded by secondary rays, but primary rays that hit it show the
    /// camera's pixel.
    pub ghost: bool,
}

/// All virtual content and all modelled ghosts of a recording.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    /// Shared geometry.
    pub meshes: Vec<Arc<Mesh>>,
    /// Shared materials.
    pub materials: Vec<Material>,
    /// Placed meshes.
    pub instances: Vec<Instance>,
    /// The objects of the document, in document order; they can be moved. Instances that belong to no object do not
    /// move.
    pub objects: Vec<SceneObject>,
    /// Lights; if there are none, the renderer estimates a key light and notes it.
    pub lights: Vec<Light>,
    /// Radiance from outside; `None` means that it is estimated from the camera's picture.
    pub environment: Option<Environment>,
}

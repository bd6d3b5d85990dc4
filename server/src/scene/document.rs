//! The scene document: what a person writes in JSON. Unknown fields are errors.
//!
//! [`SceneDocument::load`] reads and checks one; `resolve` turns it into a runtime scene. The
//! JSON Schema (`ghostlight schema scene`) comes from these types and their comments.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::environment_spec::EnvironmentSpec;
use super::triple::Triple;
use crate::json::SchemaLink;
use crate::render::RenderSettings;

/// A whole scene document, version 1.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Ghostlight scene")]
pub struct SceneDocument {
    /// Where this document's JSON Schema lies, for editors; ignored.
    #[serde(rename = "$schema", default, skip_serializing)]
    pub schema: SchemaLink,
    /// Version of this format: 1.
    #[schemars(range(min = 1, max = 1))]
    pub version: u32,
    /// Things that are added, or modelled ghosts of real ones.
    #[serde(default)]
    #[schemars(length(max = 10_000))]
    pub objects: Vec<Object>,
    /// Lights; without any, an environment map gives them, or the renderer estimates one.
    #[serde(default)]
    #[schemars(length(max = 1_000))]
    pub lights: Vec<LightSpec>,
    /// Radiance from outside the sensed scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<EnvironmentSpec>,
    /// Render settings that suit this scene; `--settings` and what a client sets win over them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<RenderSettings>,
    /// The file it came from, for messages.
    #[serde(skip)]
    pub file: String,
    /// What to tell its author, one sentence each.
    #[serde(skip)]
    pub notes: Vec<String>,
}

/// One object.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// For messages; the mesh's file name by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Mesh file (.obj, .ply, .glb, .gltf), relative to the document.
    pub mesh: String,
    /// Which axis of the mesh points up; y by default.
    #[serde(default, skip_serializing_if = "UpAxis::is_default")]
    pub up: UpAxis,
    /// Where it is.
    #[serde(default)]
    pub place: Placement,
    /// What it is made of; by default what the mesh file says, else matte.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<MaterialSpec>,
    /// A model of something real: it occludes and is reflected, but shows the camera's pixels.
    #[serde(default)]
    pub ghost: bool,
    /// Fiducial marker that the object follows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marker: Option<Marker>,
    /// Its mesh was named without a document: a size that no room has is then brought to
    /// [`FIT_SIZE_M`](super::FIT_SIZE_M).
    #[serde(skip)]
    pub bare: bool,
}

impl Object {
    /// A mesh that was named without a document: on a level surface in the lower middle of the
    /// picture, made of what its file says.
    pub fn of_mesh(mesh: String) -> Self {
        Self {
            name: None,
            mesh,
            up: UpAxis::Y,
            place: Placement {
                frame: Some(PlaceFrame::Surface),
                ..Placement::default()
            },
            material: None,
            ghost: false,
            marker: None,
            bare: true,
        }
    }
}

/// The axis of a mesh that points up. Its front is +z for `y` (glTF), -y for `z`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UpAxis {
    /// y up, front +z.
    #[default]
    Y,
    /// z up, front -y.
    Z,
}

impl UpAxis {
    fn is_default(&self) -> bool {
        *self == Self::Y
    }
}

/// What a placement is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlaceFrame {
    /// The recording's world axes.
    World,
    /// The first frame's camera: x right, y down, z forward. The object stands upright in its
    /// view, front towards it, before `rotation`.
    FirstCamera,
    /// The real surface seen at `pixel` (or `picture`) of the first frame: x right, y up (the
    /// surface's normal), z towards the viewer, origin on the surface. Where nothing was measured,
    /// the nearest place where something was, with a note.
    Pixel,
    /// Axes as for `pixel`, on the level surface nearest to `picture` that has room for the object.
    /// Objects of this frame that cannot all stand level and apart where they are put keep their
    /// arrangement and move together. Without a level surface: the nearest place with room.
    Surface,
}

/// A point of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PicturePoint {
    /// Pixel (u, v); pixel centres are whole numbers.
    Pixel([f64; 2]),
    /// Shares of width and height from the upper left corner, 0..=1.
    Share([f64; 2]),
}

/// Where an object is. The mesh is scaled, turned by `rotation` about its own upright axes,
/// stood into the frame, then moved by `translation` along the frame's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Placement {
    /// What it is relative to; `pixel` by default if `pixel` or `picture` is given, else `world`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<PlaceFrame>,
    /// Metres along the frame's axes.
    #[schemars(inner(range(min = -1e9, max = 1e9)))]
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w.
    #[schemars(inner(range(min = -1.01, max = 1.01)))]
    pub rotation: [f64; 4],
    /// Metres per unit of the mesh: one number or one per axis of the mesh; 1 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<Triple>,
    /// Instead of `scale`: the mesh's largest extent along its axes, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub size_m: Option<f64>,
    /// Pixel (u, v) of the first frame; pixel centres are whole numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = -0.5, max = 1e5)))]
    pub pixel: Option<[f64; 2]>,
    /// Instead of `pixel`: shares of the first frame's width and height, 0..=1 from its upper left
    /// corner, so that it fits recordings of any size. [0.5, 0.65] by default for `surface`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0.0, max = 1.0)))]
    pub picture: Option<[f64; 2]>,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            frame: None,
            translation: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            scale: None,
            size_m: None,
            pixel: None,
            picture: None,
        }
    }
}

impl Placement {
    /// The frame meant: as given, else `pixel` if there is a pixel, else `world`.
    pub fn effective_frame(&self) -> PlaceFrame {
        let on_picture = self.pixel.is_some() || self.picture.is_some();
        self.frame.unwrap_or(if on_picture {
            PlaceFrame::Pixel
        } else {
            PlaceFrame::World
        })
    }

    /// The same size and rotation, stood on the real surface at a point of the picture. A
    /// translation is kept only if it was along a surface's axes before.
    #[must_use]
    pub fn on_surface_at(&self, point: PicturePoint) -> Self {
        let (pixel, picture) = match point {
            PicturePoint::Pixel(pixel) => (Some(pixel), None),
            PicturePoint::Share(share) => (None, Some(share)),
        };
        let translation = match self.effective_frame() {
            PlaceFrame::Pixel | PlaceFrame::Surface => self.translation,
            PlaceFrame::World | PlaceFrame::FirstCamera => [0.0; 3],
        };
        Self {
            frame: Some(PlaceFrame::Pixel),
            translation,
            pixel,
            picture,
            ..self.clone()
        }
    }

    /// The pixel meant, of a frame of this size, if one is given.
    pub fn effective_pixel(&self, width: u32, height: u32) -> Option<[f64; 2]> {
        let of = |share: f64, n: u32| {
            let n = f64::from(n);
            (share * n - 0.5).clamp(0.0, (n - 1.0).max(0.0))
        };
        let of_picture = self.picture.map(|[x, y]| [of(x, width), of(y, height)]);
        self.pixel.or(of_picture)
    }
}

/// Ready-made materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Mid-grey, diffuse.
    Matte,
    /// Diffuse under a clear, fairly smooth coat.
    Plastic,
    /// Grey metal with a blurred reflection.
    BrushedMetal,
    /// A perfect mirror.
    Mirror,
    /// Clear window glass, refracting as a solid.
    Glass,
    /// Polished gold.
    Gold,
    /// Polished copper.
    Copper,
    /// Polished chrome.
    Chrome,
}

/// A material: a preset and what differs from it, or glTF's terms. Without a preset the
/// fields override what the mesh file says (its textures keep multiplying), or matte.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialSpec {
    /// Where to start; replaces the file's own material, textures included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<Preset>,
    /// Linear RGB, 0..=1: albedo, or reflectance of a metal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_color: Option<Triple>,
    /// 0 dielectric to 1 metal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub metallic: Option<f64>,
    /// Perceptual roughness, 0 (mirror) to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub roughness: Option<f64>,
    /// Share of entering light that is refracted, 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub transmission: Option<f64>,
    /// Index of refraction, 1..=5.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 5.0))]
    pub ior: Option<f64>,
    /// A thin sheet rather than a solid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thin: Option<bool>,
    /// Emitted linear radiance, 0..=1e6.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub emissive: Option<Triple>,
    /// Colour of white light after `attenuation_distance_m` inside, 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attenuation_color: Option<Triple>,
    /// Metres, > 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub attenuation_distance_m: Option<f64>,
}

/// A fiducial marker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Which dictionary, as in `tag36h11`.
    pub family: String,
    /// Which marker of it.
    pub id: u32,
    /// Side of the black square, metres.
    #[schemars(range(min = 1e-3, max = 10.0))]
    pub size_m: f64,
}

/// Kinds of light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightKind {
    /// A ball that shines evenly.
    Sphere,
    /// Parallel light from far away.
    Directional,
}

/// What a light is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightFrame {
    /// The recording's world axes.
    World,
    /// The first frame's camera: x right, y down, z forward.
    #[default]
    FirstCamera,
}

/// A light. One flat record, so that an error can name the field that is out of place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightSpec {
    /// Which kind.
    #[serde(rename = "type")]
    pub kind: LightKind,
    /// Axes of `position` or `direction`; the first camera's by default.
    #[serde(default)]
    pub frame: LightFrame,
    /// Sphere: centre, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// Sphere: metres; 0.05 by default, 0 casts hard shadows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e4))]
    pub radius: Option<f64>,
    /// Sphere: radiant intensity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intensity: Option<Triple>,
    /// Directional: the way the light travels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Directional: irradiance on a surface that faces it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub irradiance: Option<Triple>,
    /// Directional: half the angle the source fills, degrees; the sun's 0.27 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 90.0))]
    pub angular_radius_deg: Option<f64>,
}

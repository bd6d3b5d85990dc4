//! The scene document: what a person writes in JSON. Unknown fields are errors.
//!
//! [`SceneDocument::load`] reads and checks one; `resolve` turns it into a runtime scene.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::error::SceneError;
use super::file;
use crate::{json, text};

/// A whole scene document, version 1.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneDocument {
    /// Version of this format: 1.
    pub version: u32,
    /// Things that are added, or modelled ghosts of real ones.
    #[serde(default)]
    pub objects: Vec<Object>,
    /// Lights; without any, an environment map gives them, or the renderer estimates one.
    #[serde(default)]
    pub lights: Vec<LightSpec>,
    /// Radiance from outside the sensed scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<EnvironmentSpec>,
    /// The file it came from, for messages.
    #[serde(skip)]
    pub file: String,
}

/// One object.
#[derive(Debug, Clone, Serialize, Deserialize)]
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
}

/// The axis of a mesh that points up. Its front is +z for `y` (glTF), -y for `z`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlaceFrame {
    /// The recording's world axes.
    World,
    /// The first frame's camera: x right, y down, z forward. The object stands upright in its
    /// view, front towards it, before `rotation`.
    FirstCamera,
    /// The real surface seen at `pixel` of the first frame: x right, y up (the surface's
    /// normal), z towards the viewer, origin on the surface.
    Pixel,
}

/// Where an object is. The mesh is scaled, turned by `rotation` about its own upright axes,
/// stood into the frame, then moved by `translation` along the frame's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Placement {
    /// What it is relative to; `pixel` by default if a pixel is given, else `world`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<PlaceFrame>,
    /// Metres along the frame's axes.
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// Metres per unit of the mesh: one number or one per axis of the mesh; 1 by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<Triple>,
    /// Instead of `scale`: the mesh's largest extent along its axes, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_m: Option<f64>,
    /// Pixel (u, v) of the first frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel: Option<[f64; 2]>,
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
        }
    }
}

impl Placement {
    /// The frame meant: as given, else `pixel` if there is a pixel, else `world`.
    pub fn effective_frame(&self) -> PlaceFrame {
        self.frame.unwrap_or(if self.pixel.is_some() {
            PlaceFrame::Pixel
        } else {
            PlaceFrame::World
        })
    }
}

/// Three numbers, written as three or as one that stands for all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triple(pub [f64; 3]);

impl Serialize for Triple {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let [x, y, z] = self.0;
        if x == y && y == z {
            serializer.serialize_f64(x)
        } else {
            self.0.serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for Triple {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct OneOrThree;
        impl<'de> Visitor<'de> for OneOrThree {
            type Value = Triple;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or an array of 3 numbers")
            }
            fn visit_f64<E: de::Error>(self, x: f64) -> Result<Triple, E> {
                Ok(Triple([x; 3]))
            }
            fn visit_i64<E: de::Error>(self, x: i64) -> Result<Triple, E> {
                Ok(Triple([x as f64; 3]))
            }
            fn visit_u64<E: de::Error>(self, x: u64) -> Result<Triple, E> {
                Ok(Triple([x as f64; 3]))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Triple, A::Error> {
                let mut xyz = [0.0; 3];
                for (i, x) in xyz.iter_mut().enumerate() {
                    *x = seq
                        .next_element()?
                        .ok_or_else(|| de::Error::invalid_length(i, &self))?;
                }
                match seq.next_element::<de::IgnoredAny>()? {
                    None => Ok(Triple(xyz)),
                    Some(_) => Err(de::Error::invalid_length(4, &self)),
                }
            }
        }
        deserializer.deserialize_any(OneOrThree)
    }
}

/// Ready-made materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
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
    pub metallic: Option<f64>,
    /// Perceptual roughness, 0 (mirror) to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<f64>,
    /// Share of entering light that is refracted, 0..=1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transmission: Option<f64>,
    /// Index of refraction, 1..=5.
    #[serde(skip_serializing_if = "Option::is_none")]
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
    pub attenuation_distance_m: Option<f64>,
}

/// A fiducial marker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Which dictionary, as in `tag36h11`.
    pub family: String,
    /// Which marker of it.
    pub id: u32,
    /// Side of the black square, metres.
    pub size_m: f64,
}

/// Kinds of light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightKind {
    /// A ball that shines evenly.
    Sphere,
    /// Parallel light from far away.
    Directional,
}

/// What a light is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightFrame {
    /// The recording's world axes.
    World,
    /// The first frame's camera: x right, y down, z forward.
    #[default]
    FirstCamera,
}

/// A light. One flat record, so that an error can name the field that is out of place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    pub angular_radius_deg: Option<f64>,
}

/// An equirectangular environment map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentSpec {
    /// Radiance .hdr or OpenEXR file, relative to the document.
    pub map: String,
    /// Multiplies the map.
    #[serde(default = "one")]
    pub intensity: f64,
    /// Where the map's up points, in the first camera's axes. By default the normal of the
    /// first surface that an object was placed on, if within 60 degrees of the camera's own
    /// up, else the camera's own up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Turns the map about its up, degrees; at 0 its middle column lies ahead of the camera.
    #[serde(default)]
    pub rotation_deg: f64,
}

fn one() -> f64 {
    1.0
}

/// Enough of a document to see which version it is, before newer fields confuse matters.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

impl SceneDocument {
    /// Most objects of one document.
    pub const MAX_OBJECTS: usize = 10_000;
    /// Most lights of one document.
    pub const MAX_LIGHTS: usize = 1_000;
    /// Largest document, bytes.
    pub const MAX_BYTES: u64 = 32 << 20;

    /// Reads and checks a document. Also returns the folder that its paths are relative to.
    pub fn load(path: &Path) -> Result<(Self, PathBuf), SceneError> {
        let file = path.display().to_string();
        let bytes = file::read(path, Self::MAX_BYTES).map_err(|reason| SceneError::File {
            file: file.clone(),
            reason,
        })?;
        let document = Self::parse(&text::decode(&bytes).text, &file)?;
        let base = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok((document, base))
    }

    /// Reads and checks the text of a document; `file` is for messages.
    pub fn parse(text: &str, file: &str) -> Result<Self, SceneError> {
        let Version { version } = json::from_str(text, file)?;
        if version != 1 {
            return Err(SceneError::Field {
                file: file.to_owned(),
                path: "version".to_owned(),
                problem: format!("expected 1, got {version}"),
            });
        }
        let mut document: Self = json::from_str(text, file)?;
        document.file = file.to_owned();
        document.check()?;
        Ok(document)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_document_reads_back() {
        let text = "{\"version\": 1, \"objects\": [{\"mesh\": \"brick.obj\", \"place\": {\"pixel\": [60, 50], \"scale\": [1, 2, 3]}, \"material\": {\"preset\": \"gold\", \"emissive\": 2}}]}";
        let document = SceneDocument::parse(text, "a").unwrap();
        let written = serde_json::to_string(&document).unwrap();
        let again = SceneDocument::parse(&written, "b").unwrap();
        assert_eq!(serde_json::to_string(&again).unwrap(), written);
        let spec = MaterialSpec {
            preset: Some(Preset::Gold),
            emissive: Some(Triple([2.0; 3])),
            ..MaterialSpec::default()
        };
        assert_eq!(again.objects[0].material, Some(spec));
    }
}

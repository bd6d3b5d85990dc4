//! Writes the files of a recording: TUM's layout and a manifest.

use std::path::Path as FilePath;

use serde::Serialize;

use super::light::RoomLight;
use super::render::EXPOSURE;
use super::texture::Pattern;
use super::{SynthError, SynthOptions, sensor};
use ghostlight::camera::Intrinsics;
use ghostlight::codec::png::{self, Effort};
use ghostlight::codec::{CodecError, jpeg};
use glam::{Vec2, Vec3};

/// Quality of the colour images, 1..=100.
const JPEG_QUALITY: u8 = 86;

/// Time of the first frame, nanoseconds since 1970: TUM's stamps are Unix times, and loaders expect ten digits
/// before the decimal point.
pub(super) const START_NS: i64 = 1_700_000_000_000_000_000;

/// Writes an 8-bit sRGB JPEG.
pub(super) fn write_color(
    path: &FilePath,
    width: u32,
    height: u32,
    rgb: &[[u8; 3]],
) -> Result<(), SynthError> {
    let bytes = jpeg::encode_rgb8(width, height, rgb.as_flattened(), JPEG_QUALITY);
    write_encoded(path, bytes)
}

/// Writes a 16-bit PNG with the best compression.
pub(super) fn write_depth(
    path: &FilePath,
    width: u32,
    height: u32,
    units: &[u16],
) -> Result<(), SynthError> {
    let bytes = png::encode_gray16(width, height, units, Effort::Smallest);
    write_encoded(path, bytes)
}

fn write_encoded(path: &FilePath, bytes: Result<Vec<u8>, CodecError>) -> Result<(), SynthError> {
    let bytes = bytes.map_err(|source| SynthError::image(path, source))?;
    std::fs::write(path, bytes).map_err(|source| SynthError::io(path, source))
}

/// Writes text.
pub(super) fn write_text(path: &FilePath, text: &str) -> Result<(), SynthError> {
    std::fs::write(path, text).map_err(|source| SynthError::io(path, source))
}

#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum ManifestLight {
    Sphere {
        name: &'static str,
        frame: &'static str,
        position: [f64; 3],
        radius: f64,
        intensity: [f32; 3],
    },
    Rectangle {
        name: &'static str,
        frame: &'static str,
        corner: [f64; 3],
        edges: [[f64; 3]; 2],
        mean_radiance: [f32; 3],
    },
}

#[derive(Serialize)]
struct Place {
    pixel: [u32; 2],
    size_m: f64,
}

#[derive(Serialize)]
struct Manifest {
    generator: &'static str,
    version: &'static str,
    seed: u32,
    frames: u32,
    rate_hz: f64,
    intrinsics: Intrinsics,
    depth_units_per_metre: f64,
    depth_range_m: [f64; 2],
    licence: &'static str,
    world: &'static str,
    light_units: &'static str,
    exposure: f32,
    lights: Vec<ManifestLight>,
    place: Place,
}

/// Mean colour of a pattern.
fn mean_colour(pattern: &Pattern) -> Vec3 {
    const SIDE: u32 = 64;
    let sum = (0..SIDE * SIDE).fold(Vec3::ZERO, |sum, i| {
        let uv = Vec2::new((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5) / SIDE as f32;
        sum + pattern.colour(uv, uv)
    });
    sum / (SIDE * SIDE) as f32
}

/// The manifest as JSON.
pub(super) fn manifest(
    options: &SynthOptions,
    intrinsics: &Intrinsics,
    lights: &[RoomLight],
    place_px: [u32; 2],
) -> Result<String, SynthError> {
    let lights = lights
        .iter()
        .map(|light| match *light {
            RoomLight::Sphere {
                name,
                centre,
                radius,
                intensity,
                ..
            } => ManifestLight::Sphere {
                name,
                frame: "world",
                position: centre.to_array(),
                radius,
                intensity: (intensity * EXPOSURE).to_array(),
            },
            RoomLight::Rectangle {
                name,
                origin,
                e1,
                e2,
                radiance,
                pattern,
            } => ManifestLight::Rectangle {
                name,
                frame: "world",
                corner: origin.to_array(),
                edges: [e1.to_array(), e2.to_array()],
                mean_radiance: (radiance * mean_colour(&pattern) * EXPOSURE).to_array(),
            },
        })
        .collect();
    let manifest = Manifest {
        generator: "ghostlight synth",
        version: env!("CARGO_PKG_VERSION"),
        seed: options.seed,
        frames: options.frames,
        rate_hz: options.rate_hz,
        intrinsics: *intrinsics,
        depth_units_per_metre: sensor::UNITS_PER_METRE,
        depth_range_m: [sensor::RANGE_M.start, sensor::RANGE_M.end],
        licence: "CC0-1.0",
        world: "x right along the desk, y away from the viewer, z up; metres",
        light_units: "linear pixel values: radiance W/(m2 sr) and intensity W/sr, times exposure",
        exposure: EXPOSURE,
        lights,
        place: Place {
            pixel: place_px,
            size_m: 0.24,
        },
    };
    serde_json::to_string_pretty(&manifest)
        .map(|text| text + "\n")
        .map_err(|source| SynthError::Manifest(source.to_string()))
}

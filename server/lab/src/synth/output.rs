//! The recording as files: TUM's layout and a manifest.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path as FilePath;

use image::ExtendedColorType;
use image::ImageEncoder as _;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use serde::Serialize;

use super::light::RoomLight;
use super::render::EXPOSURE;
use super::texture::Pattern;
use super::{SynthError, SynthOptions, sensor};
use ghostlight::camera::{Intrinsics, Pose};
use glam::{Vec2, Vec3};

/// Quality of the colour images, 1..=100.
const JPEG_QUALITY: u8 = 86;

/// Nanoseconds since 1970 of the first frame: TUM's stamps are Unix times, loaders expect
/// ten digits before the point.
pub(super) const START_NS: i64 = 1_700_000_000_000_000_000;

/// A time stamp as TUM writes it: seconds with six decimals.
pub(super) fn stamp(time_ns: i64) -> String {
    format!(
        "{}.{:06}",
        time_ns / 1_000_000_000,
        time_ns % 1_000_000_000 / 1_000
    )
}

fn create(path: &FilePath) -> Result<BufWriter<File>, SynthError> {
    File::create(path)
        .map(BufWriter::new)
        .map_err(|source| SynthError::io(path, source))
}

/// Writes an 8-bit sRGB JPEG.
pub(super) fn write_color(
    path: &FilePath,
    width: u32,
    height: u32,
    rgb: &[[u8; 3]],
) -> Result<(), SynthError> {
    let mut file = create(path)?;
    JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY)
        .encode(rgb.as_flattened(), width, height, ExtendedColorType::Rgb8)
        .map_err(|source| SynthError::image(path, source))?;
    file.flush().map_err(|source| SynthError::io(path, source))
}

/// Writes a 16-bit PNG with whichever row filter comes out smallest: on quantised depth the
/// usual heuristic is far from it.
pub(super) fn write_depth(
    path: &FilePath,
    width: u32,
    height: u32,
    units: &[u16],
) -> Result<(), SynthError> {
    let filters = [
        FilterType::NoFilter,
        FilterType::Sub,
        FilterType::Up,
        FilterType::Avg,
        FilterType::Paeth,
        FilterType::Adaptive,
    ];
    let mut smallest: Option<Vec<u8>> = None;
    for filter in filters {
        let mut bytes = Vec::new();
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, filter)
            .write_image(
                bytemuck::cast_slice(units),
                width,
                height,
                ExtendedColorType::L16,
            )
            .map_err(|source| SynthError::image(path, source))?;
        if smallest
            .as_ref()
            .is_none_or(|best| bytes.len() < best.len())
        {
            smallest = Some(bytes);
        }
    }
    std::fs::write(path, smallest.unwrap_or_default())
        .map_err(|source| SynthError::io(path, source))
}

/// Writes text.
pub(super) fn write_text(path: &FilePath, text: &str) -> Result<(), SynthError> {
    std::fs::write(path, text).map_err(|source| SynthError::io(path, source))
}

/// `rgb.txt`, `depth.txt` and the like.
pub(super) fn image_list(title: &str, folder: &str, extension: &str, times_ns: &[i64]) -> String {
    let mut text = format!("# {title}\n# timestamp filename\n");
    for &time in times_ns {
        let stamp = stamp(time);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{stamp} {folder}/{stamp}.{extension}");
    }
    text
}

/// `groundtruth.txt`.
pub(super) fn trajectory(poses: &[(i64, Pose)]) -> String {
    let mut text = String::from(
        "# ground truth trajectory, world from camera\n# timestamp tx ty tz qx qy qz qw\n",
    );
    for (time, pose) in poses {
        let (t, q) = (pose.translation, pose.rotation);
        let _ = writeln!(
            text,
            "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            stamp(*time),
            t.x,
            t.y,
            t.z,
            q.x,
            q.y,
            q.z,
            q.w
        );
    }
    text
}

#[derive(Serialize)]
struct ManifestIntrinsics {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: u32,
    height: u32,
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
    intrinsics: ManifestIntrinsics,
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
    let Intrinsics {
        fx,
        fy,
        cx,
        cy,
        width,
        height,
    } = *intrinsics;
    let manifest = Manifest {
        generator: "ghostlight synth",
        version: env!("CARGO_PKG_VERSION"),
        seed: options.seed,
        frames: options.frames,
        rate_hz: options.rate_hz,
        intrinsics: ManifestIntrinsics {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        },
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

//! An estimated lamp for scenes without lights.
//!
//! One picture does not show where a room's lamps are. But most rooms are lit from above, and the picture shows how
//! brightly: a surface of albedo rho under irradiance E has radiance rho E / pi, and typical albedos of rooms are
//! known. This is a heuristic: the shadows are plausible, not exact.

use glam::{DVec3, Vec3};

use super::Light;
use crate::frame::RgbdFrame;
use crate::numerics::linear_from_srgb;

/// Least share of the lamp in the light on a white surface: a room without any shadow looks wrong more often than one
/// with a faint shadow.
const LEAST_KEY: f32 = 0.3;
/// Height of the lamp above its target, metres: a ceiling over a table.
const HEIGHT_M: f64 = 1.5;
/// Distance of the lamp to the viewer's left and towards the viewer, metres: shadows then fall to a visible side.
const ASIDE_M: f64 = 0.6;
/// Radius of the lamp, a globe, metres.
const RADIUS_M: f64 = 0.1;

/// Sampling step in both directions, pixels.
const STEP: u32 = 4;

/// Surfaces within this distance of the object count as equally lit, metres.
const NEAR_M: f64 = 1.0;

/// Least cosine between the normal of a level surface and the up direction.
const LEVEL: f64 = 0.8;

/// Fewest nearby pixels for an estimate; with fewer pixels, the whole picture is used.
const FEWEST: usize = 400;

/// Albedos of the median surface of a room, and of the brightest surface that is not a lamp (Ward Larson and
/// Shakespeare 1998, table of interior finishes: floors 0.2 to 0.4, wood 0.3 to 0.5, walls and paper 0.7 to 0.9).
const MEDIAN_ALBEDO: f32 = 0.4;
const BRIGHT_ALBEDO: f32 = 0.8;

/// Quantile of the brightest surfaces: specks and lamps cover fewer pixels.
const BRIGHT_QUANTILE: f64 = 0.97;

/// Share of the bright surfaces' colour that is attributed to the light; the rest is attributed to the surfaces.
const OWN_TINT: f32 = 0.5;

/// A soft lamp above `target` (world), with the brightness estimated from the first picture. `up` is a unit vector in
/// camera axes.
pub(super) fn key_light(first_frame: &RgbdFrame, target: DVec3, up: DVec3) -> Light {
    let white = radiance_of_white(first_frame, target, up);
    let ambient = mean_radiance(first_frame);
    // All surfaces emit the ambient light; the lamp provides the rest.
    let key = (white - ambient).max(white * LEAST_KEY);
    let offset = up * HEIGHT_M - DVec3::X * ASIDE_M - DVec3::Z * (0.5 * ASIDE_M);
    // Irradiance on a level surface, which the light reaches at an angle.
    let slant = (offset.length() / HEIGHT_M) as f32;
    let irradiance = key * (std::f32::consts::PI * slant);
    Light::Sphere {
        position: target + first_frame.pose.rotation * offset,
        radius_m: RADIUS_M,
        intensity: irradiance * offset.length_squared() as f32,
    }
}

fn mean_radiance(frame: &RgbdFrame) -> Vec3 {
    let sum: DVec3 = frame
        .color
        .rgba
        .iter()
        .map(|&pixel| linear(pixel).as_dvec3())
        .sum();
    (sum / frame.color.rgba.len().max(1) as f64).as_vec3()
}

fn linear([r, g, b, _]: [u8; 4]) -> Vec3 {
    Vec3::new(
        linear_from_srgb(r),
        linear_from_srgb(g),
        linear_from_srgb(b),
    )
}

/// Rec. 709 luminance.
fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Radiance of a white level surface at `target`: the geometric mean of two estimates, one from the median surface
/// near it and one from the brightest.
fn radiance_of_white(frame: &RgbdFrame, target: DVec3, up: DVec3) -> Vec3 {
    let mut near = samples(frame, |point, normal| {
        let to = frame.pose.transform_point(point) - target;
        to.length() < NEAR_M && normal.dot(up) > LEVEL
    });
    if near.len() < FEWEST {
        near = samples(frame, |_, _| true);
    }
    if near.is_empty() {
        // No depth: a grey-world estimate from the picture alone.
        return mean_radiance(frame) / MEDIAN_ALBEDO;
    }
    near.sort_by(|a, b| luminance(*a).total_cmp(&luminance(*b)));
    let at = |q: f64| ((near.len() - 1) as f64 * q) as usize;
    let by_median = luminance(near[at(0.5)]) / MEDIAN_ALBEDO;
    let by_bright = luminance(near[at(BRIGHT_QUANTILE)]) / BRIGHT_ALBEDO;
    let white = (by_median * by_bright).sqrt();
    let brightest = &near[at(0.9)..];
    let tint = brightest.iter().sum::<Vec3>() / brightest.len() as f32;
    let tint = tint / luminance(tint).max(f32::MIN_POSITIVE);
    Vec3::ONE.lerp(tint, OWN_TINT) * white
}

/// Linear colours of measured, unclipped pixels for which `wanted` accepts the point and unit normal (camera axes).
fn samples(frame: &RgbdFrame, wanted: impl Fn(DVec3, DVec3) -> bool) -> Vec<Vec3> {
    let (width, height) = (frame.color.width, frame.color.height);
    let point = |x: u32, y: u32| {
        let z = f64::from(*frame.depth.z_m.get((y * width + x) as usize)?);
        z.is_finite()
            .then(|| frame.intrinsics.unproject(f64::from(x), f64::from(y), z))
    };
    let mut found = Vec::new();
    for y in (0..height.saturating_sub(STEP)).step_by(STEP as usize) {
        for x in (0..width.saturating_sub(STEP)).step_by(STEP as usize) {
            let pixel = frame.color.rgba[(y * width + x) as usize];
            // Clipped: a lamp, a window, a highlight.
            if pixel[..3].iter().any(|&c| c >= 250) {
                continue;
            }
            let (Some(p), Some(right), Some(below)) =
                (point(x, y), point(x + STEP, y), point(x, y + STEP))
            else {
                continue;
            };
            let normal = (below - p).cross(right - p).normalize_or_zero();
            if wanted(p, normal) {
                found.push(linear(pixel));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Intrinsics, Pose};
    use crate::frame::{ColorImage, DepthImage};

    #[test]
    fn it_hangs_above_and_lights_a_grey_room_as_its_walls_are_lit() {
        let frame = RgbdFrame {
            index: 0,
            time_ns: 0,
            color: ColorImage::filled(64, 64, [188, 188, 188, 255]),
            depth: DepthImage::from_metres(64, 64, vec![1.0; 64 * 64]),
            intrinsics: Intrinsics::new(64.0, 64.0, 31.5, 31.5, 64, 64).unwrap(),
            pose: Pose::from_quaternion([0.0, 0.6, 0.0, 0.8], [5.0, 0.0, 0.0]).unwrap(),
        };
        let target = frame.pose.transform_point(DVec3::new(0.0, 0.0, 1.0));
        let Light::Sphere {
            position,
            intensity,
            ..
        } = key_light(&frame, target, -DVec3::Y)
        else {
            panic!("a lamp has an extent");
        };
        let in_camera = frame.pose.inverse().transform_point(position);
        assert!(in_camera.y < -1.0 && in_camera.x < 0.0, "{in_camera}");
        // All surfaces are equal: the result is between the estimates for the median albedo and for the brightest.
        let level = linear_from_srgb(188);
        let white = level / (MEDIAN_ALBEDO * BRIGHT_ALBEDO).sqrt();
        let away = position - target;
        let cosine = frame.pose.inverse().rotation * (away / away.length());
        let irradiance = intensity.x * -cosine.y as f32 / away.length_squared() as f32;
        let expected = std::f32::consts::PI * (white - level);
        assert!(
            (irradiance / expected - 1.0).abs() < 1e-5,
            "{irradiance} {expected}"
        );
    }

    /// A level floor of median albedo with a sheet of paper on it: the lamp and the ambient light together give a
    /// white card the same brightness as the paper.
    #[test]
    fn a_white_card_beside_paper_matches_it() {
        let (width, height) = (320, 240);
        let (albedo_paper, lit) = (0.8_f32, 0.9_f32);
        let code = |linear: f32| crate::numerics::srgb_from_linear(linear);
        let color = |i: usize| {
            let x = i % width as usize;
            let c = code(lit * if x > 270 { albedo_paper } else { 0.4 });
            [c, c, c, 255]
        };
        let intrinsics = Intrinsics::new(300.0, 300.0, 159.5, 119.5, width, height).unwrap();
        // A camera that looks straight down from 1 m.
        let frame = RgbdFrame {
            index: 0,
            time_ns: 0,
            color: ColorImage {
                width,
                height,
                rgba: (0..(width * height) as usize).map(color).collect(),
            },
            depth: DepthImage::from_metres(width, height, vec![1.0; (width * height) as usize]),
            intrinsics,
            pose: Pose::IDENTITY,
        };
        let target = DVec3::new(0.0, 0.0, 1.0);
        let white = radiance_of_white(&frame, target, -DVec3::Z);
        // Codes are rounded to 1/255.
        assert!((luminance(white) / lit - 1.0).abs() < 0.01, "{white}");
    }
}

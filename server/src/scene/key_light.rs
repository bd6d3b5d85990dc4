//! A light for scenes that name none.
//!
//! Where a room's lamps are cannot be told from one picture, but that most rooms are lit from above
//! can be assumed, and how brightly can be read off: with ambient light of radiance L all around,
//! irradiance is pi L. A heuristic: shadows fall plausibly, not truly.

use glam::{DVec3, Vec3};

use super::Light;
use crate::frame::RgbdFrame;
use crate::numerics::linear_from_srgb;

/// Irradiance of the key light over that of the ambient light: 1 makes a full shadow half as
/// bright as its surroundings, as under a ceiling lamp in a light room.
const KEY_OVER_AMBIENT: f32 = 1.0;
/// Height above what it lights, metres: a ceiling over a table.
const HEIGHT_M: f64 = 1.5;
/// How far to the viewer's left and towards the viewer it hangs, metres: shadows then fall to where
/// they are seen.
const ASIDE_M: f64 = 0.6;
/// A globe lamp, metres.
const RADIUS_M: f64 = 0.1;

/// A soft lamp above `target` (world), as bright as the first picture suggests. `up` is a unit vector
/// in camera axes.
pub(super) fn key_light(first_frame: &RgbdFrame, target: DVec3, up: DVec3) -> Light {
    let mut sum = DVec3::ZERO;
    for &[r, g, b, _] in &first_frame.color.rgba {
        sum += Vec3::new(
            linear_from_srgb(r),
            linear_from_srgb(g),
            linear_from_srgb(b),
        )
        .as_dvec3();
    }
    let mean = (sum / first_frame.color.rgba.len().max(1) as f64).as_vec3();
    let offset = up * HEIGHT_M - DVec3::X * ASIDE_M - DVec3::Z * (0.5 * ASIDE_M);
    let irradiance = mean * (std::f32::consts::PI * KEY_OVER_AMBIENT);
    Light::Sphere {
        position: target + first_frame.pose.rotation * offset,
        radius_m: RADIUS_M,
        intensity: irradiance * offset.length_squared() as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Intrinsics, Pose};
    use crate::frame::{ColorImage, DepthImage};

    #[test]
    fn it_hangs_above_and_shines_as_brightly_as_the_picture() {
        let frame = RgbdFrame {
            index: 0,
            time_ns: 0,
            color: ColorImage::filled(4, 4, [188, 188, 188, 255]),
            depth: DepthImage::from_metres(4, 4, vec![1.0; 16]),
            intrinsics: Intrinsics::new(4.0, 4.0, 1.5, 1.5, 4, 4).unwrap(),
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
        let irradiance = intensity.x / (position - target).length_squared() as f32;
        assert!((irradiance / (std::f32::consts::PI * linear_from_srgb(188)) - 1.0).abs() < 1e-5);
    }
}

//! Computes AOVs: images beside the composite.

use glam::Vec3A;

use crate::numerics::{luminance, srgb_from_linear};
use crate::render::aov::{Aov, AovImage};

use super::shade::input::ShadeInput;
use super::shade::real_share;
use super::shade::shaded::Shaded;
use super::tile::PrimaryHit;

/// One AOV.
pub(crate) fn aov_image(input: &ShadeInput<'_>, shaded: &[Shaded], aov: Aov) -> AovImage {
    let (sensed, light) = (&input.frame.sensed, &input.light);
    let (grid, ambient) = (light.surfaces.raw.grid, light.surfaces.raw.ambient);
    let [width, height] = sensed.size();
    let pixels = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
    let mask = |x, y| {
        grid.locate(x, y)
            .map_or(0.0, |(tile, place)| shaded[tile].mask[place])
    };
    let real_depth = |x: u32, y: u32| sensed.measured[(y * width + x) as usize];
    let rgb8 = |c: Vec3A| c.to_array().map(srgb_from_linear);
    match aov {
        Aov::Mask => AovImage::Gray8(
            pixels()
                .map(|(x, y)| (mask(x, y) * 255.0).round() as u8)
                .collect(),
        ),
        Aov::Depth => AovImage::Gray16(
            pixels()
                .map(|(x, y)| {
                    let pixel = input.primary.at(x, y);
                    let z = if pixel.seen == PrimaryHit::Object {
                        pixel.hit.t
                    } else {
                        real_depth(x, y)
                    };
                    if z.is_finite() {
                        (z * 1000.0).round().clamp(0.0, 65535.0) as u16
                    } else {
                        0
                    }
                })
                .collect(),
        ),
        Aov::Normal => AovImage::Rgb8(
            pixels()
                .map(|(x, y)| {
                    let pixel = input.primary.at(x, y);
                    let normal = if pixel.seen == PrimaryHit::Camera {
                        sensed.ghost.normal_at(x, y)
                    } else {
                        Some(input.frame.primary_surface(&pixel.hit, x, y).normal)
                    };
                    normal.map_or([0; 3], |n| {
                        ((n + Vec3A::ONE) * 127.5)
                            .round()
                            .to_array()
                            .map(|c| c as u8)
                    })
                })
                .collect(),
        ),
        Aov::Shadow => AovImage::Gray8(
            pixels()
                .map(|(x, y)| {
                    let share = grid.locate(x, y).map_or(Vec3A::ONE, |(tile, place)| {
                        real_share(light, &shaded[tile], x, y, place)
                    });
                    (luminance(share) * 255.0).round().min(255.0) as u8
                })
                .collect(),
        ),
        Aov::Ambient => AovImage::Gray8(
            pixels()
                .map(|(x, y)| {
                    let share = grid
                        .locate(x, y)
                        .map_or(Vec3A::ONE, |(tile, place)| ambient.share(tile, place));
                    (luminance(share) * 255.0).round().min(255.0) as u8
                })
                .collect(),
        ),
        Aov::Real => AovImage::Rgb8(pixels().map(|(x, y)| rgb8(sensed.color_at(x, y))).collect()),
        Aov::Mixed => AovImage::Rgb8(
            pixels()
                .map(|(x, y)| {
                    let own = grid
                        .locate(x, y)
                        .filter(|&(tile, place)| shaded[tile].touched[place]);
                    rgb8(own.map_or_else(
                        || sensed.color_at(x, y),
                        |(tile, place)| shaded[tile].color[place],
                    ))
                })
                .collect(),
        ),
    }
}

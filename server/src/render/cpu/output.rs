//! The end of a frame: highlights spread, linear light to 8 bits, images beside the composite.

use glam::Vec3A;
use rayon::prelude::*;

use crate::frame::ColorImage;
use crate::numerics::{linear_from_srgb, srgb_from_linear};
use crate::render::checkpoint::Workers;
use crate::render::{Aov, AovImage, RenderSettings};

use super::shade::{Shaded, luminance};
use super::tile::{Seen, TILE, Tile};
use super::{FrameContext, bloom, glare};

/// Whole-frame buffers of bloom and glare; empty until a highlight needs them.
#[derive(Default)]
pub(super) struct Post {
    source: Vec<[f32; 3]>,
    pub(super) added: Vec<[f32; 3]>,
    bloom: bloom::BloomScratch,
    glare: glare::GlareScratch,
}

impl Post {
    /// Spreads highlights into `added`; false if nothing is bright enough.
    pub(super) fn run(
        &mut self,
        workers: Workers<'_>,
        tiles: &[Tile],
        shaded: &[Shaded],
        width: u32,
        height: u32,
        settings: &RenderSettings,
    ) -> bool {
        let peak = shaded.iter().fold(0.0f32, |peak, tile| peak.max(tile.peak));
        let bloom_on =
            settings.bloom.enabled && peak > settings.bloom.threshold * (1.0 - settings.bloom.knee);
        let glare_on = settings.glare.enabled && peak > settings.glare.threshold;
        if !bloom_on && !glare_on {
            return false;
        }
        let n = width as usize * height as usize;
        workers.pool.install(|| {
            for buffer in [&mut self.source, &mut self.added] {
                buffer.resize(n, [0.0; 3]);
                buffer
                    .par_chunks_mut(1 << 14)
                    .for_each(|part| part.fill([0.0; 3]));
            }
        });
        for (tile, out) in tiles.iter().zip(shaded) {
            if out.peak == 0.0 {
                continue;
            }
            for dy in 0..tile.height {
                let row = (tile.y0 + dy) as usize * width as usize + tile.x0 as usize;
                for dx in 0..tile.width {
                    self.source[row + dx as usize] =
                        out.virtual_light[Tile::index(dx, dy)].to_array();
                }
            }
        }
        let mut spread = false;
        if bloom_on {
            spread |= bloom::bloom_while(
                &self.source,
                width as usize,
                height as usize,
                &settings.bloom,
                &mut self.bloom,
                &mut self.added,
                workers,
            );
        }
        if glare_on && workers.pulse.go_on() {
            spread |= glare::glare_while(
                &self.source,
                width as usize,
                height as usize,
                &settings.glare,
                &mut self.glare,
                &mut self.added,
                workers,
            );
        }
        spread
    }
}

/// Writes what changed over the camera's picture; everything else keeps its bytes.
pub(super) fn encode(
    ctx: &FrameContext<'_>,
    shaded: &[Shaded],
    added: Option<&[[f32; 3]]>,
    color: &mut ColorImage,
) {
    let width = color.width;
    let put = |pixel: &mut [u8; 4], linear: Vec3A| {
        let [r, g, b] = linear.to_array().map(srgb_from_linear);
        *pixel = [r, g, b, pixel[3]];
    };
    color
        .rgba
        .par_chunks_mut((width * TILE) as usize)
        .enumerate()
        .for_each(|(row, pixels)| {
            let added = added.map(|added| &added[row * (width * TILE) as usize..]);
            for column in 0..ctx.grid.columns {
                let slot = ctx.grid.slot(column, row as u32);
                if slot.is_none() && added.is_none() {
                    continue;
                }
                let columns = column * TILE..((column + 1) * TILE).min(width);
                for (dy, line) in pixels.chunks_exact_mut(width as usize).enumerate() {
                    for x in columns.clone() {
                        let pixel = &mut line[x as usize];
                        let extra = added.map_or(Vec3A::ZERO, |added| {
                            Vec3A::from_array(added[dy * width as usize + x as usize])
                        });
                        let place = Tile::index(x - columns.start, dy as u32);
                        match slot {
                            Some(slot) if shaded[slot].touched[place] => {
                                if extra == Vec3A::ZERO {
                                    pixel[..3].copy_from_slice(&shaded[slot].bytes[place]);
                                } else {
                                    put(pixel, shaded[slot].color[place] + extra);
                                }
                            }
                            _ if extra != Vec3A::ZERO => {
                                let [r, g, b, _] = *pixel;
                                let camera = Vec3A::new(
                                    linear_from_srgb(r),
                                    linear_from_srgb(g),
                                    linear_from_srgb(b),
                                );
                                put(pixel, camera + extra);
                            }
                            _ => {}
                        }
                    }
                }
            }
        });
}

/// One image beside the composite.
pub(super) fn aov_image(ctx: &FrameContext<'_>, shaded: &[Shaded], aov: Aov) -> AovImage {
    let (width, height) = (ctx.frame.color.width, ctx.frame.color.height);
    let pixels = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
    let mask = |x, y| {
        ctx.grid
            .locate(x, y)
            .map_or(0.0, |(tile, place)| shaded[tile].mask[place])
    };
    let real_depth = |x: u32, y: u32| ctx.frame.depth.z_m[(y * width + x) as usize];
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
                    let pixel = ctx.pixel(x, y);
                    let z = if pixel.seen == Seen::Object {
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
                    let pixel = ctx.pixel(x, y);
                    let normal = if pixel.seen == Seen::Camera {
                        ctx.ghost.normal_at(x, y)
                    } else {
                        Some(ctx.primary_surface(&pixel.hit, x, y).normal)
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
                    let share = ctx.grid.locate(x, y).map_or(Vec3A::ONE, |(tile, place)| {
                        ctx.real_share(&shaded[tile], x, y, place)
                    });
                    (luminance(share) * 255.0).round().min(255.0) as u8
                })
                .collect(),
        ),
        Aov::Ambient => AovImage::Gray8(
            pixels()
                .map(|(x, y)| {
                    let share = ctx
                        .grid
                        .locate(x, y)
                        .map_or(Vec3A::ONE, |(tile, place)| ctx.ambient_share(tile, place));
                    (luminance(share) * 255.0).round().min(255.0) as u8
                })
                .collect(),
        ),
        Aov::Real => AovImage::Rgb8(
            pixels()
                .map(|(x, y)| rgb8(ctx.camera_color(x, y)))
                .collect(),
        ),
        Aov::Mixed => AovImage::Rgb8(
            pixels()
                .map(|(x, y)| {
                    let own = ctx
                        .grid
                        .locate(x, y)
                        .filter(|&(tile, place)| shaded[tile].touched[place]);
                    rgb8(own.map_or_else(
                        || ctx.camera_color(x, y),
                        |(tile, place)| shaded[tile].color[place],
                    ))
                })
                .collect(),
        ),
    }
}

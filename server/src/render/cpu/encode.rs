//! The encode stage: linear light to 8-bit RGBA.

use glam::Vec3A;

use crate::frame::ColorImage;
use crate::numerics::{linear_from_srgb, srgb_from_linear};
use crate::render::prepare::tile_plan::{TILE, TileGrid};
use crate::render::threads::Workers;

use super::shade::shaded::Shaded;
use super::tile::Tile;

/// Writes what changed over the camera's picture; everything else keeps its bytes.
pub(crate) fn encode(
    grid: &TileGrid,
    shaded: &[Shaded],
    added: Option<&[[f32; 3]]>,
    color: &mut ColorImage,
    workers: Workers<'_>,
) {
    let width = color.width;
    let put = |pixel: &mut [u8; 4], linear: Vec3A| {
        let [r, g, b] = linear.to_array().map(srgb_from_linear);
        *pixel = [r, g, b, pixel[3]];
    };
    let rows = color.rgba.chunks_mut((width * TILE) as usize).enumerate();
    workers.for_each(rows, |(row, pixels)| {
        let added = added.map(|added| &added[row * (width * TILE) as usize..]);
        for column in 0..grid.columns {
            let slot = grid.slot(column, row as u32);
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

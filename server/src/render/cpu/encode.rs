//! The encode stage: linear light to 8-bit RGBA.

use crate::frame::ColorImage;
use crate::numerics::srgb_from_linear;
use crate::render::prepare::tile_plan::{TILE, TileGrid};
use crate::render::threads::Workers;

use super::post::composite::CompositeBuffers;
use super::shade::shaded::Shaded;
use super::tile::Tile;

/// Writes the changed pixels over the camera's picture; all others keep their bytes.
pub(crate) fn encode(
    grid: &TileGrid,
    shaded: &[Shaded],
    composite: &CompositeBuffers,
    color: &mut ColorImage,
    workers: Workers<'_>,
) {
    let width = color.width as usize;
    let (tile, any_open) = (TILE as usize, composite.any_open());
    let bands = color.rgba.chunks_mut(width * tile).enumerate();
    workers.for_each(bands, |(row, pixels)| {
        for column in 0..grid.columns {
            let Some(slot) = grid.slot(column, row as u32) else {
                continue;
            };
            let shaded = &shaded[slot];
            let columns = column as usize * tile..((column as usize + 1) * tile).min(width);
            for (dy, line) in pixels.chunks_exact_mut(width).enumerate() {
                let first = Tile::index(0, dy as u32);
                for (place, pixel) in (first..).zip(&mut line[columns.clone()]) {
                    if shaded.touched[place] {
                        pixel[..3].copy_from_slice(&shaded.bytes[place]);
                    }
                }
            }
        }
        if !any_open {
            return;
        }
        for (dy, line) in pixels.chunks_exact_mut(width).enumerate() {
            let (span, light) = composite.opened(row * tile + dy, width);
            for (pixel, light) in line[span.start..span.end].iter_mut().zip(light) {
                pixel[..3].copy_from_slice(&light.map(srgb_from_linear));
            }
        }
    });
}

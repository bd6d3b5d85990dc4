//! The post stage: highlights spread.

pub mod bloom;
pub mod glare;
pub mod highlight;

use crate::render::settings::RenderSettings;
use crate::render::threads::Workers;

use super::shade::shaded::Shaded;
use super::tile::Tile;
use bloom::{BloomScratch, bloom_while};
use glare::{GlareScratch, glare_while};

/// Whole-frame buffers of bloom and glare; empty until a highlight needs them.
#[derive(Default)]
pub(crate) struct Post {
    source: Vec<[f32; 3]>,
    pub(crate) added: Vec<[f32; 3]>,
    bloom: BloomScratch,
    glare: GlareScratch,
}

impl Post {
    /// Spreads highlights into `added`; false if nothing is bright enough.
    pub(crate) fn run(
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
        for buffer in [&mut self.source, &mut self.added] {
            buffer.resize(n, [0.0; 3]);
            workers.for_each(buffer.chunks_mut(1 << 14), |part| part.fill([0.0; 3]));
        }
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
            spread |= bloom_while(
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
            spread |= glare_while(
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

//! The linear picture of a frame, which post passes read and change.

use glam::Vec3A;

use crate::render::cpu::shade::shaded::Shaded;
use crate::render::cpu::tile::Tile;
use crate::render::prepare::sensed::Sensed;
use crate::render::prepare::tile_plan::TileGrid;
use crate::render::settings::RenderSettings;
use crate::render::threads::Workers;

use super::span::Span;

/// A post pass over the composite.
pub(crate) trait PostPass: Send {
    /// Runs the pass. It must open only the pixels that it changes.
    fn run(&mut self, settings: &RenderSettings, composite: &mut Composite<'_>);
}

/// The layers of the picture.
#[derive(Clone, Copy)]
struct Layers<'a> {
    sensed: Sensed<'a>,
    grid: &'a TileGrid,
    tiles: &'a [Tile],
    shaded: &'a [Shaded],
}

impl Layers<'_> {
    /// Linear light of a pixel after the shade stage.
    fn light_at(&self, x: u32, y: u32) -> Vec3A {
        let traced = self
            .grid
            .locate(x, y)
            .filter(|&(slot, place)| self.shaded[slot].touched[place]);
        match traced {
            Some((slot, place)) => self.shaded[slot].color[place],
            None => self.sensed.color_at(x, y),
        }
    }
}

/// A row of the composite.
pub(crate) struct Row<'r> {
    layers: Layers<'r>,
    y: usize,
    light: &'r mut [[f32; 3]],
    open: &'r mut Span,
}

impl Row<'_> {
    /// Opens pixels and returns their linear light, to be changed.
    pub(crate) fn open(&mut self, span: Span) -> &mut [[f32; 3]] {
        let before = *self.open;
        let now = before.union(span);
        *self.open = now;
        for x in (now.start..now.end).filter(|x| !(before.start..before.end).contains(x)) {
            self.light[x] = self.layers.light_at(x as u32, self.y as u32).to_array();
        }
        &mut self.light[span.start..span.end]
    }
}

/// Rows that one thread takes at a time.
const ROWS_AT_ONCE: usize = 16;

/// The picture after shading. Linear light is stored only for pixels that a pass has opened; all others keep the
/// bytes of the camera or of the shade stage.
pub(crate) struct Composite<'a> {
    layers: Layers<'a>,
    buffers: &'a mut CompositeBuffers,
    workers: Workers<'a>,
}

/// Buffers of whole pictures, rows from the top; empty until a pass needs them.
#[derive(Default)]
pub(crate) struct CompositeBuffers {
    /// Meaningful for open pixels.
    light: Vec<[f32; 3]>,
    /// For each row, the open pixels; empty if there are none.
    open: Vec<Span>,
    /// M Im; computed when a pass first needs it.
    virtual_light: Vec<[f32; 3]>,
    has_virtual_light: bool,
    added: Vec<[f32; 3]>,
}

impl CompositeBuffers {
    /// Whether a pass has opened any pixel.
    pub(crate) fn any_open(&self) -> bool {
        !self.open.is_empty()
    }

    /// The open pixels of a row, and their linear light.
    pub(crate) fn opened(&self, y: usize, width: usize) -> (Span, &[[f32; 3]]) {
        let span = self.open.get(y).copied().unwrap_or_default();
        let light = self.light.get(y * width..).unwrap_or_default();
        (span, light.get(span.start..span.end).unwrap_or_default())
    }
}

impl<'a> Composite<'a> {
    /// The composite from the result of the shade stage; no pixel is open.
    pub(crate) fn new(
        sensed: Sensed<'a>,
        grid: &'a TileGrid,
        (tiles, shaded): (&'a [Tile], &'a [Shaded]),
        buffers: &'a mut CompositeBuffers,
        workers: Workers<'a>,
    ) -> Self {
        buffers.open.clear();
        buffers.has_virtual_light = false;
        Self {
            layers: Layers {
                sensed,
                grid,
                tiles,
                shaded,
            },
            buffers,
            workers,
        }
    }

    /// Width and height, pixels.
    pub(crate) fn size(&self) -> [usize; 2] {
        self.layers.sensed.size().map(|n| n as usize)
    }

    /// Largest luminance of virtual objects, M Im.
    pub(crate) fn virtual_peak(&self) -> f32 {
        let peaks = self.layers.shaded.iter().map(|tile| tile.peak);
        peaks.fold(0.0, f32::max)
    }

    /// Changes rows in parallel, until the frame is cancelled.
    pub(crate) fn for_rows(&mut self, change: impl Fn(usize, Row<'_>) + Sync) {
        let [width, height] = self.size();
        let layers = self.layers;
        let CompositeBuffers { light, open, .. } = &mut *self.buffers;
        if open.is_empty() {
            open.resize(height, Span::default());
            light.resize(width * height, [0.0; 3]);
        }
        let bands = light
            .chunks_mut(ROWS_AT_ONCE * width)
            .zip(open.chunks_mut(ROWS_AT_ONCE));
        let workers = self.workers;
        workers.for_each(bands.enumerate(), |(band, (light, open))| {
            let rows = light.chunks_mut(width).zip(open);
            for (y, (light, open)) in (band * ROWS_AT_ONCE..).zip(rows) {
                let row = Row {
                    layers,
                    y,
                    light,
                    open,
                };
                change(y, row);
            }
        });
    }

    /// Adds the light that `spread` computes from the virtual light of the picture. `spread` gets that light and
    /// a black picture to add to, and returns whether it has added anything.
    pub(crate) fn add(
        &mut self,
        spread: impl FnOnce(&[[f32; 3]], &mut [[f32; 3]], Workers<'_>) -> bool,
    ) {
        self.lay_out_virtual_light();
        let [width, height] = self.size();
        let mut added = std::mem::take(&mut self.buffers.added);
        blacken(&mut added, width * height, self.workers);
        if spread(&self.buffers.virtual_light, &mut added, self.workers) {
            self.for_rows(|y, mut row| {
                let added = &added[y * width..][..width];
                let lit = |px: &[f32; 3]| *px != [0.0; 3];
                let (first, last) = (added.iter().position(lit), added.iter().rposition(lit));
                let (Some(start), Some(last)) = (first, last) else {
                    return;
                };
                let end = last + 1;
                let light = row.open(Span { start, end });
                for (light, px) in light.iter_mut().zip(&added[start..end]) {
                    *light = (Vec3A::from_array(*light) + Vec3A::from_array(*px)).to_array();
                }
            });
        }
        self.buffers.added = added;
    }

    fn lay_out_virtual_light(&mut self) {
        if std::mem::replace(&mut self.buffers.has_virtual_light, true) {
            return;
        }
        let [width, height] = self.size();
        let virtual_light = &mut self.buffers.virtual_light;
        blacken(virtual_light, width * height, self.workers);
        for (tile, out) in self.layers.tiles.iter().zip(self.layers.shaded) {
            if out.peak == 0.0 {
                continue;
            }
            for dy in 0..tile.height {
                let row = (tile.y0 + dy) as usize * width + tile.x0 as usize;
                for dx in 0..tile.width {
                    virtual_light[row + dx as usize] =
                        out.virtual_light[Tile::index(dx, dy)].to_array();
                }
            }
        }
    }
}

/// Makes a picture of `n` pixels black.
fn blacken(picture: &mut Vec<[f32; 3]>, n: usize, workers: Workers<'_>) {
    picture.resize(n, [0.0; 3]);
    workers.for_each(picture.chunks_mut(1 << 14), |part| part.fill([0.0; 3]));
}

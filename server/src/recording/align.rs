//! Measures how well depth is aligned with colour: a depth jump is the edge of an object, where colour mostly changes
//! too. The colour gradient along the jumps is summed for all shifts of one picture against the other; the peak is
//! the offset of depth.

use crate::frame::{ColorImage, DepthImage, is_valid_depth};

/// Largest shift tried, pixels of the (possibly reduced) pictures, in each direction.
const REACH: (i32, i32) = (32, 16);
/// Pictures wider than this are reduced: alignment is reported in whole pixels.
const WORKING_WIDTH: u32 = 640;
/// Least size of a depth jump, metres, to which a tenth of the depth is added. Well above any sensor's noise.
const JUMP_M: f32 = 0.05;
/// Part of a jump that is relative to depth.
const JUMP_RELATIVE: f32 = 0.1;
/// Longest run of invalid pixels within a jump: the shadow band beside an object.
const MAX_BAND_PX: usize = 24;
/// Upper limit on gradients, grey levels per pixel; without it a single lamp would outweigh the room.
const GRADIENT_CAP: f32 = 40.0;
/// Most jumps used per frame; more take time without improving the result.
const MAX_JUMPS: usize = 6000;

/// A depth jump: the outermost pixel of the near side, and whether the jump is along u or v.
#[derive(Debug, Clone, Copy)]
struct Jump {
    x: i32,
    y: i32,
    along_u: bool,
}

/// Sums of gradients at jumps, per shift, over all frames.
#[derive(Debug)]
pub(super) struct Aligner {
    sums: Vec<f64>,
    counts: Vec<u32>,
    background: f64,
    n_background: u64,
    scale: u32,
    pub(super) n_jumps: usize,
}

/// The best shift, and values to judge its reliability.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peak {
    /// Colour position minus depth position, full-size pixels.
    pub(super) shift_px: (i32, i32),
    /// Mean gradient at the unshifted jumps, relative to the picture's mean.
    pub(super) contrast_here: f64,
    /// The same at the best shift.
    pub(super) contrast_best: f64,
    /// The same, median over all shifts: the value to expect by chance.
    pub(super) contrast_median: f64,
}

impl Aligner {
    pub(super) fn new(width: u32) -> Self {
        let n = ((2 * REACH.0 + 1) * (2 * REACH.1 + 1)) as usize;
        Self {
            sums: vec![0.0; n],
            counts: vec![0; n],
            background: 0.0,
            n_background: 0,
            scale: width.div_ceil(WORKING_WIDTH).max(1),
            n_jumps: 0,
        }
    }

    /// Adds a frame whose colour and depth have the same size.
    pub(super) fn add(&mut self, color: &ColorImage, depth: &DepthImage) {
        let luma = Plane::luma(color, self.scale);
        let z = Plane::depth(depth, self.scale);
        let [grad_u, grad_v] = [luma.gradient(1, 0), luma.gradient(0, 1)];
        for plane in [&grad_u, &grad_v] {
            self.background += plane.values.iter().map(|&g| f64::from(g)).sum::<f64>();
            self.n_background += plane.values.len() as u64;
        }
        let mut jumps = Vec::new();
        find_jumps(&z, true, &mut jumps);
        find_jumps(&z, false, &mut jumps);
        self.n_jumps += jumps.len();
        let stride = jumps.len().div_ceil(MAX_JUMPS).max(1);
        for jump in jumps.iter().step_by(stride) {
            let plane = if jump.along_u { &grad_u } else { &grad_v };
            let mut slot = 0;
            for dy in -REACH.1..=REACH.1 {
                for dx in -REACH.0..=REACH.0 {
                    if let Some(g) = plane.get(jump.x + dx, jump.y + dy) {
                        self.sums[slot] += f64::from(g);
                        self.counts[slot] += 1;
                    }
                    slot += 1;
                }
            }
        }
    }

    /// The best shift; `None` with too few depth jumps to decide.
    pub(super) fn peak(&self) -> Option<Peak> {
        // With fewer jumps, one of the 2145 shifts can have a peak by chance.
        const MIN_JUMPS: usize = 200;
        if self.n_jumps < MIN_JUMPS || self.background <= 0.0 {
            return None;
        }
        let mean = self.background / self.n_background as f64;
        let means: Vec<f64> = self
            .sums
            .iter()
            .zip(&self.counts)
            .map(|(sum, &n)| {
                if n as usize >= MIN_JUMPS / 2 {
                    sum / f64::from(n) / mean
                } else {
                    0.0
                }
            })
            .collect();
        let columns = 2 * REACH.0 + 1;
        let shift_of = |slot: usize| {
            (
                slot as i32 % columns - REACH.0,
                slot as i32 / columns - REACH.1,
            )
        };
        // On a tie the smaller shift wins, so that without a clear peak nothing is shifted.
        let best = (0..means.len()).max_by(|&a, &b| {
            let length = |slot| {
                let (dx, dy) = shift_of(slot);
                dx * dx + dy * dy
            };
            means[a]
                .total_cmp(&means[b])
                .then(length(b).cmp(&length(a)))
        })?;
        let mut sorted = means.clone();
        sorted.sort_by(f64::total_cmp);
        let (dx, dy) = shift_of(best);
        let scale = self.scale as i32;
        Some(Peak {
            shift_px: (dx * scale, dy * scale),
            contrast_here: means[(REACH.1 * columns + REACH.0) as usize],
            contrast_best: means[best],
            contrast_median: sorted[sorted.len() / 2],
        })
    }
}

/// A reduced picture with one value per pixel.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// Mean grey level of each block of `scale` squared pixels.
    fn luma(image: &ColorImage, scale: u32) -> Self {
        let scale = scale as usize;
        Self::reduced(image.width, image.height, scale, |x, y| {
            let mut sum = 0.0;
            for j in 0..scale {
                let row = (y * scale + j) * image.width as usize + x * scale;
                for [r, g, b, _] in &image.rgba[row..row + scale] {
                    sum += 0.299 * f32::from(*r) + 0.587 * f32::from(*g) + 0.114 * f32::from(*b);
                }
            }
            sum / (scale * scale) as f32
        })
    }

    /// Depth at the centre of each block: a mean across a jump would not be a depth.
    fn depth(image: &DepthImage, scale: u32) -> Self {
        let scale = scale as usize;
        Self::reduced(image.width, image.height, scale, |x, y| {
            image.z_m[(y * scale + scale / 2) * image.width as usize + x * scale + scale / 2]
        })
    }

    fn reduced(width: u32, height: u32, scale: usize, at: impl Fn(usize, usize) -> f32) -> Self {
        let (width, height) = (width as usize / scale, height as usize / scale);
        let values = (0..width * height)
            .map(|i| at(i % width, i / width))
            .collect();
        Self {
            width,
            height,
            values,
        }
    }

    fn get(&self, x: i32, y: i32) -> Option<f32> {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        (x < self.width && y < self.height).then(|| self.values[y * self.width + x])
    }

    /// The capped central difference along an axis, as the maximum of a pixel and its two neighbours along the axis:
    /// a jump is located to about a pixel.
    fn gradient(&self, dx: i32, dy: i32) -> Self {
        let difference = |x: i32, y: i32| match (self.get(x - dx, y - dy), self.get(x + dx, y + dy))
        {
            (Some(a), Some(b)) => ((a - b).abs() * 0.5).min(GRADIENT_CAP),
            _ => 0.0,
        };
        let values = (0..self.width * self.height).map(|i| {
            let (x, y) = ((i % self.width) as i32, (i / self.width) as i32);
            difference(x, y)
                .max(difference(x - dx, y - dy))
                .max(difference(x + dx, y + dy))
        });
        Self {
            width: self.width,
            height: self.height,
            values: values.collect(),
        }
    }
}

/// Jumps along rows (`along_u`) or columns.
fn find_jumps(z: &Plane, along_u: bool, jumps: &mut Vec<Jump>) {
    let (lines, length) = if along_u {
        (z.height, z.width)
    } else {
        (z.width, z.height)
    };
    for line in 0..lines {
        let index = |i: usize| {
            if along_u {
                line * z.width + i
            } else {
                i * z.width + line
            }
        };
        let mut last: Option<(usize, f32)> = None;
        for i in 0..length {
            let here = z.values[index(i)];
            if !is_valid_depth(here) {
                continue;
            }
            if let Some((before, depth)) = last
                && i - before <= MAX_BAND_PX + 1
                && (here - depth).abs() > JUMP_M + JUMP_RELATIVE * here.min(depth)
            {
                let near = index(if depth < here { before } else { i });
                jumps.push(Jump {
                    x: (near % z.width) as i32,
                    y: (near / z.width) as i32,
                    along_u,
                });
            }
            last = Some((i, here));
        }
    }
}

//! Bloom: light of virtual highlights spreads over their surroundings, in linear light.
//!
//! Input: radiance of the virtual highlights, linear Rec.709, already multiplied by the mask.
//! Output: light to add to the composite. Two forms:
//!
//! - [`BloomMethod::Gaussians`], as in RT2AR (dos Santos et al. 2012, section IV.F, after Pessoa et al.): pixels
//!   above a luminance threshold, downscaled, successive Gaussian filters, each level read bilinearly and summed
//!   with a weight.
//! - [`BloomMethod::Pyramid`]: soft knee, then a chain of 1-3-3-1 downsamplings and their
//!   transposes as upsamplings. Upsampling a level is four times the transpose of the
//!   downsampling that made it, so both keep the sum of light and the point spread is symmetric.
//!
//! Both conserve energy: on a plane without borders the light added is `intensity` times the light of the bright
//! pass; light that spreads beyond the picture's border is lost, as in a lens. All levels have the same weight. A
//! level's footprint grows four times from one to the next, so light falls off about as 1/r^2, the falloff of
//! glare in eyes and lenses (Spencer et al. 1995).
//!
//! Only the bounding rectangle of the bright pass is processed, extended level by level by exactly the reach of
//! each filter, so a few small highlights cost next to nothing.

use glam::Vec3A;

use super::composite::{Composite, PostPass};
use super::highlight::BrightPass;
use super::span::Span;
use crate::render::checkpoint::{Pulse, Uninterrupted};
use crate::render::settings::{BloomMethod, BloomSettings, RenderSettings};
use crate::render::threads::{Threads, Workers};

/// Most pyramid levels: the eighth reaches about 500 pixels.
const MAX_LEVELS: usize = 8;

/// Planes smaller than this are filtered on the calling thread: passing rows to other threads takes about as long
/// as filtering them (some 10 microseconds).
const SERIAL_PX: usize = 8192;

/// Buffers that are kept between frames; nothing is allocated after the first frames.
#[derive(Debug, Default)]
pub struct BloomScratch {
    spans: Vec<Span>,
    levels: Vec<Plane>,
    half: Plane,
    rows: Vec<Vec3A>,
}

/// Adds the bloom of `source` to `added`, both `width * height` pixels from the top row.
///
/// Returns false, with nothing written, if bloom is off or nothing is bright enough: for the pyramid, that is a
/// luminance over `threshold * (1 - knee)`, where the knee begins. The result is identical for any number of
/// threads.
///
/// # Panics
/// If a slice does not hold `width * height` pixels.
pub fn bloom(
    source: &[[f32; 3]],
    width: usize,
    height: usize,
    settings: &BloomSettings,
    scratch: &mut BloomScratch,
    added: &mut [[f32; 3]],
    threads: &Threads,
) -> bool {
    let pulse = &Pulse::new(&Uninterrupted);
    let workers = Workers { threads, pulse };
    bloom_while(source, width, height, settings, scratch, added, workers)
}

/// [`bloom`] that returns early, with nothing meaningful written, if the frame is cancelled.
pub(crate) fn bloom_while(
    source: &[[f32; 3]],
    width: usize,
    height: usize,
    settings: &BloomSettings,
    scratch: &mut BloomScratch,
    added: &mut [[f32; 3]],
    workers: Workers<'_>,
) -> bool {
    assert_eq!(source.len(), width * height, "source of {width}x{height}");
    assert_eq!(added.len(), width * height, "added of {width}x{height}");
    if !settings.enabled || settings.intensity <= 0.0 {
        return false;
    }
    let pass = match settings.method {
        BloomMethod::Gaussians => BrightPass::whole(settings.threshold),
        BloomMethod::Pyramid => BrightPass::knee(settings.threshold, settings.knee),
    };
    pass.spans(source, width, &mut scratch.spans, workers);
    let Some(bright) = bounding_rect(&scratch.spans) else {
        return false;
    };
    let n_levels = (settings.levels as usize).clamp(1, MAX_LEVELS);
    scratch.levels.resize_with(MAX_LEVELS + 1, Plane::default);
    scratch.levels[0].reset(bright);
    let x0 = bright.x0 as usize;
    for_rows(
        &mut scratch.levels[0].px,
        bright.width(),
        &mut scratch.spans[bright.y0 as usize..],
        1,
        workers,
        |row, pixels, span| {
            let source = &source[(bright.y0 as usize + row) * width..];
            for x in span[0].start..span[0].end {
                pixels[x - x0] = pass.filter(source[x]);
            }
        },
    );
    let scale = settings.intensity / n_levels as f32;
    let image = Rect::of_image(width, height);
    match settings.method {
        BloomMethod::Gaussians => gaussians(scratch, n_levels, image, scale, added, workers),
        BloomMethod::Pyramid => pyramid(scratch, n_levels, image, scale, added, workers),
    }
    true
}

/// The bounding rectangle of all spans.
fn bounding_rect(spans: &[Span]) -> Option<Rect> {
    let y0 = spans.iter().position(|span| !span.is_empty())?;
    let y1 = spans.iter().rposition(|span| !span.is_empty())? + 1;
    let lit = || spans[y0..y1].iter().filter(|span| !span.is_empty());
    Some(Rect {
        x0: lit().map(|span| span.start).min()? as i32,
        y0: y0 as i32,
        x1: lit().map(|span| span.end).max()? as i32,
        y1: y1 as i32,
    })
}

/// Pixels `x0..x1`, `y0..y1` of one level, on a plane without borders: in each direction, pixel c of a level
/// covers pixels 2c and 2c + 1 of the previous level.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Rect {
    x0: i32,
    y0: i32,
    x1: i32,
    y1: i32,
}

impl Rect {
    fn of_image(width: usize, height: usize) -> Self {
        Self {
            x0: 0,
            y0: 0,
            x1: width as i32,
            y1: height as i32,
        }
    }

    fn width(self) -> usize {
        (self.x1 - self.x0).max(0) as usize
    }

    fn height(self) -> usize {
        (self.y1 - self.y0).max(0) as usize
    }

    fn map(self, start: impl Fn(i32) -> i32, end: impl Fn(i32) -> i32) -> Self {
        Self {
            x0: start(self.x0),
            y0: start(self.y0),
            x1: end(self.x1),
            y1: end(self.y1),
        }
    }

    /// The pixels that these pixels reach when downsampled by 1-3-3-1: pixel c reads 2c - 1 to 2c + 2.
    fn coarser(self) -> Self {
        self.map(|x0| (x0 - 1) >> 1, |x1| (x1 >> 1) + 1)
    }

    /// The pixels that these pixels reach when upsampled, which is the transpose.
    fn finer(self) -> Self {
        self.map(|x0| 2 * x0 - 1, |x1| 2 * x1 + 1)
    }

    fn intersection(self, other: Self) -> Self {
        Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        }
    }
}

/// Light of one level, in a rectangle of it; dark elsewhere.
#[derive(Debug, Default)]
struct Plane {
    rect: Rect,
    px: Vec<Vec3A>,
}

impl Plane {
    fn reset(&mut self, rect: Rect) {
        self.rect = rect;
        self.px.clear();
        self.px.resize(rect.width() * rect.height(), Vec3A::ZERO);
    }

    /// `out[i] = sum over k of weights[k] * pixel (x0 + i, y + k)`.
    fn sum_rows(&self, y: i32, weights: &[f32], x0: i32, out: &mut [Vec3A]) {
        out.fill(Vec3A::ZERO);
        let from = x0.max(self.rect.x0);
        let to = (x0 + out.len() as i32).min(self.rect.x1);
        if from >= to {
            return;
        }
        let out = &mut out[(from - x0) as usize..(to - x0) as usize];
        for (row, &weight) in (y..).zip(weights) {
            if row < self.rect.y0 || row >= self.rect.y1 {
                continue;
            }
            let start = (row - self.rect.y0) as usize * self.rect.width();
            let pixels = &self.px[start + (from - self.rect.x0) as usize..];
            for (sum, &pixel) in out.iter_mut().zip(pixels) {
                *sum += pixel * weight;
            }
        }
    }
}

/// Calls `f(row, a's row, b's row)` for each row of two images with equally many rows, until the frame is
/// cancelled.
fn for_rows<A: Send, B: Send>(
    a: &mut [A],
    a_width: usize,
    b: &mut [B],
    b_width: usize,
    workers: Workers<'_>,
    f: impl Fn(usize, &mut [A], &mut [B]) + Sync,
) {
    if a_width == 0 || b_width == 0 {
        return;
    }
    // Rows that one thread takes at a time: all rows of a small picture.
    let rows = match a.len() {
        0..SERIAL_PX => a.len().div_ceil(a_width),
        _ => (SERIAL_PX / 4).div_ceil(a_width),
    };
    let rows = rows.max(1);
    let bands = a
        .chunks_mut(rows * a_width)
        .zip(b.chunks_mut(rows * b_width));
    workers.for_each(bands.enumerate(), |(band, (a, b))| {
        let each = a.chunks_mut(a_width).zip(b.chunks_mut(b_width));
        for (row, (a, b)) in each.enumerate() {
            if workers.pulse.go_on() {
                f(band * rows + row, a, b);
            }
        }
    });
}

/// `n` pixels of a buffer, which grows as needed.
fn grown(buffer: &mut Vec<Vec3A>, n: usize) -> &mut [Vec3A] {
    if buffer.len() < n {
        buffer.resize(n, Vec3A::ZERO);
    }
    &mut buffer[..n]
}

fn pyramid(
    scratch: &mut BloomScratch,
    n_levels: usize,
    image: Rect,
    scale: f32,
    added: &mut [[f32; 3]],
    workers: Workers<'_>,
) {
    // The pixels of each level that get light from the previous level, and those that reach the image.
    let mut lit = [scratch.levels[0].rect; MAX_LEVELS + 1];
    let mut seen = [image; MAX_LEVELS + 1];
    for level in 1..=n_levels {
        lit[level] = lit[level - 1].coarser();
        seen[level] = seen[level - 1].coarser();
    }
    // The pixels that get light from the next level on the way back.
    let mut rects = lit;
    for level in (1..n_levels).rev() {
        rects[level] = rects[level + 1].finer().intersection(seen[level]);
    }
    for level in 1..=n_levels {
        let (fine, coarse) = scratch.levels.split_at_mut(level);
        coarse[0].reset(rects[level]);
        downsample(
            &fine[level - 1],
            &mut coarse[0],
            lit[level],
            &mut scratch.rows,
            workers,
        );
    }
    for level in (1..n_levels).rev() {
        let (fine, coarse) = scratch.levels.split_at_mut(level + 1);
        let fine = &mut fine[level];
        let rect = fine.rect;
        upsample(
            &coarse[0],
            rect,
            &mut scratch.rows,
            &mut fine.px,
            rect.width(),
            workers,
            |pixels, x, light| pixels[(x - rect.x0) as usize] += light,
        );
    }
    let rect = rects[1].finer().intersection(image);
    let rows = rect.y0 as usize * image.width()..rect.y1 as usize * image.width();
    upsample(
        &scratch.levels[1],
        rect,
        &mut scratch.rows,
        &mut added[rows],
        image.width(),
        workers,
        |pixels, x, light| add(&mut pixels[x as usize], light * scale),
    );
}

#[inline]
fn add(pixel: &mut [f32; 3], light: Vec3A) {
    pixel[0] += light.x;
    pixel[1] += light.y;
    pixel[2] += light.z;
}

/// Pixels `rect` of `coarse`, from a plane at twice the resolution.
fn downsample(
    fine: &Plane,
    coarse: &mut Plane,
    rect: Rect,
    rows: &mut Vec<Vec3A>,
    workers: Workers<'_>,
) {
    const WEIGHTS: [f32; 4] = [0.125, 0.375, 0.375, 0.125];
    let width = coarse.rect.width();
    let first = (rect.x0 - coarse.rect.x0) as usize;
    let skipped = (rect.y0 - coarse.rect.y0) as usize * width;
    let n = rect.height() * width;
    // Pixel c of `rect` reads columns 2c - 1 to 2c + 2: entries 2i to 2i + 3 of this row.
    let taps = 2 * rect.width() + 2;
    for_rows(
        &mut coarse.px[skipped..skipped + n],
        width,
        grown(rows, rect.height() * taps),
        taps,
        workers,
        |row, pixels, t| {
            fine.sum_rows(2 * (rect.y0 + row as i32) - 1, &WEIGHTS, 2 * rect.x0 - 1, t);
            for (pixel, t) in pixels[first..].iter_mut().zip(t.windows(4).step_by(2)) {
                *pixel = (t[0] + t[3]) * WEIGHTS[0] + (t[1] + t[2]) * WEIGHTS[1];
            }
        },
    );
}

/// Calls `put(row of out, x, light)` for each pixel of `rect`, at twice the resolution of `coarse`.
fn upsample<T: Send>(
    coarse: &Plane,
    rect: Rect,
    rows: &mut Vec<Vec3A>,
    out: &mut [T],
    out_width: usize,
    workers: Workers<'_>,
    put: impl Fn(&mut [T], i32, Vec3A) + Sync,
) {
    if rect.width() == 0 || rect.height() == 0 {
        return;
    }
    let c0 = rect.x0 >> 1;
    let taps = (((rect.x1 - 1) >> 1) - c0) as usize + 3;
    for_rows(
        out,
        out_width,
        grown(rows, rect.height() * taps),
        taps,
        workers,
        |row, pixels, t| {
            let y = rect.y0 + row as i32;
            // Pixels 2c and 2c + 1 are a quarter of a coarse pixel to either side of its centre.
            let (first, weights) = if y & 1 == 0 {
                ((y >> 1) - 1, [0.25, 0.75])
            } else {
                (y >> 1, [0.75, 0.25])
            };
            coarse.sum_rows(first, &weights, c0 - 1, t);
            for (c, t) in (c0..).zip(t.windows(3)) {
                let x = 2 * c;
                let centre = t[1] * 0.75;
                if x >= rect.x0 {
                    put(pixels, x, centre + t[0] * 0.25);
                }
                if x + 1 < rect.x1 {
                    put(pixels, x + 1, centre + t[2] * 0.25);
                }
            }
        },
    );
}

fn gaussians(
    scratch: &mut BloomScratch,
    n_levels: usize,
    image: Rect,
    scale: f32,
    added: &mut [[f32; 3]],
    workers: Workers<'_>,
) {
    for level in 1..=n_levels {
        if !workers.pulse.go_on() {
            return;
        }
        let (fine, coarse) = scratch.levels.split_at_mut(level);
        halve(
            &fine[level - 1],
            &mut scratch.half,
            &mut scratch.rows,
            workers,
        );
        blur(&scratch.half, &mut coarse[0], &mut scratch.rows, workers);
    }
    for level in 1..=n_levels {
        if !workers.pulse.go_on() {
            return;
        }
        let plane = &scratch.levels[level];
        let size = 1i32 << level;
        // Bilinear interpolation reaches half a pixel of the level beyond its rectangle.
        let reach = plane.rect.map(|c0| (c0 - 1) * size, |c1| (c1 + 1) * size);
        let rect = reach.intersection(image);
        let taps = plane.rect.width() + 4;
        let rows = rect.y0 as usize * image.width()..rect.y1 as usize * image.width();
        for_rows(
            &mut added[rows],
            image.width(),
            grown(&mut scratch.rows, rect.height() * taps),
            taps,
            workers,
            |row, pixels, t| {
                let (first, weight) = bilinear(rect.y0 + row as i32, level);
                let x0 = plane.rect.x0 - 2;
                plane.sum_rows(first, &[1.0 - weight, weight], x0, t);
                for x in rect.x0..rect.x1 {
                    let (first, weight) = bilinear(x, level);
                    let at = (first - x0) as usize;
                    let light = t[at] * (1.0 - weight) + t[at + 1] * weight;
                    add(&mut pixels[x as usize], light * scale);
                }
            },
        );
    }
}

/// The pixel of a level at or before the centre of an image pixel, and the weight of the next pixel.
fn bilinear(x: i32, level: usize) -> (i32, f32) {
    // (x + 1/2) / 2^level - 1/2, in units of half an image pixel: exact.
    let halves = 2 * x + 1 - (1 << level);
    let size = 2 << level;
    let first = halves.div_euclid(size);
    (first, halves.rem_euclid(size) as f32 / size as f32)
}

/// Mean of each 2x2 block.
fn halve(fine: &Plane, coarse: &mut Plane, rows: &mut Vec<Vec3A>, workers: Workers<'_>) {
    let rect = fine.rect.map(|x0| x0 >> 1, |x1| ((x1 - 1) >> 1) + 1);
    coarse.reset(rect);
    let taps = 2 * rect.width();
    let t = grown(rows, rect.height() * taps);
    for_rows(
        &mut coarse.px,
        rect.width(),
        t,
        taps,
        workers,
        |row, pixels, t| {
            fine.sum_rows(2 * (rect.y0 + row as i32), &[0.5; 2], 2 * rect.x0, t);
            for (pixel, t) in pixels.iter_mut().zip(t.chunks_exact(2)) {
                *pixel = (t[0] + t[1]) * 0.5;
            }
        },
    );
}

/// Gaussian of one pixel's standard deviation, as the binomial 1-4-6-4-1.
fn blur(source: &Plane, blurred: &mut Plane, rows: &mut Vec<Vec3A>, workers: Workers<'_>) {
    const WEIGHTS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let rect = source.rect.map(|x0| x0 - 2, |x1| x1 + 2);
    blurred.reset(rect);
    let taps = rect.width() + 4;
    let t = grown(rows, rect.height() * taps);
    for_rows(
        &mut blurred.px,
        rect.width(),
        t,
        taps,
        workers,
        |row, pixels, t| {
            source.sum_rows(rect.y0 + row as i32 - 2, &WEIGHTS, rect.x0 - 2, t);
            for (pixel, t) in pixels.iter_mut().zip(t.windows(5)) {
                *pixel =
                    (t[0] + t[4]) * WEIGHTS[0] + (t[1] + t[3]) * WEIGHTS[1] + t[2] * WEIGHTS[2];
            }
        },
    );
}

/// Bloom as a post pass.
#[derive(Default)]
pub(crate) struct BloomPass(BloomScratch);

impl PostPass for BloomPass {
    fn run(&mut self, settings: &RenderSettings, composite: &mut Composite<'_>) {
        let bloom = &settings.bloom;
        let start = bloom.threshold * (1.0 - bloom.knee);
        if !bloom.enabled || composite.virtual_peak() <= start {
            return;
        }
        let [width, height] = composite.size();
        composite.add(|light, added, workers| {
            bloom_while(light, width, height, bloom, &mut self.0, added, workers)
        });
    }
}

#[cfg(test)]
mod tests;

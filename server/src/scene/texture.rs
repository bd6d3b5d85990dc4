//! Textures with mip levels, for surfaces that are small or seen at an angle.

use glam::{Vec2, Vec4};

use crate::numerics::{linear_from_srgb, srgb_from_linear};

/// Most lookups along the longer axis of a footprint (anisotropic filtering).
const MOST_TAPS: f32 = 4.0;

/// Wrap mode: the texture beyond its border (glTF 2.0, 5.26: `wrapS`, `wrapT`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Wrap {
    /// The texture is repeated.
    #[default]
    Repeat,
    /// The border texels are repeated.
    Clamp,
    /// The texture is repeated, mirrored every second time.
    Mirror,
}

/// Reading mode of a picture's texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Reading {
    /// Whether RGB is sRGB-coded (colours) or linear (normals, roughness).
    pub srgb: bool,
    /// Wrap modes along u and v.
    pub wrap: [Wrap; 2],
}

/// An 8-bit texture and its mip levels.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Texels per row.
    pub width: u32,
    /// Rows; row 0 is at v = 0.
    pub height: u32,
    /// RGBA texels.
    pub rgba: Vec<[u8; 4]>,
    /// Reading mode.
    pub reading: Reading,
    /// Mip levels, each half as large as the previous one, down to one texel.
    coarser: Vec<Level>,
}

/// A mip level.
#[derive(Debug, Clone)]
struct Level {
    width: u32,
    height: u32,
    rgba: Vec<[u8; 4]>,
}

/// The area of a texture that one lookup covers: a parallelogram in texture coordinates.
#[derive(Debug, Clone, Copy, Default)]
pub struct Footprint {
    /// Its longer side.
    pub major: Vec2,
    /// Its shorter side.
    pub minor: Vec2,
}

impl Texture {
    /// From texels in row order, with repeat as the wrap mode.
    pub fn new(width: u32, height: u32, rgba: Vec<[u8; 4]>, srgb: bool) -> Self {
        let wrap = [Wrap::Repeat; 2];
        Self::read_as(width, height, rgba, Reading { srgb, wrap })
    }

    /// From texels in row order.
    pub fn read_as(width: u32, height: u32, rgba: Vec<[u8; 4]>, reading: Reading) -> Self {
        let srgb = reading.srgb;
        let mut coarser: Vec<Level> = Vec::new();
        let (mut w, mut h) = (width, height);
        while w > 1 || h > 1 {
            let next = match coarser.last() {
                None => halved(w, h, &rgba, srgb),
                Some(level) => halved(w, h, &level.rgba, srgb),
            };
            (w, h) = (next.width, next.height);
            coarser.push(next);
        }
        Self {
            width,
            height,
            rgba,
            reading,
            coarser,
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> u64 {
        let levels = self.coarser.iter().map(|level| level.rgba.as_slice());
        std::iter::once(self.rgba.as_slice())
            .chain(levels)
            .map(|texels| size_of_val(texels) as u64)
            .sum()
    }

    /// Upper bound on the memory of a texture with `texels` texels, bytes.
    pub(super) fn bytes_of(texels: u64) -> u64 {
        // Mip levels add a third, and for a single row as much again.
        texels.saturating_mul(8)
    }

    /// Bilinear lookup: linear RGB and alpha, 0..=1.
    pub fn sample(&self, uv: Vec2) -> [f32; 4] {
        bilinear(self.width, self.height, &self.rgba, self.reading, uv).to_array()
    }

    /// Mean over a footprint, linear RGB and alpha, 0..=1: trilinear, with several lookups along its longer side.
    pub fn sample_over(&self, uv: Vec2, footprint: &Footprint) -> [f32; 4] {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let long = (footprint.major * size).length();
        if long.is_nan() || long <= 1.0 {
            return self.sample(uv);
        }
        let short = (footprint.minor * size).length().max(1.0);
        let n = (long / short).ceil().clamp(1.0, MOST_TAPS);
        let lod = (long / n).max(short).log2();
        let mut sum = Vec4::ZERO;
        for i in 0..n as u32 {
            let along = (i as f32 + 0.5) / n - 0.5;
            sum += self.trilinear(uv + footprint.major * along, lod) / n;
        }
        sum.to_array()
    }

    fn trilinear(&self, uv: Vec2, lod: f32) -> Vec4 {
        let lod = lod.clamp(0.0, self.coarser.len() as f32);
        let fine = lod as usize;
        let part = lod - fine as f32;
        let a = self.level(uv, fine);
        if part == 0.0 {
            return a;
        }
        let b = self.level(uv, fine + 1);
        a + (b - a) * part
    }

    fn level(&self, uv: Vec2, level: usize) -> Vec4 {
        match level.checked_sub(1).and_then(|i| self.coarser.get(i)) {
            None => bilinear(self.width, self.height, &self.rgba, self.reading, uv),
            Some(level) => bilinear(level.width, level.height, &level.rgba, self.reading, uv),
        }
    }
}

impl Wrap {
    /// The two of `n` texels next to a coordinate, and the weight of the second.
    fn pair(self, x: f32, n: u32) -> (usize, usize, f32) {
        let x = if x.is_finite() { x } else { 0.0 };
        let inside = match self {
            Self::Repeat => x - floor(x),
            Self::Clamp => x.clamp(0.0, 1.0),
            // A mirrored texture repeats with twice the period; the second half is reversed.
            Self::Mirror => {
                let twice = x - 2.0 * floor(0.5 * x);
                twice.min(2.0 - twice)
            }
        };
        let x = inside * n as f32 - 0.5;
        // At least -0.5: rounding towards zero is rounding down, but for that.
        let at = x as i64 - i64::from(x < 0.0);
        let last = n as usize - 1;
        let (a, b) = match self {
            // Indices -1 and `last` wrap around to the other end.
            Self::Repeat if at < 0 || at as usize >= last => (last, 0),
            // At both ends, a mirrored texture also continues with the border texel.
            _ => (at.max(0) as usize, (at + 1).min(last as i64) as usize),
        };
        (a.min(last), b, x - at as f32)
    }
}

/// The largest whole number that is not larger, of any finite one. Without SSE 4.1 the library's is a call.
fn floor(x: f32) -> f32 {
    // From 2^23 on all numbers are whole.
    if x.abs() >= 8_388_608.0 {
        return x;
    }
    let towards_zero = x as i32 as f32;
    towards_zero - if towards_zero > x { 1.0 } else { 0.0 }
}

fn bilinear(width: u32, height: u32, rgba: &[[u8; 4]], reading: Reading, uv: Vec2) -> Vec4 {
    let [across, down] = reading.wrap;
    let (left, right, fx) = across.pair(uv.x, width);
    let (top, bottom, fy) = down.pair(uv.y, height);
    let row = |y: usize| &rgba[y * width as usize..][..width as usize];
    let (top, bottom) = (row(top), row(bottom));
    let texel = |texel: [u8; 4]| Vec4::from(decoded(texel, reading.srgb));
    let between = |row: &[[u8; 4]]| texel(row[left]) * (1.0 - fx) + texel(row[right]) * fx;
    between(top) * (1.0 - fy) + between(bottom) * fy
}

fn decoded(texel: [u8; 4], srgb: bool) -> [f32; 4] {
    let linear = Vec4::from(texel.map(f32::from)) / 255.0;
    if srgb {
        let [r, g, b, _] = texel;
        let [r, g, b] = [r, g, b].map(linear_from_srgb);
        [r, g, b, linear.w]
    } else {
        linear.to_array()
    }
}

/// A mip level of half the size, rounded up: each texel is the mean of two to three by two to three texels, with
/// colours weighted by alpha.
fn halved(width: u32, height: u32, rgba: &[[u8; 4]], srgb: bool) -> Level {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let span = |i: u32, n: u32, of: u32| {
        let at = |i: u32| (u64::from(i) * u64::from(of) / u64::from(n)) as usize;
        at(i)..at(i + 1)
    };
    let mean = |x: u32, y: u32| {
        let (mut sum, mut plain, mut alpha, mut n) = ([0.0; 3], [0.0; 3], 0.0, 0.0);
        for row in span(y, h, height) {
            let columns = span(x, w, width);
            let first = row * width as usize;
            for &texel in &rgba[first + columns.start..first + columns.end] {
                let [r, g, b, a] = decoded(texel, srgb);
                for (i, c) in [r, g, b].into_iter().enumerate() {
                    sum[i] += c * a;
                    plain[i] += c;
                }
                alpha += a;
                n += 1.0_f32;
            }
        }
        // Colours of transparent texels are ignored; other data is not weighted by alpha.
        let color = if srgb && alpha > 0.0 {
            sum.map(|c| c / alpha)
        } else {
            plain.map(|c| c / n)
        };
        let code = |c: f32| match srgb {
            true => srgb_from_linear(c),
            false => (c * 255.0).round() as u8,
        };
        let [r, g, b] = color.map(code);
        [r, g, b, (alpha / n * 255.0).round() as u8]
    };
    Level {
        width: w,
        height: h,
        rgba: (0..h)
            .flat_map(|y| (0..w).map(move |x| (x, y)))
            .map(|(x, y)| mean(x, y))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn checker(side: u32) -> Texture {
        let texel = |i: u32| match (i % side + i / side) % 2 {
            0 => [0, 0, 0, 255],
            _ => [255; 4],
        };
        Texture::new(side, side, (0..side * side).map(texel).collect(), false)
    }

    #[test]
    fn textures_wrap_and_interpolate() {
        let texture = Texture::new(2, 1, vec![[0, 0, 0, 255], [255, 255, 255, 0]], false);
        // Texel centres lie at (i + 0.5) / n.
        assert_eq!(texture.sample(Vec2::new(0.25, 0.5))[0], 0.0);
        assert_eq!(texture.sample(Vec2::new(0.75, 0.5))[0], 1.0);
        assert_eq!(texture.sample(Vec2::new(0.5, 0.5))[0], 0.5);
        assert_eq!(texture.sample(Vec2::new(-0.25, 0.5))[0], 1.0);
        let nowhere = Vec2::new(f32::NAN, f32::INFINITY);
        assert!(texture.sample(nowhere).iter().all(|c| c.is_finite()));
    }

    #[test]
    fn beyond_the_border_lies_what_the_file_says() {
        let texels = vec![[0, 0, 0, 255], [100, 0, 0, 255], [200, 0, 0, 255]];
        let sample = |wrap: Wrap, u: f32| {
            let reading = Reading {
                srgb: false,
                wrap: [wrap, Wrap::Repeat],
            };
            let texture = Texture::read_as(3, 1, texels.clone(), reading);
            (texture.sample(Vec2::new(u, 0.5))[0] * 255.0).round() as u8
        };
        let [first, second, third] = [1.0 / 6.0, 0.5, 5.0 / 6.0];
        for (wrap, u, expected) in [
            (Wrap::Repeat, 1.0 + first, 0),
            (Wrap::Repeat, -first, 200),
            (Wrap::Repeat, 0.0, 100),
            (Wrap::Clamp, 1.0 + first, 200),
            (Wrap::Clamp, 1e9, 200),
            (Wrap::Clamp, -first, 0),
            (Wrap::Clamp, 0.0, 0),
            (Wrap::Mirror, 1.0 + first, 200),
            (Wrap::Mirror, 1.0 + third, 0),
            (Wrap::Mirror, -second, 100),
            (Wrap::Mirror, -third, 200),
            (Wrap::Mirror, 2.0 + third, 200),
            (Wrap::Mirror, 1.0, 200),
        ] {
            assert_eq!(sample(wrap, u), expected, "{wrap:?} {u}");
        }
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for u in [first, second, third] {
                assert_eq!(sample(wrap, u), sample(Wrap::Repeat, u), "{wrap:?} {u}");
            }
            for u in [
                f32::NAN,
                f32::INFINITY,
                -1e38,
                1e38,
                f32::MIN_POSITIVE,
                -f32::MIN_POSITIVE,
            ] {
                sample(wrap, u);
            }
        }
    }

    #[test]
    fn a_footprint_of_many_texels_sees_their_mean() {
        let texture = checker(64);
        let uv = Vec2::new(0.3, 0.7);
        let over = |major: f32, minor: f32| {
            let footprint = Footprint {
                major: Vec2::X * major,
                minor: Vec2::Y * minor,
            };
            texture.sample_over(uv, &footprint)[0]
        };
        // The mean of whole squares of a checkerboard, and of a line of squares, is one half up to 8-bit rounding.
        for (major, minor) in [(8.0 / 64.0, 8.0 / 64.0), (1.0, 1.0), (1.0, 2.0 / 64.0)] {
            let got = over(major, minor);
            assert!((got - 0.5).abs() < 1.0 / 128.0, "{major} {minor}: {got}");
        }
        // A footprint of one texel or less is a plain lookup.
        assert_eq!(over(1.0 / 64.0, 0.0), texture.sample(uv)[0]);
    }

    #[test]
    fn what_is_not_there_has_no_colour() {
        let texels = vec![[255, 0, 0, 255], [0, 255, 0, 0]];
        let texture = Texture::new(2, 1, texels, true);
        let whole = Footprint {
            major: Vec2::X * 2.0,
            minor: Vec2::Y * 2.0,
        };
        let [r, g, _, a] = texture.sample_over(Vec2::splat(0.5), &whole);
        assert!(
            r == 1.0 && g == 0.0 && (a - 0.5).abs() < 0.01,
            "{r} {g} {a}"
        );
    }

    proptest! {
        #[test]
        fn any_size_has_levels_of_its_mean(w in 1u32..40, h in 1u32..40, value in any::<u8>()) {
            let texture = Texture::new(w, h, vec![[value; 4]; (w * h) as usize], false);
            prop_assert!(texture.bytes() <= Texture::bytes_of(u64::from(w * h)) + 64);
            let all = Footprint { major: Vec2::X * 9.0, minor: Vec2::Y * 9.0 };
            let [r, _, _, a] = texture.sample_over(Vec2::new(0.1, 0.9), &all);
            prop_assert!((r - f32::from(value) / 255.0).abs() < 1e-6 && (a - r).abs() < 1e-6);
        }
    }
}

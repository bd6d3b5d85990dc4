//! Procedural colours of the room's surfaces.
//!
//! A [`Pattern`] maps a point of a surface to linear Rec.709. The point is given both as 0..1 across the surface
//! and in metres (u to the right, v up, seen from outside). In the functions for pictures v points down, as in an
//! image. All patterns use one value noise, so textures need no files.

use glam::{Vec2, Vec3};

use ghostlight::numerics::{hash, linear_from_srgb};

/// Linear colour of an sRGB hex code.
pub(super) fn srgb(code: u32) -> Vec3 {
    let [_, r, g, b] = code.to_be_bytes();
    Vec3::new(
        linear_from_srgb(r),
        linear_from_srgb(g),
        linear_from_srgb(b),
    )
}

/// Colour pattern of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) enum Pattern {
    /// One colour.
    Flat(Vec3),
    /// One colour with faint mottling: paint, plastic, paper.
    Mottled(Vec3, u32),
    /// Boards along u.
    Wood {
        /// Early wood.
        light: Vec3,
        /// Late wood.
        dark: Vec3,
        /// Width of a board, metres.
        board: f32,
        /// Seed of the grain.
        seed: u32,
    },
    /// Strips laid in rows with staggered ends.
    Parquet,
    /// Painted plaster.
    Plaster(Vec3),
    /// Edges of a book's pages, lines along u.
    Pages(u32),
    /// A book's spine: bands and a label.
    Spine(Vec3, Vec3, u32),
    /// A book's front.
    Cover(Vec3, Vec3, u32),
    /// Cork granules.
    Cork,
    /// A small photograph: sky, hills, something in front.
    Photo(u32),
    /// A page of writing, too small to read.
    Written(Vec3, u32),
    /// A puzzle cube's face.
    Stickers(u32),
    /// The picture on the monitor.
    Screen,
    /// The view outside the window.
    Outside,
    /// Glaze with a painted band.
    Mug(Vec3, Vec3),
    /// A leaf, from stalk (v = 0) to tip.
    Leaf(u32),
    /// Soil.
    Soil,
    /// Skin of an orange or apple.
    Fruit(Vec3, Vec3, u32),
    /// Woven cloth.
    Cloth(Vec3, u32),
}

/// A number in 0..1 per lattice point: two rounds of multiply and shift, which take half the time of [`hash`] and
/// still show no structure.
fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x85eb_ca6b) ^ (y as u32).wrapping_mul(0xc2b2_ae35);
    h = (h ^ seed.wrapping_mul(0x27d4_eb2f)).wrapping_mul(0x9e37_79b1);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    ((h ^ (h >> 16)) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Smooth value noise, 0..1.
pub(super) fn noise(p: Vec2, seed: u32) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let f = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let (x, y) = (cell.x as i32, cell.y as i32);
    let row = |y: i32| {
        let (a, b) = (lattice(x, y, seed), lattice(x.wrapping_add(1), y, seed));
        a + (b - a) * f.x
    };
    let (a, b) = (row(y), row(y.wrapping_add(1)));
    a + (b - a) * f.y
}

/// Noise of four octaves, 0..1.
fn fractal(p: Vec2, seed: u32) -> f32 {
    let (mut sum, mut weight, mut p) = (0.0, 0.5, p);
    for octave in 0..4 {
        sum += weight * noise(p, seed.wrapping_add(octave * 101));
        weight *= 0.5;
        p = p * 2.03 + Vec2::new(17.1, 9.2);
    }
    sum / 0.9375
}

fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn pick(seed: u32, k: u32, colours: &[u32]) -> Vec3 {
    srgb(colours[hash(seed, k, 77) as usize % colours.len()])
}

fn wood(m: Vec2, light: Vec3, dark: Vec3, board: f32, seed: u32) -> Vec3 {
    let row = (m.y / board).floor();
    let id = hash(row as i32 as u32, seed, 5);
    let tone = (id & 0xff) as f32 / 255.0;
    let m = m + Vec2::new((id >> 8 & 0xfff) as f32 * 0.01, 0.0);
    let warp = fractal(Vec2::new(m.x * 1.6, m.y * 9.0), seed) * 2.0;
    let rings = (m.y * 95.0 + warp * 7.0).sin() * 0.5 + 0.5;
    let streaks = fractal(Vec2::new(m.x * 7.0, m.y * 240.0), seed ^ 1);
    let pores = smoothstep(
        0.68,
        0.82,
        noise(Vec2::new(m.x * 55.0, m.y * 1100.0), seed ^ 2),
    );
    let mix = (0.22 * rings + 0.55 * streaks + 0.30 * tone + 0.06).clamp(0.0, 1.0);
    let joint = smoothstep(
        0.0,
        0.0012,
        (m.y - row * board).min((row + 1.0) * board - m.y),
    );
    light.lerp(dark, mix) * (1.0 - 0.22 * pores) * (0.72 + 0.28 * joint)
}

fn photo(uv: Vec2, seed: u32) -> Vec3 {
    let margin = uv.x.min(uv.y).min(1.0 - uv.x).min(1.0 - uv.y);
    if margin < 0.055 {
        return srgb(0xf1efe8);
    }
    let warm = seed.is_multiple_of(3);
    let (top, low) = if warm {
        (srgb(0xe8a25a), srgb(0xf6d9a0))
    } else {
        (srgb(0x4f86b8), srgb(0xbfd9e6))
    };
    let mut c = top.lerp(low, smoothstep(0.05, 0.65, uv.y));
    let sun = (uv - Vec2::new(0.3 + 0.1 * (seed % 5) as f32, 0.28)).length();
    c = c.lerp(srgb(0xfff3cf), smoothstep(0.09, 0.06, sun));
    for layer in 0..4u32 {
        let base = 0.45 + 0.13 * layer as f32;
        let ridge = base
            - 0.16
                * fractal(
                    Vec2::new(uv.x * (2.5 + layer as f32), 3.0 * layer as f32),
                    seed + layer,
                );
        let shade = pick(
            seed,
            layer,
            &[0x5f7f6a, 0x3d5d4a, 0x6b7a4d, 0x48606e, 0x2d4738, 0x7c6a4a],
        );
        if uv.y > ridge {
            let detail = 0.75 + 0.5 * fractal(uv * Vec2::new(40.0, 55.0), seed + 9 + layer);
            c = shade * detail;
        }
    }
    c
}

fn screen(uv: Vec2) -> Vec3 {
    // A wallpaper under two windows and a bar.
    let dune =
        |k: f32, h: f32| h - 0.12 * (uv.x * 4.0 + k).sin() - 0.05 * (uv.x * 9.0 + 2.0 * k).sin();
    let mut c = srgb(0x1f4e79).lerp(srgb(0xf2a65a), smoothstep(0.0, 0.75, uv.y));
    for (k, colour) in [0xb85c38u32, 0x8c3f33, 0x5c2a3a, 0x2e1a33]
        .iter()
        .enumerate()
    {
        let k = k as f32;
        if uv.y > dune(k * 1.7, 0.55 + 0.12 * k) {
            c = srgb(*colour) * (1.15 - 0.5 * uv.y);
        }
    }
    if uv.y > 0.955 {
        return if (uv.x * 24.0).fract() < 0.6 && uv.x < 0.4 && (0.965..0.99).contains(&uv.y) {
            pick(
                (uv.x * 24.0) as u32,
                3,
                &[0x4aa3df, 0xe0a030, 0x58b368, 0xd9534f, 0xcccccc],
            )
        } else {
            srgb(0x20242b)
        };
    }
    for (window, (lo, hi)) in [
        (Vec2::new(0.05, 0.08), Vec2::new(0.60, 0.84)),
        (Vec2::new(0.64, 0.16), Vec2::new(0.94, 0.62)),
    ]
    .into_iter()
    .enumerate()
    {
        let w = (uv - lo) / (hi - lo);
        if w.min_element() < 0.0 || w.max_element() > 1.0 {
            continue;
        }
        if w.y < 0.05 {
            return srgb(if window == 0 { 0x3a3f4b } else { 0xd8dbe0 });
        }
        if window == 1 {
            // A chart.
            let bar = (w.x * 8.0).floor();
            let height = 0.25 + 0.6 * lattice(bar as i32, 0, 4);
            let inside = (w.x * 8.0).fract() < 0.7 && w.y > 0.95 - 0.75 * height && w.y < 0.95;
            return if inside {
                srgb(0x2f7fb8)
            } else {
                srgb(0xf4f5f7)
            };
        }
        let line = ((w.y - 0.07) * 34.0).floor();
        let in_line = ((w.y - 0.07) * 34.0).fract() < 0.55;
        let indent = 0.06 + 0.05 * (lattice(line as i32, 0, 8) * 4.0).floor();
        let length = 0.15 + 0.6 * lattice(line as i32, 1, 8);
        let word = (w.x * 26.0 + 3.0 * lattice(line as i32, 2, 8)).floor();
        let gap = lattice(word as i32, line as i32, 9) < 0.22;
        if in_line
            && !gap
            && w.x > indent
            && w.x < indent + length
            && lattice(line as i32, 3, 8) > 0.12
        {
            return pick(
                word as u32,
                line as u32,
                &[0x8fd3ff, 0xc3e88d, 0xf78c6c, 0xd0d6e2, 0xc792ea],
            );
        }
        return srgb(0x22262f);
    }
    c
}

fn outside(uv: Vec2) -> Vec3 {
    // A garden out of focus under a bright sky: leaves are discs of light.
    let cloud = fractal(uv * Vec2::new(3.0, 5.0), 31);
    let mut c = Vec3::new(0.72, 0.88, 1.10).lerp(Vec3::new(1.0, 1.02, 1.05), cloud);
    let crown = 0.62 + 0.20 * (fractal(Vec2::new(uv.x * 3.5, 0.0), 32) - 0.5);
    let leaves = fractal(uv * 9.0, 33);
    let tree = srgb(0x35572b).lerp(srgb(0x9dbb62), smoothstep(0.3, 0.75, leaves));
    c = c.lerp(tree * 0.75, smoothstep(crown - 0.05, crown + 0.06, uv.y));
    for k in 0..60 {
        let at = Vec2::new(lattice(k, 0, 35), 0.55 + 0.45 * lattice(k, 1, 35));
        let radius = 0.020 + 0.024 * lattice(k, 2, 35);
        let disc = smoothstep(radius, radius * 0.55, (uv - at).length());
        let shine = srgb(0xb9cf84).lerp(srgb(0xf2f3d8), lattice(k, 3, 35));
        c = c.lerp(shine, 0.22 * disc * smoothstep(crown, crown + 0.1, at.y));
    }
    c
}

impl Pattern {
    /// Linear colour at `uv` (0..1 across the surface) and `m` (metres across it).
    pub(super) fn colour(&self, uv: Vec2, m: Vec2) -> Vec3 {
        match *self {
            Self::Flat(c) => c,
            Self::Mottled(c, seed) => {
                c * (0.93 + 0.10 * fractal(m * 90.0, seed) + 0.04 * noise(m * 900.0, seed ^ 3))
            }
            Self::Wood {
                light,
                dark,
                board,
                seed,
            } => wood(m, light, dark, board, seed),
            Self::Parquet => {
                let row = (m.y / 0.085).floor();
                let shift = lattice(row as i32, 0, 61) * 0.7;
                let strip = ((m.x + shift) / 0.7).floor();
                let id = hash(row as i32 as u32, strip as i32 as u32, 62);
                let along = (m.x + shift) - strip * 0.7;
                let local = Vec2::new(m.x, m.y - row * 0.085 + (id % 977) as f32 * 3.0 * 0.085);
                let end = smoothstep(0.0, 0.0015, along.min(0.7 - along));
                wood(local, srgb(0xb98a58), srgb(0x7a5230), 0.085, id & 0xff) * (0.6 + 0.4 * end)
            }
            Self::Plaster(c) => {
                let large = fractal(m * 1.5, 71);
                let roller = fractal(m * Vec2::new(160.0, 140.0), 72);
                c * (0.93 + 0.06 * large + 0.09 * (roller - 0.5) + 0.03)
            }
            Self::Pages(seed) => {
                let sheet = noise(Vec2::new(m.x * 12.0, m.y * 2600.0), seed);
                srgb(0xe6dcc2) * (0.74 + 0.26 * sheet)
            }
            Self::Spine(base, accent, seed) => {
                let band = |lo: f32, hi: f32| uv.y > lo && uv.y < hi;
                let style = hash(seed, 0, 81) % 4;
                let wear = 0.9 + 0.2 * (fractal(m * Vec2::new(60.0, 140.0), seed) - 0.5);
                let mark = band(0.80, 0.815)
                    || band(0.835, 0.84)
                    || band(0.10, 0.115)
                    || (style == 1 && band(0.45, 0.72) && (0.14..0.86).contains(&uv.x))
                    || (style == 2 && band(0.55, 0.78));
                // Strokes in place of a title, along the spine.
                let stroke = (uv.y * 46.0).floor();
                let title = band(0.28, 0.70)
                    && (uv.x - 0.5).abs() < 0.17
                    && (uv.y * 46.0).fract() < 0.72
                    && lattice(stroke as i32, 1, seed) > 0.25
                    && noise(Vec2::new(uv.x * 14.0, uv.y * 150.0), seed ^ 5) > 0.42;
                let c = if mark { accent } else { base };
                (if title {
                    base.lerp(srgb(0xf4ecd6), if mark { 0.1 } else { 0.75 })
                } else {
                    c
                }) * wear
            }
            Self::Cover(base, accent, seed) => {
                let wear = 0.94 + 0.12 * (fractal(m * 50.0, seed) - 0.5);
                let centre = Vec2::new(0.5, 0.62);
                let ring = (uv - centre).length();
                let block = (0.12..0.88).contains(&uv.x) && (0.12..0.30).contains(&uv.y);
                let shape = match hash(seed, 1, 82) % 3 {
                    0 => ring < 0.22,
                    1 => ((uv.x + uv.y) * 7.0).fract() < 0.4 && (0.40..0.88).contains(&uv.y),
                    _ => (uv.x - 0.5).abs() + (uv.y - 0.62).abs() < 0.26,
                };
                (if block || shape { accent } else { base }) * wear
            }
            Self::Cork => {
                let grains = noise(m * 420.0, 91) * 0.6 + noise(m * 180.0, 92) * 0.4;
                let dark = smoothstep(0.72, 0.85, noise(m * 240.0, 93));
                srgb(0xc79a66) * (0.66 + 0.55 * grains) * (1.0 - 0.5 * dark)
            }
            Self::Photo(seed) => photo(Vec2::new(uv.x, 1.0 - uv.y), seed),
            Self::Written(paper, seed) => {
                let uv = Vec2::new(uv.x, 1.0 - uv.y);
                let line = (m.y / 0.0072).floor();
                let in_line = ((m.y / 0.0072).fract() - 0.5).abs() < 0.22;
                let letters = noise(Vec2::new(m.x * 850.0, line * 7.3), seed) > 0.45
                    && noise(Vec2::new(m.x * 120.0, line * 3.1), seed ^ 1) > 0.24;
                let end = 0.70 + 0.22 * lattice(line as i32, 0, seed);
                let ink = in_line
                    && letters
                    && uv.x > 0.10
                    && uv.x < end
                    && (0.07..0.90).contains(&uv.y)
                    && lattice(line as i32, 1, seed) > 0.12;
                let tone = 0.95 + 0.07 * fractal(m * 40.0, seed);
                (if ink { paper * 0.22 } else { paper }) * tone
            }
            Self::Stickers(seed) => {
                let cell = (uv * 3.0).floor();
                let f = (uv * 3.0 - cell - 0.5).abs();
                if f.max_element() > 0.43 {
                    return srgb(0x17181a);
                }
                let k = (cell.x + 3.0 * cell.y) as u32;
                pick(
                    seed,
                    k,
                    &[0xc3252b, 0x1f6fb5, 0x2c9b4b, 0xf2c230, 0xe77a25, 0xeeeeea],
                )
            }
            Self::Screen => screen(Vec2::new(uv.x, 1.0 - uv.y)),
            Self::Outside => outside(Vec2::new(uv.x, 1.0 - uv.y)),
            Self::Mug(base, band) => {
                // Height is measured along the profile, from the middle of the bottom outwards.
                if (0.066..0.104).contains(&m.y) {
                    let cell = Vec2::new((uv.x * 14.0).fract() - 0.5, (m.y - 0.085) / 0.019);
                    if cell.length() < 0.36 { base } else { band }
                } else {
                    base
                }
            }
            Self::Leaf(seed) => {
                let rib = (uv.x - 0.5).abs();
                let veins = ((uv.y * 14.0 - rib * 9.0).fract() - 0.5).abs();
                let c =
                    srgb(0x2f6b34).lerp(srgb(0x6fa04a), fractal(uv * Vec2::new(3.0, 5.0), seed));
                let tone = 0.8 + 0.4 * lattice(seed as i32, 0, 7);
                c * tone
                    * (1.0 + 0.35 * smoothstep(0.05, 0.0, rib) + 0.12 * smoothstep(0.1, 0.0, veins))
            }
            Self::Soil => {
                srgb(0x3b2a1e) * (0.5 + noise(m * 350.0, 41) + 0.5 * noise(m * 900.0, 42))
            }
            Self::Fruit(a, b, seed) => {
                let spots = smoothstep(0.7, 0.85, noise(uv * Vec2::new(120.0, 60.0), seed));
                a.lerp(b, fractal(uv * Vec2::new(6.0, 4.0), seed)) * (1.0 + 0.15 * spots)
            }
            Self::Cloth(c, seed) => {
                let weave = (m.x * 2200.0).sin() * (m.y * 2200.0).sin();
                c * (0.9 + 0.12 * weave + 0.2 * (fractal(m * 60.0, seed) - 0.5))
            }
        }
    }
}

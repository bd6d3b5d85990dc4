//! The room: a desk beside a window, and the objects on it.
//!
//! World axes: x right along the desk, y away from the viewer, z up; metres. The origin is on the floor, below
//! the centre of the desk. The middle of the desk is left free for virtual objects: [`FREE_SPOT`].

use glam::{DAffine3, DVec2, DVec3, Vec3};

use super::geometry::{Geometry, Material};
use super::light::RoomLight;
use super::solid::Builder;
use super::texture::{Pattern, srgb};
use super::things::{books, keyboard, lamp, monitor, mug, plant, small_things};
use ghostlight::numerics::uniform;

/// Height of the desk top, metres.
pub(super) const DESK_Z: f64 = 0.75;

/// Height of the ceiling, metres.
pub(super) const CEILING_Z: f64 = 2.5;

/// Centre of the free part of the desk: a square of 0.35 m with 0.2 m of free space above it.
pub(super) const FREE_SPOT: DVec3 = DVec3::new(0.10, 0.55, DESK_Z);

/// Distance between irradiance sites on the desk, metres; this is the resolution of shadow edges.
pub(super) const FINE_M: f64 = 0.007;
const MEDIUM_M: f64 = 0.015;
const COARSE_M: f64 = 0.08;

/// The room, unlit.
pub(super) struct Room {
    /// Surfaces.
    pub(super) geometry: Geometry,
    /// Lights, in the order of the manifest.
    pub(super) lights: Vec<RoomLight>,
}

pub(super) fn at(x: f64, y: f64, z: f64, yaw_deg: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
        * DAffine3::from_rotation_z(yaw_deg.to_radians())
}

/// A deterministic variation within a range, for the sizes of a series of objects.
pub(super) fn vary(k: u32, dimension: u32, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * f64::from(uniform(k, 9, dimension))
}

/// Builds the room. `coarseness` multiplies the spacing of irradiance sites (1 is full quality).
pub(super) fn build(coarseness: f64) -> Room {
    let mut b = Builder {
        coarseness,
        ..Builder::default()
    };
    let mut lights = Vec::new();
    shell(&mut b, &mut lights);
    desk(&mut b);
    monitor(&mut b, &mut lights);
    keyboard(&mut b);
    mug(&mut b);
    books(&mut b);
    lamp(&mut b, &mut lights);
    plant(&mut b, &at(0.06, 0.885, DESK_Z, 0.0));
    small_things(&mut b);
    pin_board(&mut b);
    lights.push(RoomLight::Sphere {
        name: "ceiling globe",
        centre: DVec3::new(-0.95, -0.30, 2.14),
        radius: 0.13,
        intensity: Vec3::new(88.0, 82.5, 72.5),
        in_room: false,
    });
    Room {
        geometry: Geometry::new(b),
        lights,
    }
}

fn shell(b: &mut Builder, lights: &mut Vec<RoomLight>) {
    let (x0, x1, y0, y1, top) = (-1.75, 1.85, -2.6, 1.0, CEILING_Z);
    let accent = b.material(Material::matte(Pattern::Plaster(srgb(0xa9b8b4))));
    let white = b.material(Material::matte(Pattern::Plaster(srgb(0xe4dfd3))));
    let floor = b.material(Material::matte(Pattern::Parquet).glossy(0.04, 0.10));
    let paint = b.material(Material::matte(Pattern::Mottled(srgb(0xefeee9), 3)).glossy(0.03, 0.12));
    let (w, d) = (DVec3::X * (x1 - x0), DVec3::Y * (y1 - y0));
    b.rectangle(DVec3::new(x0, y0, 0.0), w, d, floor, COARSE_M / 2.0);
    b.rectangle(DVec3::new(x0, y0, top), d, w, white, COARSE_M);
    let up = DVec3::Z * top;
    b.rectangle(DVec3::new(x0, y0, 0.0), d, up, white, COARSE_M);
    b.rectangle(DVec3::new(x1, y1, 0.0), -d, up, white, COARSE_M);
    b.rectangle(DVec3::new(x1, y0, 0.0), -w, up, white, COARSE_M);

    // The back wall around the window.
    let (wx0, wx1, wz0, wz1, reveal) = (-1.02, -0.18, 1.17, 2.15, 0.16);
    let mut wall = |xa: f64, xb: f64, za: f64, zb: f64, texel: f64| {
        b.rectangle(
            DVec3::new(xa, y1, za),
            DVec3::X * (xb - xa),
            DVec3::Z * (zb - za),
            accent,
            texel,
        );
    };
    wall(x0, x1, 0.0, DESK_Z, COARSE_M / 2.0);
    wall(x0, wx0, DESK_Z, top, MEDIUM_M);
    wall(wx1, x1, DESK_Z, 1.7, FINE_M);
    wall(wx1, x1, 1.7, top, COARSE_M);
    wall(wx0, wx1, DESK_Z, wz0, MEDIUM_M);
    wall(wx0, wx1, wz1, top, COARSE_M);
    let back = y1 + reveal;
    let (dx, dz, dy) = (
        DVec3::X * (wx1 - wx0),
        DVec3::Z * (wz1 - wz0),
        DVec3::Y * reveal,
    );
    b.rectangle(DVec3::new(wx0, y1, wz0), dx, dy, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx0, y1, wz1), dy, dx, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx0, y1, wz0), dy, dz, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx1, back, wz0), -dy, dz, paint, MEDIUM_M);
    let radiance = Vec3::new(17.0, 18.4, 20.5);
    let sky = b.material(Material {
        emission: Some(radiance),
        sampled_light: true,
        ..Material::matte(Pattern::Outside).infrared(0.0)
    });
    let (origin, e1, e2) = (DVec3::new(wx0, back, wz0), dx, dz);
    b.rectangle(origin, e1, e2, sky, COARSE_M);
    lights.push(RoomLight::Rectangle {
        name: "window",
        origin,
        e1,
        e2,
        radiance,
        pattern: Pattern::Outside,
    });
    // Sash, casement bars and sill.
    let bar = |b: &mut Builder, x: f64, z: f64, w: f64, h: f64| {
        b.chamfered_box(
            &at(x, y1 + 0.10, z, 0.0),
            DVec3::new(w, 0.05, h),
            0.004,
            [paint; 6],
            0.03,
        );
    };
    let (cx, width, height) = ((wx0 + wx1) / 2.0, wx1 - wx0, wz1 - wz0);
    bar(b, wx0 + 0.025, wz0, 0.05, height);
    bar(b, wx1 - 0.025, wz0, 0.05, height);
    bar(b, cx, wz0 + 0.05, 0.06, height - 0.10);
    bar(b, cx, wz0, width - 0.10, 0.05);
    bar(b, cx, wz1 - 0.05, width - 0.10, 0.05);
    b.chamfered_box(
        &at(cx, y1 - 0.02, wz0 - 0.03, 0.0),
        DVec3::new(width + 0.10, 0.16, 0.03),
        0.004,
        [paint; 6],
        MEDIUM_M,
    );
    // A pot on the sill.
    plant(
        b,
        &(at(-0.86, y1 - 0.015, wz0, 40.0) * DAffine3::from_scale(DVec3::splat(0.55))),
    );
}

fn desk(b: &mut Builder) {
    let top = b.material(
        Material::matte(Pattern::Wood {
            light: srgb(0xd9b384),
            dark: srgb(0x8a5c36),
            board: 0.122,
            seed: 11,
        })
        .glossy(0.04, 0.09),
    );
    let front = b.material(Material::matte(Pattern::Mottled(srgb(0xd9d6cd), 4)));
    let metal = b.material(Material::matte(Pattern::Mottled(srgb(0x50545a), 5)).glossy(0.05, 0.1));
    b.chamfered_box(
        &at(0.0, 0.62, DESK_Z - 0.032, 0.0),
        DVec3::new(1.84, 0.74, 0.032),
        0.003,
        [top; 6],
        FINE_M,
    );
    for x in [-0.86, 0.86] {
        for y in [0.30, 0.94] {
            b.chamfered_box(
                &at(x, y, 0.0, 0.0),
                DVec3::new(0.05, 0.05, DESK_Z - 0.0325),
                0.003,
                [metal; 6],
                0.04,
            );
        }
    }
    // Drawers under the right half.
    b.chamfered_box(
        &at(0.58, 0.64, 0.12, 0.0),
        DVec3::new(0.42, 0.62, DESK_Z - 0.0325 - 0.12),
        0.004,
        [front; 6],
        0.03,
    );
    for k in 0..3 {
        let z = 0.14 + 0.185 * f64::from(k);
        b.chamfered_box(
            &at(0.58, 0.322, z, 0.0),
            DVec3::new(0.40, 0.018, 0.175),
            0.003,
            [front; 6],
            0.02,
        );
        b.chamfered_box(
            &at(0.58, 0.300, z + 0.12, 0.0),
            DVec3::new(0.14, 0.012, 0.012),
            0.002,
            [metal; 6],
            0.02,
        );
    }
}

pub(super) fn profile(points: &[(f64, f64)]) -> Vec<DVec2> {
    points.iter().map(|&(r, z)| DVec2::new(r, z)).collect()
}

/// Points on an arc of a profile, from angle `a` to `b` (degrees, 0 outwards, 90 up).
pub(super) fn arc(centre: (f64, f64), radius: f64, a: f64, b: f64, steps: u32) -> Vec<(f64, f64)> {
    (0..=steps)
        .map(|i| {
            let angle = (a + (b - a) * f64::from(i) / f64::from(steps)).to_radians();
            let r = centre.0 + radius * angle.cos();
            (
                if r.abs() < 1e-12 { 0.0 } else { r },
                centre.1 + radius * angle.sin(),
            )
        })
        .collect()
}

fn pin_board(b: &mut Builder) {
    let cork = b.material(Material::matte(Pattern::Cork));
    let frame = b.material(
        Material::matte(Pattern::Wood {
            light: srgb(0x6b4a30),
            dark: srgb(0x3d2818),
            board: 0.5,
            seed: 51,
        })
        .glossy(0.04, 0.08),
    );
    let (x0, x1, z0, z1) = (0.02, 0.86, 1.115, 1.66);
    // Boxes of which only the front and the rims are visible.
    let y = 0.9865;
    b.chamfered_box(
        &at((x0 + x1) / 2.0, y, z0, 0.0),
        DVec3::new(x1 - x0, 0.024, z1 - z0),
        0.0,
        [cork; 6],
        0.010,
    );
    for (x, z, w, h) in [
        ((x0 + x1) / 2.0, z0 - 0.022, x1 - x0 + 0.044, 0.022),
        ((x0 + x1) / 2.0, z1, x1 - x0 + 0.044, 0.022),
        (x0 - 0.011, z0, 0.022, z1 - z0),
        (x1 + 0.011, z0, 0.022, z1 - z0),
    ] {
        b.chamfered_box(
            &at(x, y - 0.002, z, 0.0),
            DVec3::new(w, 0.029, h),
            0.003,
            [frame; 6],
            0.012,
        );
    }
    let front = y - 0.012;
    let pins = [0xc0392b, 0x2f6fb0, 0xe0b030, 0x3f8f4f];
    for (k, (x, z, w, h, turn)) in [
        (0.11, 1.20, 0.128, 0.090, 4.0),
        (0.265, 1.185, 0.090, 0.125, -5.0),
        (0.415, 1.215, 0.135, 0.095, 2.0),
        (0.585, 1.19, 0.095, 0.130, 6.0),
        (0.755, 1.205, 0.130, 0.092, -3.0),
        (0.14, 1.345, 0.100, 0.140, -4.0),
        (0.33, 1.365, 0.150, 0.105, 3.0),
        (0.55, 1.375, 0.110, 0.150, -2.0),
        (0.74, 1.36, 0.140, 0.100, 5.0),
    ]
    .into_iter()
    .enumerate()
    {
        let k = k as u32;
        let pattern = match k % 4 {
            1 => Pattern::Written(srgb([0xf6e58d, 0xf7c6c7, 0xcfe8f0][k as usize % 3]), k + 60),
            _ => Pattern::Photo(k * 5 + 2),
        };
        let paper = b.material(Material::matte(pattern).glossy(0.03, 0.08));
        let rotation = DAffine3::from_rotation_y(f64::to_radians(turn));
        // Sunk slightly into the cork, so that sites of the cork below count as buried.
        let place = DAffine3::from_translation(DVec3::new(x, front - 0.0003, z)) * rotation;
        b.chamfered_box(
            &(place * DAffine3::from_translation(DVec3::Z * (-h / 2.0))),
            DVec3::new(w, 0.0008, h),
            0.0,
            [paper; 6],
            0.008,
        );
        let head = b.material(
            Material::matte(Pattern::Flat(srgb(pins[k as usize % 4]))).glossy(0.05, 0.03),
        );
        let pin = place.transform_point3(DVec3::new(0.0, -0.004, h / 2.0 - 0.010));
        b.turned(
            &DAffine3::from_translation(pin),
            &profile(&arc((0.0, 0.0), 0.0048, -90.0, 90.0, 8)),
            16,
            head,
        );
    }
}

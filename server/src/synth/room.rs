//! The room: a desk under a window, and what lies on it.
//!
//! World axes: x right along the desk, y away from the viewer, z up; metres; the origin is on
//! the floor, below the middle of the desk's line. The desk's middle is left free for virtual
//! objects: [`FREE_SPOT`].

use glam::{DAffine3, DVec2, DVec3, Vec3};

use super::light::RoomLight;
use super::solid::{Builder, Geometry, Material};
use super::texture::{Pattern, srgb};
use crate::numerics::uniform;

/// Height of the desk's top, metres.
pub(super) const DESK_Z: f64 = 0.75;

/// Middle of the free part of the desk, at least 0.36 m across.
pub(super) const FREE_SPOT: DVec3 = DVec3::new(0.10, 0.56, DESK_Z);

/// Radius around [`FREE_SPOT`] in which nothing stands, metres.
pub(super) const FREE_RADIUS_M: f64 = 0.18;

/// Distance between baked points on the desk, metres: shadows' edges are resolved this finely.
const FINE_M: f64 = 0.007;
const MEDIUM_M: f64 = 0.015;
const COARSE_M: f64 = 0.08;

/// The room, unlit.
pub(super) struct Room {
    /// Surfaces.
    pub(super) geometry: Geometry,
    /// Lights, in the order of the manifest.
    pub(super) lights: Vec<RoomLight>,
}

fn at(x: f64, y: f64, z: f64, yaw_deg: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z)) * DAffine3::from_rotation_z(yaw_deg.to_radians())
}

/// Sizes of a run of things: deterministic variation within a range.
fn vary(k: u32, dimension: u32, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * f64::from(uniform(k, 9, dimension))
}

/// Builds the room. `coarseness` widens the spacing of baked points (1 is full quality).
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
    let (x0, x1, y0, y1, top) = (-1.75, 1.85, -2.6, 1.0, 2.5);
    let accent = b.material(Material::matte(Pattern::Plaster(srgb(0xa9b8b4))));
    let white = b.material(Material::matte(Pattern::Plaster(srgb(0xe4dfd3))));
    let floor = b.material(Material::matte(Pattern::Parquet).glossy(0.04, 0.10));
    let paint = b.material(Material::matte(Pattern::Mottled(srgb(0xefeee9), 3)).glossy(0.03, 0.12));
    let (w, d) = (DVec3::X * (x1 - x0), DVec3::Y * (y1 - y0));
    b.rectangle(DVec3::new(x0, y0, 0.0), w, d, floor, COARSE_M / 2.0);
    b.rectangle(DVec3::new(x0, y0, top), d, w, white, COARSE_M);
    let up = DVec3::Z * top;
    b.rectangle(DVec3::new(x0, y1, 0.0), -d, up, white, COARSE_M);
    b.rectangle(DVec3::new(x1, y0, 0.0), d, up, white, COARSE_M);
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
    let (dx, dz, dy) = (DVec3::X * (wx1 - wx0), DVec3::Z * (wz1 - wz0), DVec3::Y * reveal);
    b.rectangle(DVec3::new(wx0, y1, wz0), dx, dy, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx0, y1, wz1), dy, dx, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx0, back, wz0), -dy, dz, paint, MEDIUM_M);
    b.rectangle(DVec3::new(wx1, y1, wz0), dy, dz, paint, MEDIUM_M);
    let radiance = Vec3::new(25.0, 27.0, 30.0);
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
    plant(b, &(at(-0.86, y1 - 0.015, wz0, 40.0) * DAffine3::from_scale(DVec3::splat(0.55))));
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

fn monitor(b: &mut Builder, lights: &mut Vec<RoomLight>) {
    let case = b.material(Material::matte(Pattern::Flat(srgb(0x2a2b2e))).glossy(0.04, 0.05).infrared(0.12));
    let foot = b.material(Material::matte(Pattern::Mottled(srgb(0x8d9094), 6)).glossy(0.2, 0.08));
    let frame = at(-0.44, 0.80, DESK_Z, 13.0);
    let shift = |x: f64, y: f64, z: f64| frame * DAffine3::from_translation(DVec3::new(x, y, z));
    b.chamfered_box(&shift(0.0, 0.02, 0.0), DVec3::new(0.24, 0.17, 0.010), 0.003, [foot; 6], FINE_M);
    b.chamfered_box(&shift(0.0, 0.045, 0.010), DVec3::new(0.05, 0.03, 0.20), 0.003, [foot; 6], 0.01);
    b.chamfered_box(&shift(0.0, 0.0, 0.095), DVec3::new(0.545, 0.035, 0.330), 0.004, [case; 6], 0.012);
    let radiance = Vec3::new(4.2, 4.6, 5.2);
    let glass = b.material(Material {
        emission: Some(radiance),
        sampled_light: true,
        ..Material::matte(Pattern::Screen).glossy(0.035, 0.012).infrared(0.006)
    });
    let (w, h) = (0.521, 0.293);
    let origin = frame.transform_point3(DVec3::new(-w / 2.0, -0.0178, 0.095 + 0.025));
    let (e1, e2) = (frame.transform_vector3(DVec3::X * w), DVec3::Z * h);
    b.rectangle(origin, e1, e2, glass, 0.03);
    lights.push(RoomLight::Rectangle {
        name: "monitor",
        origin,
        e1,
        e2,
        radiance,
        pattern: Pattern::Screen,
    });
}

fn keyboard(b: &mut Builder) {
    let case = b.material(Material::matte(Pattern::Mottled(srgb(0xb9bcc0), 7)).glossy(0.08, 0.08));
    let keys = b.material(Material::matte(Pattern::Mottled(srgb(0xe9e8e4), 8)).glossy(0.03, 0.12));
    let dark = b.material(Material::matte(Pattern::Mottled(srgb(0x5d6670), 9)).glossy(0.03, 0.12));
    let accent = b.material(Material::matte(Pattern::Mottled(srgb(0xd9673b), 9)).glossy(0.03, 0.12));
    let frame = at(-0.42, 0.475, DESK_Z, 7.0);
    b.chamfered_box(&frame, DVec3::new(0.318, 0.128, 0.012), 0.003, [case; 6], FINE_M);
    let pitch = 0.0205;
    for row in 0..6 {
        let y = -0.052 + f64::from(row) * pitch;
        let mut x = -0.1535;
        let mut column = 0;
        while x < 0.150 {
            let units = match (row, column) {
                (0, 3) => 6.0,
                (1, 0) => 2.2,
                (2, 0) => 1.7,
                (3, 0) => 1.4,
                _ => 1.0,
            };
            let width = f64::min(units * pitch, 0.1535 - x);
            if width < 0.012 {
                break;
            }
            let colour = match (row, column) {
                (5, 0) => accent,
                (_, 0) | (5, _) => dark,
                _ if width > 1.1 * pitch && row > 0 => dark,
                _ => keys,
            };
            b.chamfered_box(
                &(frame * DAffine3::from_translation(DVec3::new(x + width / 2.0, y, 0.0121))),
                DVec3::new(width - 0.0028, pitch - 0.0028, 0.0065),
                0.0016,
                [colour; 6],
                0.02,
            );
            x += width;
            column += 1;
        }
    }
}

fn profile(points: &[(f64, f64)]) -> Vec<DVec2> {
    points.iter().map(|&(r, z)| DVec2::new(r, z)).collect()
}

/// An arc of a profile, from angle `a` to `b` (degrees, 0 outwards, 90 up).
fn arc(centre: (f64, f64), radius: f64, a: f64, b: f64, steps: u32) -> Vec<(f64, f64)> {
    (0..=steps)
        .map(|i| {
            let angle = (a + (b - a) * f64::from(i) / f64::from(steps)).to_radians();
            let r = centre.0 + radius * angle.cos();
            (if r.abs() < 1e-12 { 0.0 } else { r }, centre.1 + radius * angle.sin())
        })
        .collect()
}

fn mug(b: &mut Builder) {
    let glaze = b.material(
        Material::matte(Pattern::Mug(srgb(0xf0ead9), srgb(0x2d6f8e))).glossy(0.045, 0.015),
    );
    let coffee = b.material(Material::matte(Pattern::Flat(srgb(0x3a2214))).glossy(0.03, 0.01).infrared(0.05));
    let frame = at(-0.055, 0.352, DESK_Z, -35.0);
    let (r, h, wall) = (0.041, 0.096, 0.0035);
    let mut points = vec![(0.0, 0.0), (r - 0.005, 0.0)];
    points.extend(arc((r - 0.004, 0.004), 0.004, -80.0, 0.0, 5));
    points.extend([(r, 0.030), (r, 0.062)]);
    points.extend(arc((r - wall / 2.0, h), wall / 2.0, 0.0, 180.0, 8));
    points.extend([(r - wall, 0.074), (0.0, 0.074)]);
    b.turned(&frame, &profile(&points), 72, glaze);
    let disc = frame * DAffine3::from_translation(DVec3::Z * 0.0742);
    b.turned(&disc, &profile(&[(r - wall + 1e-4, 0.0), (0.0, 0.0)]), 48, coffee);
    let ring: Vec<DVec3> = (0..=24)
        .map(|i| {
            let angle = (-100.0 + 200.0 * f64::from(i) / 24.0).to_radians();
            frame.transform_point3(DVec3::new(
                r - 0.002 + 0.026 * angle.cos(),
                0.0,
                0.049 + 0.029 * angle.sin(),
            ))
        })
        .collect();
    let side = frame.transform_vector3(DVec3::Y);
    b.tube(&ring, side, 0.0055, glaze);
}

const COVERS: [(u32, u32); 9] = [
    (0x7b2d2a, 0xd9b45a),
    (0x27506b, 0xe2d5b5),
    (0x3f6b4c, 0xe9dfc4),
    (0xd8c9a3, 0x7a3b2e),
    (0x2e2f3a, 0xc9a24b),
    (0xc4692f, 0xf3e6c8),
    (0x5a4a78, 0xd8cbe0),
    (0xe6e2d6, 0x2f6f8f),
    (0x9a9f3c, 0x32402a),
];

/// A book lying in the frame's xy plane, spine towards -y, `size` (along spine, across, thick).
fn book(b: &mut Builder, frame: &DAffine3, size: DVec3, k: u32) {
    let (base, accent) = COVERS[k as usize % COVERS.len()];
    let (base, accent) = (srgb(base), srgb(accent));
    let cover = b.material(Material::matte(Pattern::Cover(base, accent, k)).glossy(0.04, 0.08));
    let pages = b.material(Material::matte(Pattern::Pages(k)));
    let back = b.material(Material::matte(Pattern::Mottled(base, k)).glossy(0.04, 0.08));
    let board = 0.0025;
    let lift = |z: f64| *frame * DAffine3::from_translation(DVec3::Z * z);
    b.chamfered_box(frame, DVec3::new(size.x, size.y, board), 0.0006, [back; 6], 0.012);
    b.chamfered_box(
        &lift(size.z - board),
        DVec3::new(size.x, size.y, board),
        0.0006,
        [back, cover, back, back, back, back],
        FINE_M,
    );
    let inner = DVec3::new(size.x - 0.008, size.y - 0.006, size.z - 2.0 * board - 2e-5);
    b.chamfered_box(
        &(lift(board + 1e-5) * DAffine3::from_translation(DVec3::Y * 0.001)),
        inner,
        0.0,
        [pages; 6],
        0.01,
    );
    // The spine: text runs along the book, so its v is the frame's x.
    let spine = b.material(Material::matte(Pattern::Spine(base, accent, k)).glossy(0.04, 0.08));
    let depth = 0.003;
    let half = size.x / 2.0;
    let front = -size.y / 2.0 - depth;
    let place = |p: DVec3| frame.transform_point3(p);
    let turn = |v: DVec3| frame.transform_vector3(v);
    b.rectangle(
        place(DVec3::new(-half, front, size.z)),
        turn(DVec3::NEG_Z * size.z),
        turn(DVec3::X * size.x),
        spine,
        0.008,
    );
    for (z, normal) in [(0.0, -1.0), (size.z, 1.0)] {
        let corner = DVec3::new(-half, if normal > 0.0 { front } else { front + depth }, z);
        b.rectangle(
            place(corner),
            turn(DVec3::X * size.x),
            turn(DVec3::Y * depth * normal),
            back,
            0.02,
        );
    }
    for (x, e1) in [(-half, -1.0), (half, 1.0)] {
        let corner = DVec3::new(x, if e1 > 0.0 { front } else { front + depth }, 0.0);
        b.rectangle(
            place(corner),
            turn(DVec3::Y * depth * e1),
            turn(DVec3::Z * size.z),
            back,
            0.02,
        );
    }
}

fn books(b: &mut Builder) {
    // Lying, right of the middle.
    let mut z = DESK_Z;
    for (k, yaw, size) in [
        (0u32, 8.0, DVec3::new(0.270, 0.195, 0.034)),
        (7, 16.0, DVec3::new(0.240, 0.170, 0.022)),
        (2, 3.0, DVec3::new(0.215, 0.145, 0.028)),
    ] {
        book(b, &at(0.565, 0.50, z, yaw), size, k);
        z += size.z + 2e-5;
    }
    let orange = b.material(Material::matte(Pattern::Fruit(srgb(0xe8862a), srgb(0xd9691c), 5)).glossy(0.04, 0.10));
    let ball = profile(&arc((0.0, 0.036), 0.036, -90.0, 90.0, 32));
    b.turned(&at(0.545, 0.50, z, 0.0), &ball, 64, orange);

    // Standing in a row at the back, the last one leaning. A standing book is a lying one whose
    // x points up and whose spine still faces -y.
    let stand = glam::DQuat::from_rotation_y(-90f64.to_radians());
    let mut x = 0.50;
    for k in 0..9u32 {
        let size = DVec3::new(
            vary(k, 1, 0.185, 0.262),
            vary(k, 2, 0.125, 0.165),
            vary(k, 3, 0.018, 0.044),
        );
        let lean = if k == 8 { 11f64.to_radians() } else { 0.0 };
        let foot = if k == 8 { 0.010 + size.x * lean.sin() } else { 0.0 };
        let frame = DAffine3::from_translation(DVec3::new(
            x + foot + size.z,
            0.985 - size.y / 2.0 - vary(k, 4, 0.0, 0.02),
            DESK_Z + size.z * lean.sin(),
        )) * DAffine3::from_rotation_y(-lean)
            * DAffine3::from_translation(DVec3::Z * size.x / 2.0)
            * DAffine3::from_quat(stand);
        book(b, &frame, size, k * 4 + 1);
        x += size.z + 8e-4;
    }
    let metal = b.material(Material::matte(Pattern::Mottled(srgb(0x33363b), 10)).glossy(0.05, 0.08).infrared(0.1));
    b.chamfered_box(&at(0.492, 0.91, DESK_Z, 0.0), DVec3::new(0.003, 0.11, 0.14), 0.001, [metal; 6], 0.01);
}

fn lamp(b: &mut Builder, lights: &mut Vec<RoomLight>) {
    let paint = b.material(Material::matte(Pattern::Mottled(srgb(0xb23a2e), 12)).glossy(0.05, 0.04));
    let steel = b.material(Material::matte(Pattern::Flat(srgb(0x77797c))).glossy(0.3, 0.25).infrared(0.06));
    // A grey lining: a white one would be a second lamp that only bounces find.
    let inside = b.material(Material::matte(Pattern::Flat(srgb(0x6a6863))));
    let foot = DVec3::new(0.36, 0.885, DESK_Z);
    let mut base = vec![(0.0, 0.0), (0.078, 0.0), (0.078, 0.012)];
    base.extend(arc((0.070, 0.012), 0.008, 0.0, 90.0, 6));
    base.extend([(0.014, 0.022), (0.012, 0.045), (0.0, 0.045)]);
    b.turned(&DAffine3::from_translation(foot), &profile(&base), 64, paint);
    let elbow = foot + DVec3::new(0.10, 0.02, 0.36);
    let head = DVec3::new(0.27, 0.80, DESK_Z + 0.475);
    let side = DVec3::new(0.0, 0.008, 0.0);
    for s in [-1.0, 1.0] {
        b.bar(foot + DVec3::Z * 0.04 + side * s, elbow + side * s, 0.0038, steel);
        b.bar(elbow + side * s, head + side * s, 0.0038, steel);
    }
    let joint = profile(&[(0.0, -0.012), (0.014, -0.012), (0.014, 0.012), (0.0, 0.012)]);
    let flat = DAffine3::from_rotation_x(90f64.to_radians());
    b.turned(&(DAffine3::from_translation(elbow) * flat), &joint, 32, paint);
    // The shade points down and towards the middle of the desk.
    let aim = (DVec3::new(0.12, 0.62, DESK_Z) - head).normalize_or_zero();
    let frame = DAffine3::from_rotation_translation(glam::DQuat::from_rotation_arc(DVec3::NEG_Z, aim), head);
    let outer = [
        (0.068, -0.115),
        (0.060, -0.085),
        (0.044, -0.045),
        (0.026, -0.012),
        (0.020, 0.020),
        (0.016, 0.028),
        (0.0, 0.028),
    ];
    b.turned(&frame, &profile(&outer), 64, paint);
    let inner: Vec<_> = outer[..5]
        .iter()
        .rev()
        .map(|&(r, z)| (r - 0.0015, f64::min(z, 0.015)))
        .collect();
    let mut lining = vec![(0.0, 0.015)];
    lining.extend(inner);
    lining.push((0.068, -0.115));
    b.turned(&frame, &profile(&lining), 64, inside);
    let bulb = frame.transform_point3(DVec3::new(0.0, 0.0, -0.062));
    let (radius, intensity) = (0.028, Vec3::new(2.4, 1.95, 1.3));
    let shine = b.material(Material {
        emission: Some(intensity / (std::f32::consts::PI * (radius * radius) as f32)),
        sampled_light: true,
        ..Material::matte(Pattern::Flat(Vec3::ONE)).infrared(0.0)
    });
    let ball = profile(&arc((0.0, 0.0), radius, -90.0, 90.0, 20));
    b.turned(&DAffine3::from_translation(bulb), &ball, 40, shine);
    lights.push(RoomLight::Sphere {
        name: "desk lamp",
        centre: bulb,
        radius,
        intensity,
        in_room: true,
    });
}

fn plant(b: &mut Builder, frame: &DAffine3) {
    let clay = b.material(Material::matte(Pattern::Mottled(srgb(0xb5653f), 14)));
    let soil = b.material(Material::matte(Pattern::Soil));
    let pot = [
        (0.0, 0.0),
        (0.045, 0.0),
        (0.058, 0.080),
        (0.066, 0.080),
        (0.068, 0.108),
        (0.062, 0.108),
        (0.060, 0.095),
        (0.0, 0.095),
    ];
    b.turned(frame, &profile(&pot), 56, clay);
    let disc = *frame * DAffine3::from_translation(DVec3::Z * 0.0955);
    b.turned(&disc, &profile(&[(0.0605, 0.0), (0.0, 0.0)]), 40, soil);
    let leaves: Vec<u16> = (0..5)
        .map(|k| b.material(Material::matte(Pattern::Leaf(k * 13 + 1)).glossy(0.03, 0.15).infrared(0.5)))
        .collect();
    for k in 0..34u32 {
        let heading = f64::from(k) * 2.399_963 + vary(k, 11, -0.25, 0.25);
        let length = vary(k, 12, 0.13, 0.25);
        let lean = vary(k, 13, 0.15, 0.95);
        let droop = vary(k, 14, 0.4, 1.5);
        let width = vary(k, 15, 0.009, 0.016);
        let out = DVec3::new(heading.cos(), heading.sin(), 0.0);
        let side = DVec3::new(-heading.sin(), heading.cos(), 0.0);
        let steps = 9;
        let (mut p, mut spine, mut half) = (out * 0.012 + DVec3::Z * 0.093, Vec::new(), Vec::new());
        for i in 0..=steps {
            let s = f64::from(i) / f64::from(steps);
            spine.push(frame.transform_point3(p));
            half.push(width * (s * std::f64::consts::PI).sin().max(0.0).powf(0.7).max(0.10) * frame.matrix3.x_axis.length());
            let tilt = lean + droop * s * s;
            p += (out * tilt.sin() + DVec3::Z * tilt.cos()) * (length / f64::from(steps));
        }
        let sides = vec![frame.transform_vector3(side).normalize_or_zero(); spine.len()];
        b.leaf(&spine, &sides, &half, leaves[k as usize % leaves.len()]);
    }
}

fn small_things(b: &mut Builder) {
    // A puzzle cube in front on the right.
    let faces: [u16; 6] = std::array::from_fn(|k| {
        b.material(Material::matte(Pattern::Stickers(k as u32 * 7 + 3)).glossy(0.04, 0.04))
    });
    b.chamfered_box(&at(0.335, 0.375, DESK_Z, 28.0), DVec3::splat(0.057), 0.002, faces, 0.006);

    // A mouse: half an egg.
    let shell = b.material(Material::matte(Pattern::Mottled(srgb(0xdfe0e0), 16)).glossy(0.04, 0.06));
    let mut dome = vec![(0.0, 0.0), (0.96, 0.0), (1.0, 0.12)];
    dome.extend(arc((0.0, 0.12), 1.0, 4.0, 90.0, 20));
    let mouse = at(-0.205, 0.455, DESK_Z, -6.0) * DAffine3::from_scale(DVec3::new(0.031, 0.056, 0.030));
    b.turned(&mouse, &profile(&dome), 48, shell);

    // A pad and a pen, left of the free spot; a written sheet at the left.
    let page = b.material(Material::matte(Pattern::Written(srgb(0xf3ecd2), 21)));
    let edge = b.material(Material::matte(Pattern::Pages(22)));
    b.chamfered_box(
        &at(-0.20, 0.625, DESK_Z, 12.0),
        DVec3::new(0.105, 0.148, 0.009),
        0.0,
        [edge, page, edge, edge, edge, edge],
        0.006,
    );
    let blue = b.material(Material::matte(Pattern::Flat(srgb(0x234a9c))).glossy(0.05, 0.03));
    let pen = DVec3::new(-0.235, 0.575, DESK_Z + 0.0136);
    b.bar(pen, pen + DVec3::new(0.075, 0.105, 0.0), 0.0045, blue);
    let sheet = b.material(Material::matte(Pattern::Written(srgb(0xf4f4f0), 23)));
    for (k, (x, y, yaw)) in [(-0.73, 0.50, 14.0), (-0.70, 0.47, 3.0)].into_iter().enumerate() {
        b.chamfered_box(
            &at(x, y, DESK_Z + 0.0006 * k as f64, yaw),
            DVec3::new(0.21, 0.297, 0.0005),
            0.0,
            [sheet; 6],
            0.008,
        );
    }

    // A cup of pencils.
    let cup = b.material(Material::matte(Pattern::Cloth(srgb(0x6d7f86), 24)));
    let frame = at(-0.115, 0.875, DESK_Z, 0.0);
    let walls = [
        (0.0, 0.0),
        (0.036, 0.0),
        (0.039, 0.098),
        (0.036, 0.098),
        (0.033, 0.006),
        (0.0, 0.006),
    ];
    b.turned(&frame, &profile(&walls), 48, cup);
    for (k, colour) in [0xd8a72c, 0xb03a2e, 0x2e6b4f, 0x35507a, 0x2b2b2b].into_iter().enumerate() {
        let k = k as u32;
        let paint = b.material(Material::matte(Pattern::Flat(srgb(colour))).glossy(0.04, 0.06));
        let angle = f64::from(k) * 1.2566 + 0.4;
        let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let foot = frame.transform_point3(out * -0.018 + DVec3::Z * 0.012);
        let rise = (out * 0.042 + DVec3::Z * 0.10).normalize_or_zero();
        b.bar(foot, foot + rise * vary(k, 31, 0.135, 0.175), 0.0037, paint);
    }
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
    // Boxes of which only the front and the rims are seen.
    let y = 0.9865;
    b.chamfered_box(&at((x0 + x1) / 2.0, y, z0, 0.0), DVec3::new(x1 - x0, 0.024, z1 - z0), 0.0, [cork; 6], 0.010);
    for (x, z, w, h) in [
        ((x0 + x1) / 2.0, z0 - 0.022, x1 - x0 + 0.044, 0.022),
        ((x0 + x1) / 2.0, z1, x1 - x0 + 0.044, 0.022),
        (x0 - 0.011, z0, 0.022, z1 - z0),
        (x1 + 0.011, z0, 0.022, z1 - z0),
    ] {
        b.chamfered_box(&at(x, y - 0.002, z, 0.0), DVec3::new(w, 0.029, h), 0.003, [frame; 6], 0.012);
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
        // Sunk into the cork a little, so that the cork below counts as buried.
        let place = DAffine3::from_translation(DVec3::new(x, front - 0.0003, z)) * rotation;
        b.chamfered_box(
            &(place * DAffine3::from_translation(DVec3::Z * (-h / 2.0))),
            DVec3::new(w, 0.0008, h),
            0.0,
            [paper; 6],
            0.008,
        );
        let head = b.material(Material::matte(Pattern::Flat(srgb(pins[k as usize % 4]))).glossy(0.05, 0.03));
        let pin = place.transform_point3(DVec3::new(0.0, -0.004, h / 2.0 - 0.010));
        b.turned(&DAffine3::from_translation(pin), &profile(&arc((0.0, 0.0), 0.0048, -90.0, 90.0, 8)), 16, head);
    }
}

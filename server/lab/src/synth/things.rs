//! The objects on the desk.

use glam::{DAffine3, DVec3, Vec3};

use super::geometry::Material;
use super::light::RoomLight;
use super::room::{DESK_Z, FINE_M, arc, at, profile, vary};
use super::solid::Builder;
use super::texture::{Pattern, srgb};

pub(super) fn monitor(b: &mut Builder, lights: &mut Vec<RoomLight>) {
    let case = b.material(
        Material::matte(Pattern::Flat(srgb(0x2a2b2e)))
            .glossy(0.04, 0.05)
            .infrared(0.12),
    );
    let foot = b.material(Material::matte(Pattern::Mottled(srgb(0x8d9094), 6)).glossy(0.2, 0.08));
    let frame = at(-0.44, 0.80, DESK_Z, 13.0);
    let shift = |x: f64, y: f64, z: f64| frame * DAffine3::from_translation(DVec3::new(x, y, z));
    b.chamfered_box(
        &shift(0.0, 0.02, 0.0),
        DVec3::new(0.24, 0.17, 0.010),
        0.003,
        [foot; 6],
        FINE_M,
    );
    b.chamfered_box(
        &shift(0.0, 0.045, 0.010),
        DVec3::new(0.05, 0.03, 0.20),
        0.003,
        [foot; 6],
        0.01,
    );
    b.chamfered_box(
        &shift(0.0, 0.0, 0.095),
        DVec3::new(0.545, 0.035, 0.330),
        0.004,
        [case; 6],
        0.012,
    );
    let radiance = Vec3::new(4.2, 4.6, 5.2);
    let glass = b.material(Material {
        emission: Some(radiance),
        sampled_light: true,
        ..Material::matte(Pattern::Screen)
            .glossy(0.035, 0.012)
            .infrared(0.006)
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

pub(super) fn keyboard(b: &mut Builder) {
    let case = b.material(Material::matte(Pattern::Mottled(srgb(0xb9bcc0), 7)).glossy(0.08, 0.08));
    let keys = b.material(Material::matte(Pattern::Mottled(srgb(0xe9e8e4), 8)).glossy(0.03, 0.12));
    let dark = b.material(Material::matte(Pattern::Mottled(srgb(0x5d6670), 9)).glossy(0.03, 0.12));
    let accent =
        b.material(Material::matte(Pattern::Mottled(srgb(0xd9673b), 9)).glossy(0.03, 0.12));
    let frame = at(-0.42, 0.475, DESK_Z, 7.0);
    b.chamfered_box(
        &frame,
        DVec3::new(15.0 * 0.0205 + 0.0105, 0.128, 0.012),
        0.003,
        [case; 6],
        FINE_M,
    );
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

pub(super) fn mug(b: &mut Builder) {
    let glaze = b.material(
        Material::matte(Pattern::Mug(srgb(0xf0ead9), srgb(0x2d6f8e))).glossy(0.045, 0.015),
    );
    let coffee = b.material(
        Material::matte(Pattern::Flat(srgb(0x3a2214)))
            .glossy(0.03, 0.01)
            .infrared(0.05),
    );
    let frame = at(-0.052, 0.334, DESK_Z, -35.0);
    let (r, h, wall) = (0.041, 0.096, 0.0035);
    let mut points = vec![(0.0, 0.0), (r - 0.005, 0.0)];
    points.extend(arc((r - 0.004, 0.004), 0.004, -80.0, 0.0, 5));
    points.extend([(r, 0.030), (r, 0.062)]);
    points.extend(arc((r - wall / 2.0, h), wall / 2.0, 0.0, 180.0, 8));
    points.extend([(r - wall, 0.074), (0.0, 0.074)]);
    b.turned(&frame, &profile(&points), 72, glaze);
    let disc = frame * DAffine3::from_translation(DVec3::Z * 0.0742);
    b.turned(
        &disc,
        &profile(&[(r - wall + 1e-4, 0.0), (0.0, 0.0)]),
        48,
        coffee,
    );
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

/// A book lying in the frame's xy plane, its spine towards -y. `size` is (along the spine, across, thickness).
fn book(b: &mut Builder, frame: &DAffine3, size: DVec3, k: u32) {
    let (base, accent) = COVERS[k as usize % COVERS.len()];
    let (base, accent) = (srgb(base), srgb(accent));
    let cover = b.material(Material::matte(Pattern::Cover(base, accent, k)).glossy(0.04, 0.08));
    let pages = b.material(Material::matte(Pattern::Pages(k)));
    let back = b.material(Material::matte(Pattern::Mottled(base, k)).glossy(0.04, 0.08));
    let board = 0.0025;
    let lift = |z: f64| *frame * DAffine3::from_translation(DVec3::Z * z);
    b.chamfered_box(
        frame,
        DVec3::new(size.x, size.y, board),
        0.0006,
        [back; 6],
        0.012,
    );
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

pub(super) fn books(b: &mut Builder) {
    // Lying books, right of the middle.
    let mut z = DESK_Z;
    for (k, yaw, size) in [
        (0u32, 8.0, DVec3::new(0.270, 0.195, 0.034)),
        (7, 16.0, DVec3::new(0.240, 0.170, 0.022)),
        (2, 3.0, DVec3::new(0.215, 0.145, 0.028)),
    ] {
        book(b, &at(0.565, 0.50, z, yaw), size, k);
        z += size.z + 2e-5;
    }
    let orange = b.material(
        Material::matte(Pattern::Fruit(srgb(0xe8862a), srgb(0xd9691c), 5)).glossy(0.04, 0.10),
    );
    let ball = profile(&arc((0.0, 0.036), 0.036, -90.0, 90.0, 32));
    b.turned(&at(0.545, 0.50, z, 0.0), &ball, 64, orange);

    // Standing books in a row at the back, the last one leaning. A standing book is a lying one turned so that
    // its x points up and its spine still faces -y.
    let stand = glam::DQuat::from_rotation_y(-90f64.to_radians());
    let mut x = 0.50;
    for k in 0..9u32 {
        let size = DVec3::new(
            vary(k, 1, 0.185, 0.262),
            vary(k, 2, 0.125, 0.165),
            vary(k, 3, 0.018, 0.044),
        );
        let lean = if k == 8 { 11f64.to_radians() } else { 0.0 };
        let foot = if k == 8 {
            0.010 + size.x * lean.sin()
        } else {
            0.0
        };
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
    let metal = b.material(
        Material::matte(Pattern::Mottled(srgb(0x33363b), 10))
            .glossy(0.05, 0.08)
            .infrared(0.1),
    );
    b.chamfered_box(
        &at(0.492, 0.91, DESK_Z, 0.0),
        DVec3::new(0.003, 0.11, 0.14),
        0.001,
        [metal; 6],
        0.01,
    );
}

pub(super) fn lamp(b: &mut Builder, lights: &mut Vec<RoomLight>) {
    let paint =
        b.material(Material::matte(Pattern::Mottled(srgb(0xb23a2e), 12)).glossy(0.05, 0.04));
    let steel = b.material(
        Material::matte(Pattern::Flat(srgb(0x77797c)))
            .glossy(0.3, 0.25)
            .infrared(0.06),
    );
    // A grey lining: a white one would act as a second lamp that only indirect rays find.
    let inside = b.material(Material::matte(Pattern::Flat(srgb(0x6a6863))));
    let foot = DVec3::new(0.36, 0.885, DESK_Z);
    let mut base = vec![(0.0, 0.0), (0.078, 0.0), (0.078, 0.012)];
    base.extend(arc((0.070, 0.012), 0.008, 0.0, 90.0, 6));
    base.extend([(0.014, 0.022), (0.012, 0.045), (0.0, 0.045)]);
    b.turned(
        &DAffine3::from_translation(foot),
        &profile(&base),
        64,
        paint,
    );
    let elbow = foot + DVec3::new(0.10, 0.02, 0.36);
    let head = DVec3::new(0.27, 0.80, DESK_Z + 0.475);
    b.bar(foot + DVec3::Z * 0.04, elbow, 0.0065, steel);
    b.bar(elbow, head, 0.0065, steel);
    let joint = profile(&[(0.0, -0.012), (0.014, -0.012), (0.014, 0.012), (0.0, 0.012)]);
    let flat = DAffine3::from_rotation_x(90f64.to_radians());
    b.turned(
        &(DAffine3::from_translation(elbow) * flat),
        &joint,
        32,
        paint,
    );
    // The shade points down and towards the middle of the desk.
    let aim = (DVec3::new(0.12, 0.62, DESK_Z) - head).normalize_or_zero();
    let frame = DAffine3::from_rotation_translation(
        glam::DQuat::from_rotation_arc(DVec3::NEG_Z, aim),
        head,
    );
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

pub(super) fn plant(b: &mut Builder, frame: &DAffine3) {
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
        .map(|k| {
            b.material(
                Material::matte(Pattern::Leaf(k * 13 + 1))
                    .glossy(0.03, 0.15)
                    .infrared(0.5),
            )
        })
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
            half.push(
                width
                    * (s * std::f64::consts::PI)
                        .sin()
                        .max(0.0)
                        .powf(0.7)
                        .max(0.10)
                    * frame.matrix3.x_axis.length(),
            );
            let tilt = lean + droop * s * s;
            p += (out * tilt.sin() + DVec3::Z * tilt.cos()) * (length / f64::from(steps));
        }
        let sides = vec![frame.transform_vector3(side).normalize_or_zero(); spine.len()];
        b.leaf(&spine, &sides, &half, leaves[k as usize % leaves.len()]);
    }
}

pub(super) fn small_things(b: &mut Builder) {
    // A puzzle cube in front on the right.
    let faces: [u16; 6] = std::array::from_fn(|k| {
        b.material(Material::matte(Pattern::Stickers(k as u32 * 7 + 3)).glossy(0.04, 0.04))
    });
    b.chamfered_box(
        &at(0.335, 0.375, DESK_Z, 28.0),
        DVec3::splat(0.057),
        0.002,
        faces,
        0.006,
    );

    // A mouse: half an egg.
    let shell =
        b.material(Material::matte(Pattern::Mottled(srgb(0xdfe0e0), 16)).glossy(0.04, 0.06));
    let mut dome = vec![(0.0, 0.0), (0.96, 0.0), (1.0, 0.12)];
    dome.extend(arc((0.0, 0.12), 1.0, 4.0, 90.0, 20));
    let mouse =
        at(-0.205, 0.455, DESK_Z, -6.0) * DAffine3::from_scale(DVec3::new(0.031, 0.056, 0.030));
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
    for (k, (x, y, yaw)) in [(-0.73, 0.50, 14.0), (-0.70, 0.47, 3.0)]
        .into_iter()
        .enumerate()
    {
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
    for (k, colour) in [0xd8a72c, 0xb03a2e, 0x2e6b4f, 0x35507a, 0x2b2b2b]
        .into_iter()
        .enumerate()
    {
        let k = k as u32;
        let paint = b.material(Material::matte(Pattern::Flat(srgb(colour))).glossy(0.04, 0.06));
        let angle = f64::from(k) * 1.2566 + 0.4;
        let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let foot = frame.transform_point3(out * -0.018 + DVec3::Z * 0.012);
        let rise = (out * 0.042 + DVec3::Z * 0.10).normalize_or_zero();
        b.bar(foot, foot + rise * vary(k, 31, 0.135, 0.175), 0.0037, paint);
    }
}

//! Finds places with enough room on the surface measured in the first frame.

use glam::{DVec2, DVec3};

use super::place::{PLANE_RADIUS, PlacementFrame, upright};
use crate::frame::{RgbdFrame, depth_sigma_m, is_valid_depth};

/// Position of objects without a given place: shares of the picture's width and height.
pub const LOWER_MIDDLE: [f64; 2] = [0.5, 0.65];

/// A surface is level if its normal is within this angle of the camera's up direction, degrees. Beyond it, the
/// surface is a wall or is seen from too steeply above to distinguish the two (heuristic).
const LEVEL_DEG: f64 = 60.0;

/// Candidate spots per row of the picture.
const SPOTS_PER_ROW: u32 = 40;

/// Largest distance of a surface from a plane to count as the same plane: metres, plus a number of standard
/// deviations of the depth noise (heuristic: a sheet of paper on a table counts, a book does not).
const FLAT_M: f64 = 0.015;
const FLAT_SIGMAS: f64 = 2.0;

/// Directions in which an object needs room around its centre.
const AROUND: usize = 8;

/// Extent on the surface, metres, that the picture's width and height represent when an arrangement is moved: the
/// values for a desk seen from 1.3 m at 35 degrees by a camera with a field of view of 60 degrees.
const PICTURE_M: DVec2 = DVec2::new(1.5, 1.9);

/// An object stays at its place if at least this share of its surroundings is free there.
const ENOUGH_ROOM: f64 = 0.6;

/// Objects overlap if their distance is less than this share of the sum of their radii.
const APART: f64 = 0.6;

/// A point of the real surface and its unit normal towards the camera, camera axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ground {
    pub(super) point: DVec3,
    pub(super) normal: DVec3,
}

impl Ground {
    /// The surface at a pixel, if it has a depth.
    pub(super) fn at([u, v]: [f64; 2], view: &PlacementFrame<'_>) -> Option<Self> {
        let radius = PLANE_RADIUS * view.frame.depth.width as f32;
        view.surface
            .plane_at(u as f32, v as f32, radius)
            .filter(|(point, normal)| point.is_finite() && normal.is_finite())
            .map(|(point, normal)| Self { point, normal })
    }

    fn is_level(&self) -> bool {
        -self.normal.y >= LEVEL_DEG.to_radians().cos()
    }

    /// Height of a point above this plane, metres; negative below.
    fn height_of(&self, point: DVec3) -> f64 {
        self.normal.dot(point - self.point)
    }

    /// The point at an offset to the right and towards the viewer, metres.
    fn beside(&self, offset: DVec2) -> DVec3 {
        let axes = upright(self.normal, -self.point, DVec3::Y);
        self.point + axes * DVec3::new(offset.x, 0.0, offset.y)
    }

    /// Share of some points of this plane (offsets to the right and towards the viewer, metres) at which the frame
    /// measured this plane too: 1 if all are free and none is beyond an edge.
    fn room(&self, points: &[DVec2], frame: &RgbdFrame) -> f64 {
        let free = points.iter().filter(|&&offset| {
            let there = self.beside(offset);
            let Some(seen) = measured_towards(there, frame) else {
                return false;
            };
            let slack = FLAT_M + FLAT_SIGMAS * f64::from(depth_sigma_m(seen.z as f32));
            self.height_of(seen).abs() <= slack
        });
        free.count() as f64 / points.len().max(1) as f64
    }
}

/// The measured point at the pixel that shows a point in camera axes.
fn measured_towards(point: DVec3, frame: &RgbdFrame) -> Option<DVec3> {
    let pixel = pixel_of(point, frame)?;
    let [x, y] = pixel.map(|c| c.round() as usize);
    let z = frame.depth.z_m[y * frame.depth.width as usize + x];
    is_valid_depth(z).then(|| frame.intrinsics.unproject(x as f64, y as f64, f64::from(z)))
}

/// The pixel that shows a point in camera axes, if it is in the picture.
fn pixel_of(point: DVec3, frame: &RgbdFrame) -> Option<[f64; 2]> {
    let k = &frame.intrinsics;
    let pixel = [
        k.fx * point.x / point.z + k.cx,
        k.fy * point.y / point.z + k.cy,
    ];
    let size = [frame.depth.width, frame.depth.height].map(f64::from);
    let inside = pixel
        .iter()
        .zip(size)
        .all(|(c, n)| (-0.5..n - 0.5).contains(c));
    (point.z > 0.0 && inside).then_some(pixel)
}

/// An object to be placed.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpotRequest {
    /// Requested pixel.
    pub(super) pixel: [f64; 2],
    /// Half its extent on the surface, metres.
    pub(super) radius_m: f64,
}

/// Places found for objects.
#[derive(Debug)]
pub(super) struct Spots {
    /// One per object.
    pub(super) grounds: Vec<Ground>,
    /// Pixel of their centre, if they were moved from their requested pixels.
    pub(super) moved_to: Option<[f64; 2]>,
    /// Whether the surface is level.
    pub(super) level: bool,
}

/// Places objects together. They stay at their pixels if all are on one level surface, with enough room and distance;
/// otherwise they are moved, as an arrangement, to the nearest place where this holds. `None` if the frame has no
/// surface at all.
pub(super) fn find(wanted: &[SpotRequest], view: &PlacementFrame<'_>) -> Option<Spots> {
    let frame = view.frame;
    if let Some(grounds) = as_put(wanted, view) {
        return Some(Spots {
            grounds,
            moved_to: None,
            level: true,
        });
    }
    let size = DVec2::new(f64::from(frame.depth.width), f64::from(frame.depth.height));
    let pixels = wanted.iter().map(|w| DVec2::from(w.pixel));
    let middle = pixels.clone().sum::<DVec2>() / wanted.len().max(1) as f64;
    let mut offsets: Vec<DVec2> = pixels.map(|p| (p - middle) / size * PICTURE_M).collect();
    spread(&mut offsets, wanted);
    let points: Vec<DVec2> = wanted
        .iter()
        .zip(&offsets)
        .flat_map(|(w, &offset)| around(w.radius_m).map(move |p| p + offset))
        .collect();
    let (pixel, ground) = nearest(middle, &points, view)?;
    let grounds = offsets
        .iter()
        .map(|&offset| {
            let point = ground.beside(offset);
            // The measured surface, unless an object stands on it or hides it.
            let own = pixel_of(point, frame).and_then(|pixel| Ground::at(pixel, view));
            let same = |own: &Ground| {
                ground.height_of(own.point).abs() <= 2.0 * FLAT_M
                    && own.normal.dot(ground.normal) > 0.9
            };
            own.filter(same).unwrap_or(Ground { point, ..ground })
        })
        .collect();
    Some(Spots {
        grounds,
        moved_to: Some(pixel),
        level: ground.is_level(),
    })
}

/// All objects at their own pixels, if these are good places.
fn as_put(wanted: &[SpotRequest], view: &PlacementFrame<'_>) -> Option<Vec<Ground>> {
    let grounds: Option<Vec<Ground>> = wanted
        .iter()
        .map(|w| Ground::at(w.pixel, view).filter(Ground::is_level))
        .collect();
    let grounds = grounds?;
    let first = *grounds.first()?;
    let alone = grounds.len() == 1;
    let good = wanted.iter().zip(&grounds).all(|(w, ground)| {
        let points: Vec<DVec2> = around(w.radius_m).collect();
        first.height_of(ground.point).abs() <= 2.0 * FLAT_M
            && (!alone || ground.room(&points, view.frame) >= ENOUGH_ROOM)
    });
    let apart = wanted.iter().zip(&grounds).enumerate().all(|(i, (a, at))| {
        let others = wanted.iter().zip(&grounds).skip(i + 1);
        others
            .into_iter()
            .all(|(b, bt)| at.point.distance(bt.point) >= APART * (a.radius_m + b.radius_m))
    });
    (good && apart).then_some(grounds)
}

/// Points around an object of this radius that must be free.
fn around(radius_m: f64) -> impl Iterator<Item = DVec2> {
    let ring = (0..AROUND).map(move |i| {
        DVec2::from_angle(i as f64 / AROUND as f64 * std::f64::consts::TAU) * radius_m
    });
    ring.chain([DVec2::ZERO])
}

/// Scales an arrangement about its centre until no two objects overlap, by a factor of at most four: two objects may
/// have the same position.
fn spread(offsets: &mut [DVec2], wanted: &[SpotRequest]) {
    let mut factor: f64 = 1.0;
    for (i, a) in wanted.iter().enumerate() {
        for (j, b) in wanted.iter().enumerate().skip(i + 1) {
            let apart = offsets[i].distance(offsets[j]);
            factor = factor.max((a.radius_m + b.radius_m) * APART / apart.max(1e-9));
        }
    }
    for offset in offsets {
        *offset *= factor.min(4.0);
    }
}

/// The best spot for an arrangement, and among equally good spots the nearest to a pixel: level with room for all,
/// then level with room for most, then any surface with room, and so on.
fn nearest(
    wanted: DVec2,
    points: &[DVec2],
    view: &PlacementFrame<'_>,
) -> Option<([f64; 2], Ground)> {
    let frame = view.frame;
    let (width, height) = (frame.depth.width, frame.depth.height);
    let step = (width / SPOTS_PER_ROW).max(1) as usize;
    let half = step as u32 / 2;
    let grid = (half..height).step_by(step).flat_map(|y| {
        (half..width)
            .step_by(step)
            .map(move |x| DVec2::new(f64::from(x), f64::from(y)))
    });
    let mut spots: Vec<DVec2> = std::iter::once(wanted).chain(grid).collect();
    // The sort is stable: of two spots at the same distance, the one in the upper row comes first.
    spots.sort_by(|a, b| {
        let far = |p: &DVec2| p.distance_squared(wanted);
        far(a).total_cmp(&far(b))
    });
    let mut best: Option<(u32, [f64; 2], Ground)> = None;
    for spot in spots {
        let pixel = spot.to_array();
        let Some(ground) = Ground::at(pixel, view) else {
            continue;
        };
        let room = ground.room(points, frame);
        let rank = match (ground.is_level(), room) {
            (true, 1.0..) => return Some((pixel, ground)),
            (true, 0.8..) => 5,
            (false, 1.0..) => 4,
            (true, 0.5..) => 3,
            (false, 0.5..) => 2,
            _ => 1,
        };
        if best.is_none_or(|(known, ..)| rank > known) {
            best = Some((rank, pixel, ground));
        }
    }
    best.map(|(_, pixel, ground)| (pixel, ground))
}

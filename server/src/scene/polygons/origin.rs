//! The offset for a mesh far from its origin: surveyed coordinates (UTM, national grids) are millions of metres,
//! where f32 resolves decimetres.

use glam::DVec3;

use crate::scene::MAX_COORDINATE;

/// A mesh is moved if its distance from the origin is this many times its size: f32 would resolve less than about a
/// four-thousandth of it (heuristic).
const FAR: f64 = 2_000.0;

/// If a mesh is moved at all, it is moved along every axis along which its distance is this many times its size
/// (heuristic).
const ALSO_FAR: f64 = 10.0;

/// Most corners sampled for the median.
const SAMPLES: usize = 1 << 16;

/// The offset to subtract from all positions, whole numbers; 0 for a mesh that need not be moved.
pub(in crate::scene) fn offset(used: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let limit = f64::from(MAX_COORDINATE);
    let Some((lo, hi)) = bounds(used.clone()) else {
        return DVec3::ZERO;
    };
    let extent = (hi - lo).max_element();
    let farthest = lo.abs().max(hi.abs());
    if farthest.max_element() < limit && farthest.max_element() <= FAR * extent {
        return DVec3::ZERO;
    }
    if extent == 0.0 {
        return DVec3::ZERO;
    }
    // Single vertices far from all others are ignored.
    let (lo, hi) = if farthest.max_element() >= limit {
        let median = median(used.clone());
        let around = used.filter(|p| (*p - median).abs().max_element() < limit);
        bounds(around).unwrap_or((lo, hi))
    } else {
        (lo, hi)
    };
    let extent = (hi - lo).max_element();
    let offset = |lo: f64, hi: f64| {
        let farthest = lo.abs().max(hi.abs());
        if farthest < limit && farthest <= ALSO_FAR * extent {
            0.0
        } else if hi - lo < 0.5 * limit {
            lo.floor()
        } else {
            (0.5 * lo + 0.5 * hi).round()
        }
    };
    DVec3::new(offset(lo.x, hi.x), offset(lo.y, hi.y), offset(lo.z, hi.z))
}

/// The note that a model was moved.
pub(in crate::scene) fn note(offset: DVec3) -> String {
    let [x, y, z] = (DVec3::ZERO - offset).to_array();
    format!(
        "it lies far from its origin: moved by ({x}, {y}, {z}) to keep its detail; placements are relative to the new position"
    )
}

fn bounds(mut points: impl Iterator<Item = DVec3>) -> Option<(DVec3, DVec3)> {
    let first = points.next()?;
    Some(points.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p))))
}

/// The median of each axis separately.
fn median(points: impl Iterator<Item = DVec3> + Clone) -> DVec3 {
    let stride = points.clone().count().div_ceil(SAMPLES).max(1);
    let axis = |k: usize| {
        let mut values: Vec<f64> = points.clone().step_by(stride).map(|p| p[k]).collect();
        let middle = values.len() / 2;
        match values.get(middle) {
            Some(_) => *values.select_nth_unstable_by(middle, f64::total_cmp).1,
            None => 0.0,
        }
    };
    DVec3::new(axis(0), axis(1), axis(2))
}

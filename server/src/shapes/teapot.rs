//! The Utah teapot (Newell 1975): 32 bicubic Bezier patches.
//!
//! The table contains the ten patches that remain after using its symmetries, as usual: rim, body, lid and bottom are
//! repeated by quarter turns, handle and spout are mirrored. z is up and the teapot stands on z = 0, as in Newell's
//! model.
//!
//! Newell's surface is not closed: there is a gap of 0.1 units between lid and rim, and spout and handle end inside
//! the body (the spout also at its own mouth). [`tessellate`] closes each of these loops with a flat ring or cap, so
//! that light cannot leak and glass has an inside. The body with the lid, the spout, and the handle are three closed
//! surfaces that intersect each other.

use glam::DVec3;

/// Control points.
const POINTS: [[f64; 3]; 127] = [
    [0.2, 0.0, 2.7],
    [0.2, -0.112, 2.7],
    [0.112, -0.2, 2.7],
    [0.0, -0.2, 2.7],
    [1.3375, 0.0, 2.53125],
    [1.3375, -0.749, 2.53125],
    [0.749, -1.3375, 2.53125],
    [0.0, -1.3375, 2.53125],
    [1.4375, 0.0, 2.53125],
    [1.4375, -0.805, 2.53125],
    [0.805, -1.4375, 2.53125],
    [0.0, -1.4375, 2.53125],
    [1.5, 0.0, 2.4],
    [1.5, -0.84, 2.4],
    [0.84, -1.5, 2.4],
    [0.0, -1.5, 2.4],
    [1.75, 0.0, 1.875],
    [1.75, -0.98, 1.875],
    [0.98, -1.75, 1.875],
    [0.0, -1.75, 1.875],
    [2.0, 0.0, 1.35],
    [2.0, -1.12, 1.35],
    [1.12, -2.0, 1.35],
    [0.0, -2.0, 1.35],
    [2.0, 0.0, 0.9],
    [2.0, -1.12, 0.9],
    [1.12, -2.0, 0.9],
    [0.0, -2.0, 0.9],
    [-2.0, 0.0, 0.9],
    [2.0, 0.0, 0.45],
    [2.0, -1.12, 0.45],
    [1.12, -2.0, 0.45],
    [0.0, -2.0, 0.45],
    [1.5, 0.0, 0.225],
    [1.5, -0.84, 0.225],
    [0.84, -1.5, 0.225],
    [0.0, -1.5, 0.225],
    [1.5, 0.0, 0.15],
    [1.5, -0.84, 0.15],
    [0.84, -1.5, 0.15],
    [0.0, -1.5, 0.15],
    [-1.6, 0.0, 2.025],
    [-1.6, -0.3, 2.025],
    [-1.5, -0.3, 2.25],
    [-1.5, 0.0, 2.25],
    [-2.3, 0.0, 2.025],
    [-2.3, -0.3, 2.025],
    [-2.5, -0.3, 2.25],
    [-2.5, 0.0, 2.25],
    [-2.7, 0.0, 2.025],
    [-2.7, -0.3, 2.025],
    [-3.0, -0.3, 2.25],
    [-3.0, 0.0, 2.25],
    [-2.7, 0.0, 1.8],
    [-2.7, -0.3, 1.8],
    [-3.0, -0.3, 1.8],
    [-3.0, 0.0, 1.8],
    [-2.7, 0.0, 1.575],
    [-2.7, -0.3, 1.575],
    [-3.0, -0.3, 1.35],
    [-3.0, 0.0, 1.35],
    [-2.5, 0.0, 1.125],
    [-2.5, -0.3, 1.125],
    [-2.65, -0.3, 0.9375],
    [-2.65, 0.0, 0.9375],
    [-2.0, -0.3, 0.9],
    [-1.9, -0.3, 0.6],
    [-1.9, 0.0, 0.6],
    [1.7, 0.0, 1.425],
    [1.7, -0.66, 1.425],
    [1.7, -0.66, 0.6],
    [1.7, 0.0, 0.6],
    [2.6, 0.0, 1.425],
    [2.6, -0.66, 1.425],
    [3.1, -0.66, 0.825],
    [3.1, 0.0, 0.825],
    [2.3, 0.0, 2.1],
    [2.3, -0.25, 2.1],
    [2.4, -0.25, 2.025],
    [2.4, 0.0, 2.025],
    [2.7, 0.0, 2.4],
    [2.7, -0.25, 2.4],
    [3.3, -0.25, 2.4],
    [3.3, 0.0, 2.4],
    [2.8, 0.0, 2.475],
    [2.8, -0.25, 2.475],
    [3.525, -0.25, 2.49375],
    [3.525, 0.0, 2.49375],
    [2.9, 0.0, 2.475],
    [2.9, -0.15, 2.475],
    [3.45, -0.15, 2.5125],
    [3.45, 0.0, 2.5125],
    [2.8, 0.0, 2.4],
    [2.8, -0.15, 2.4],
    [3.2, -0.15, 2.4],
    [3.2, 0.0, 2.4],
    [0.0, 0.0, 3.15],
    [0.8, 0.0, 3.15],
    [0.8, -0.45, 3.15],
    [0.45, -0.8, 3.15],
    [0.0, -0.8, 3.15],
    [0.0, 0.0, 2.85],
    [1.4, 0.0, 2.4],
    [1.4, -0.784, 2.4],
    [0.784, -1.4, 2.4],
    [0.0, -1.4, 2.4],
    [0.4, 0.0, 2.55],
    [0.4, -0.224, 2.55],
    [0.224, -0.4, 2.55],
    [0.0, -0.4, 2.55],
    [1.3, 0.0, 2.55],
    [1.3, -0.728, 2.55],
    [0.728, -1.3, 2.55],
    [0.0, -1.3, 2.55],
    [1.3, 0.0, 2.4],
    [1.3, -0.728, 2.4],
    [0.728, -1.3, 2.4],
    [0.0, -1.3, 2.4],
    [0.0, 0.0, 0.0],
    [1.425, -0.798, 0.0],
    [1.5, 0.0, 0.075],
    [1.425, 0.0, 0.0],
    [0.798, -1.425, 0.0],
    [0.0, -1.5, 0.075],
    [0.0, -1.425, 0.0],
    [1.5, -0.84, 0.075],
    [0.84, -1.5, 0.075],
];

/// Rows of control points along v, four per row along u: rim, body (2), lid (2), bottom.
const TURNED: [[usize; 16]; 6] = [
    [102, 103, 104, 105, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
    [
        12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27,
    ],
    [
        24, 25, 26, 27, 29, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40,
    ],
    [
        96, 96, 96, 96, 97, 98, 99, 100, 101, 101, 101, 101, 0, 1, 2, 3,
    ],
    [
        0, 1, 2, 3, 106, 107, 108, 109, 110, 111, 112, 113, 114, 115, 116, 117,
    ],
    [
        118, 118, 118, 118, 124, 122, 119, 121, 123, 126, 125, 120, 40, 39, 38, 37,
    ],
];

/// Handle (2), spout (2).
const MIRRORED: [[usize; 16]; 4] = [
    [
        41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51, 52, 53, 54, 55, 56,
    ],
    [
        53, 54, 55, 56, 57, 58, 59, 60, 61, 62, 63, 64, 28, 65, 66, 67,
    ],
    [
        68, 69, 70, 71, 72, 73, 74, 75, 76, 77, 78, 79, 80, 81, 82, 83,
    ],
    [
        80, 81, 82, 83, 84, 85, 86, 87, 88, 89, 90, 91, 92, 93, 94, 95,
    ],
];

/// Control points of one patch, row-major.
pub(super) type Patch = [DVec3; 16];

/// The 32 patches; the outside is the direction of `d/du x d/dv`.
pub(super) fn patches() -> Vec<Patch> {
    let mut patches = Vec::with_capacity(32);
    let control = |indices: &[usize; 16]| indices.map(|i| DVec3::from_array(POINTS[i]));
    // Reverses u, and therefore the direction of u x v.
    let flipped = |p: &Patch| -> Patch { std::array::from_fn(|i| p[i / 4 * 4 + 3 - i % 4]) };
    for indices in &TURNED {
        let mut patch = control(indices);
        for _ in 0..4 {
            patches.push(patch);
            patch = patch.map(|p| DVec3::new(-p.y, p.x, p.z));
        }
    }
    for indices in &MIRRORED {
        let patch = control(indices);
        patches.push(patch);
        patches.push(flipped(&patch.map(|p| DVec3::new(p.x, -p.y, p.z))));
    }
    patches
}

/// Cubic Bernstein polynomials and their derivatives at t.
fn bernstein(t: f64) -> ([f64; 4], [f64; 4]) {
    let s = 1.0 - t;
    (
        [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t],
        [
            -3.0 * s * s,
            3.0 * s * s - 6.0 * s * t,
            6.0 * s * t - 3.0 * t * t,
            3.0 * t * t,
        ],
    )
}

/// Position and outward normal of a patch at (u, v); the normal is `None` where the derivatives do not span a plane
/// (the poles).
pub(super) fn evaluate(patch: &Patch, u: f64, v: f64) -> (DVec3, Option<DVec3>) {
    let ((bu, du), (bv, dv)) = (bernstein(u), bernstein(v));
    let (mut p, mut pu, mut pv) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
    for (i, &c) in patch.iter().enumerate() {
        p += c * (bu[i % 4] * bv[i / 4]);
        pu += c * (du[i % 4] * bv[i / 4]);
        pv += c * (bu[i % 4] * dv[i / 4]);
    }
    let n = pu.cross(pv);
    // Derivatives are of the order of the teapot's size 1; rounding errors are about 1e-15.
    (p, (n.length() > 1e-9).then(|| n.normalize_or_zero()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_point_outwards() {
        let patches = patches();
        assert_eq!(patches.len(), 32);
        // Seen from the centre of the body, or of the knob for its four patches.
        for (k, patch) in patches.iter().enumerate().take(24) {
            let (p, n) = evaluate(patch, 0.5, 0.5);
            let n = n.unwrap();
            let height = if (12..16).contains(&k) { 3.0 } else { 1.2 };
            let centre = DVec3::new(0.0, 0.0, height);
            assert!(n.dot(p - centre) > 0.0, "patch {k} at {p}: {n}");
        }
    }

    #[test]
    fn neighbours_share_their_borders() {
        let patches = patches();
        let on_a_border = |p: DVec3, skip: usize| {
            patches.iter().enumerate().any(|(k, patch)| {
                k != skip
                    && (0..=16).any(|i| {
                        let t = f64::from(i) / 16.0;
                        [(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)]
                            .iter()
                            .any(|&(u, v)| evaluate(patch, u, v).0.distance(p) < 1e-12)
                    })
            })
        };
        let mut free = 0;
        for (k, patch) in patches.iter().enumerate() {
            for (u, v) in [(0.5, 0.0), (0.5, 1.0), (0.0, 0.5), (1.0, 0.5)] {
                free += u32::from(!on_a_border(evaluate(patch, u, v).0, k));
            }
        }
        // Rim and lid (4 + 4), both ends of handle and spout (2 each): the loops that tessellation closes. Poles
        // (lid, bottom) are shared by four patches.
        assert_eq!(free, 16);
    }
}

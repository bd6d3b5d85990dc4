//! Triangulates polygons: a fan if that is valid, else ear clipping (Meisters 1975, "Polygons have ears").

use earcut::Earcut;
use glam::DVec3;

/// Limit on ear clipping per file: the sum of n^3 over its polygons of n corners. In the worst case (a polygon that
/// crosses itself many times) n^3 takes 0.7 ns: 3 s in total. This allows one polygon of 1,500 corners, or any number
/// of small ones.
const MAX_WORK: u64 = 4_000_000_000;

/// A triangle of a fan whose area on the wrong side is less than this share of the polygon is due to rounding.
const ROUNDING: f64 = 1e-9;

/// Triangulates polygons one after the other.
pub(super) struct Cutter {
    earcut: Earcut<f64>,
    flat: Vec<[f64; 2]>,
    triangles: Vec<u32>,
    work: u64,
    /// Number of polygons that became fans because ear clipping would have taken too long.
    pub(super) n_fans: usize,
}

impl Default for Cutter {
    fn default() -> Self {
        Self {
            earcut: Earcut::new(),
            flat: Vec::new(),
            triangles: Vec::new(),
            work: 0,
            n_fans: 0,
        }
    }
}

impl Cutter {
    /// Triangles of a polygon of at least three finite corners, as indices of the corners, in the same orientation.
    /// The corners need not be coplanar.
    pub(super) fn cut(&mut self, corners: &[DVec3]) -> impl Iterator<Item = [u32; 3]> {
        self.triangles.clear();
        let area = area_vector(corners);
        if !is_fan(corners, area) && self.may_work(corners.len()) {
            self.cut_ears(corners, area);
        }
        if self.triangles.is_empty() {
            for i in 2..corners.len() as u32 {
                self.triangles.extend([0, i - 1, i]);
            }
        }
        self.triangles.as_chunks::<3>().0.iter().copied()
    }

    fn may_work(&mut self, n: usize) -> bool {
        let work = self.work.saturating_add((n as u64).saturating_pow(3));
        if work > MAX_WORK {
            self.n_fans += 1;
            return false;
        }
        self.work = work;
        true
    }

    fn cut_ears(&mut self, corners: &[DVec3], area: DVec3) {
        // Projected along the axis nearest to the normal, from the side where it is counter-clockwise: no coordinate
        // is rounded.
        let sizes = area.abs();
        let (u, v) = if sizes.x >= sizes.y && sizes.x >= sizes.z {
            (1, 2)
        } else if sizes.y >= sizes.z {
            (2, 0)
        } else {
            (0, 1)
        };
        let (u, v) = if area[3 - u - v] > 0.0 {
            (u, v)
        } else {
            (v, u)
        };
        self.flat.clear();
        // Relative to the first corner: products of large coordinates lose the small differences.
        self.flat.extend(corners.iter().map(|&p| {
            let p = p - corners[0];
            [p[u], p[v]]
        }));
        let holes: &[u32] = &[];
        self.earcut
            .earcut(self.flat.iter().copied(), holes, &mut self.triangles);
        let flat = &self.flat;
        for triangle in self.triangles.as_chunks_mut::<3>().0 {
            let [a, b, c] = triangle.map(|i| flat[i as usize]);
            let turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            if turn < 0.0 {
                triangle.swap(1, 2);
            }
        }
    }
}

/// Twice the area vector of a polygon (Newell).
fn area_vector(corners: &[DVec3]) -> DVec3 {
    fan(corners).sum()
}

/// Twice the area vectors of the triangles of a fan from the first corner.
fn fan(corners: &[DVec3]) -> impl Iterator<Item = DVec3> {
    let first = corners[0];
    corners[1..]
        .windows(2)
        .map(move |pair| (pair[0] - first).cross(pair[1] - first))
}

/// Whether a fan from the first corner covers the polygon exactly: none of its triangles is outside. This holds for
/// every convex polygon.
fn is_fan(corners: &[DVec3], area: DVec3) -> bool {
    let least = -ROUNDING * area.length_squared();
    corners.len() == 3 || fan(corners).all(|triangle| triangle.dot(area) >= least)
}

//! Meshes made from formulas: those that the project distributes (without licence restrictions, because they are
//! generated here), and those that tests and the laboratory trace. y up, metres, closed.

mod teapot;

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, Vec3};

use crate::scene::Mesh;

/// Segments per side of a teapot patch.
const TEAPOT_SIDE: u32 = 16;

/// Width of the teapot from handle to spout, metres.
const TEAPOT_WIDTH_M: f64 = 0.24;

/// Corners whose normals differ by a larger angle stay separate vertices, as cosine (40 degrees): a smaller angle is
/// a smooth surface, a larger one a crease.
const CREASE_COS: f64 = 0.77;

/// A triangle corner: position and normal.
type Corner = (DVec3, DVec3);

/// Triangles with normals, not indexed.
#[derive(Default)]
struct Soup {
    triangles: Vec<[Corner; 3]>,
}

impl Soup {
    fn triangle(&mut self, corners: [Corner; 3]) {
        let [a, b, c] = corners.map(|c| weld_key(c.0));
        // At the pole of a patch two corners coincide.
        if a != b && b != c && c != a {
            self.triangles.push(corners);
        }
    }

    /// Quads over a grid of corners; u runs fastest, the outside is the direction of u x v.
    fn grid(&mut self, columns: u32, rows: u32, corner: impl Fn(u32, u32) -> Corner) {
        for j in 0..rows {
            for i in 0..columns {
                let q = [
                    corner(i, j),
                    corner(i + 1, j),
                    corner(i + 1, j + 1),
                    corner(i, j + 1),
                ];
                self.triangle([q[0], q[1], q[2]]);
                self.triangle([q[0], q[2], q[3]]);
            }
        }
    }

    /// A flat cap over a loop that is counter-clockwise seen from `normal`.
    fn cap(&mut self, ring: &[DVec3], normal: DVec3) {
        let centre = ring.iter().sum::<DVec3>() / ring.len() as f64;
        for (i, &a) in ring.iter().enumerate() {
            let b = ring[(i + 1) % ring.len()];
            self.triangle([(centre, normal), (a, normal), (b, normal)]);
        }
    }

    /// A solid of revolution around y; the profile is (radius, height) with the outside on its right. Sharp bends of
    /// the profile become creases.
    fn turned(&mut self, profile: &[DVec2], segments: u32) {
        let slopes: Vec<DVec2> = profile
            .windows(2)
            .map(|p| {
                let d = p[1] - p[0];
                DVec2::new(d.y, -d.x).normalize_or_zero()
            })
            .collect();
        let closed = profile.first() == profile.last();
        let n = slopes.len();
        for (k, span) in profile.windows(2).enumerate() {
            let blend = |other: Option<usize>| match other.map(|i| slopes[i]) {
                Some(s) if s.dot(slopes[k]) > CREASE_COS => (s + slopes[k]).normalize_or_zero(),
                _ => slopes[k],
            };
            let before = blend(k.checked_sub(1).or(closed.then_some(n - 1)));
            let after = blend(if k + 1 < n {
                Some(k + 1)
            } else {
                closed.then_some(0)
            });
            self.grid(segments, 1, |i, j| {
                let (p, normal) = if j == 0 {
                    (span[0], before)
                } else {
                    (span[1], after)
                };
                // Angles decrease, so that u x v points outwards with y up.
                let (sin, cos) = (-TAU * f64::from(i % segments) / f64::from(segments)).sin_cos();
                (
                    DVec3::new(p.x * cos, p.y, p.x * sin),
                    DVec3::new(normal.x * cos, normal.y, normal.x * sin),
                )
            });
        }
    }

    /// The indexed mesh: equal positions become bit-identical, and become one vertex unless a crease separates them.
    fn index(self) -> Mesh {
        let mut mesh = Mesh::default();
        let mut sums: Vec<DVec3> = Vec::new();
        let mut at: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        for corners in self.triangles {
            let triangle = corners.map(|(position, normal)| {
                let here = at.entry(weld_key(position)).or_default();
                let found = here
                    .iter()
                    .copied()
                    .find(|&i| sums[i as usize].normalize_or_zero().dot(normal) > CREASE_COS);
                if let Some(i) = found {
                    sums[i as usize] += normal;
                    return i;
                }
                let i = mesh.positions.len() as u32;
                // The coordinates of the first corner are used for all coincident corners.
                let exact = here
                    .first()
                    .map_or(position.as_vec3(), |&k| mesh.positions[k as usize]);
                mesh.positions.push(exact);
                sums.push(normal);
                here.push(i);
                i
            });
            mesh.triangles.push(triangle);
        }
        mesh.normals = sums
            .iter()
            .map(|n| n.normalize_or_zero().as_vec3())
            .collect();
        mesh
    }
}

/// Positions within a tenth of a micrometre are equal: patches that share a border evaluate it with the same control
/// points, so they differ only by f64 rounding.
fn weld_key(p: DVec3) -> [i64; 3] {
    (p * 1e7).to_array().map(|x| x.round() as i64)
}

/// The Utah teapot with `side` segments along each side of its 32 patches; 0.24 m from handle to spout.
pub fn teapot(side: u32) -> Mesh {
    let side = side.max(1);
    let patches = teapot::patches();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for patch in &patches {
        for i in 0..=64 {
            for j in 0..=64 {
                let x = teapot::evaluate(patch, f64::from(i) / 64.0, f64::from(j) / 64.0)
                    .0
                    .x;
                (low, high) = (low.min(x), high.max(x));
            }
        }
    }
    let scale = TEAPOT_WIDTH_M / (high - low);
    // From Newell's z up to y up: a rotation about x.
    let place = |p: DVec3| DVec3::new(p.x, p.z, -p.y) * scale;
    let turn = |n: DVec3| DVec3::new(n.x, n.z, -n.y);
    let at = |i: u32| f64::from(i) / f64::from(side);
    let mut soup = Soup::default();
    for patch in &patches {
        soup.grid(side, side, |i, j| {
            let (p, normal) = teapot::evaluate(patch, at(i), at(j));
            // The poles are on the axis, on top of the lid and under the bottom.
            let normal = normal.unwrap_or(DVec3::Z * if p.z > 1.0 { 1.0 } else { -1.0 });
            (place(p), turn(normal))
        });
    }
    // Loops that are open in Newell's model, each as the border of a patch at v = 0 or 1.
    let border = |k: usize, v: f64| -> Vec<DVec3> {
        (0..side)
            .map(|i| place(teapot::evaluate(&patches[k], at(i), v).0))
            .collect()
    };
    // Lid (patches 16..20, v = 1) to rim (0..4, v = 0).
    for quarter in 0..4 {
        let (rim, lid) = (&patches[quarter], &patches[16 + quarter]);
        soup.grid(side, 1, |i, j| {
            let p = if j == 0 {
                teapot::evaluate(lid, at(i), 1.0).0
            } else {
                teapot::evaluate(rim, at(i), 0.0).0
            };
            (place(p), DVec3::Y)
        });
    }
    // Handle (24..28) and spout (28..32): a pair of patches per loop.
    for (k, v) in [(24, 0.0), (26, 1.0), (28, 0.0), (30, 1.0)] {
        let mut ring = border(k, v);
        ring.extend(border(k + 1, v));
        // u is reversed in the second of a pair, so together they form a closed loop. The patches' triangles use this
        // border along u at v = 0 and against it at v = 1; the cap must use the opposite direction.
        if v == 0.0 {
            ring.reverse();
        }
        let mut normal = DVec3::ZERO;
        for i in 0..ring.len() {
            normal += ring[i].cross(ring[(i + 1) % ring.len()]);
        }
        soup.cap(&ring, normal.normalize_or_zero());
    }
    soup.index()
}

/// A sphere from a subdivided icosahedron.
pub fn sphere(radius: f64, subdivisions: u32) -> Mesh {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut corners = Vec::new();
    for a in [-1.0, 1.0] {
        for b in [-g, g] {
            corners.extend([
                DVec3::new(0.0, a, b),
                DVec3::new(a, b, 0.0),
                DVec3::new(b, 0.0, a),
            ]);
        }
    }
    let mut faces: Vec<[DVec3; 3]> = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let [a, b, c] = [corners[i], corners[j], corners[k]];
                // Edges of this icosahedron have length 2.
                let edge = |p: DVec3, q: DVec3| (p.distance(q) - 2.0).abs() < 1e-9;
                if edge(a, b) && edge(b, c) && edge(c, a) {
                    let outside = (b - a).cross(c - a).dot(a) > 0.0;
                    faces.push(if outside { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..subdivisions {
        faces = faces
            .into_iter()
            .flat_map(|[a, b, c]| {
                let middle = |p: DVec3, q: DVec3| {
                    (p.normalize_or_zero() + q.normalize_or_zero()).normalize_or_zero()
                };
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let mut soup = Soup::default();
    for face in faces {
        soup.triangle(face.map(|p| {
            let n = p.normalize_or_zero();
            ((n + DVec3::Y) * radius, n)
        }));
    }
    soup.index()
}

/// A ring: a torus of tube radius `tube` lying flat around the y axis.
pub fn ring(radius: f64, tube: f64, segments: u32, tube_segments: u32) -> Mesh {
    let mut profile: Vec<DVec2> = (0..tube_segments)
        .map(|i| {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(tube_segments)).sin_cos();
            DVec2::new(radius + tube * cos, tube + tube * sin)
        })
        .collect();
    profile.extend(profile.first().copied());
    let mut soup = Soup::default();
    soup.turned(&profile, segments);
    soup.index()
}

/// A cylinder with its edges rounded by `bevel`.
pub fn cylinder(radius: f64, height: f64, bevel: f64, segments: u32) -> Mesh {
    let mut profile = vec![DVec2::ZERO];
    for (centre, from) in [(bevel, -0.5 * PI), (height - bevel, 0.0)] {
        profile.extend((0..=6).map(|i| {
            let (sin, cos) = (from + 0.5 * PI * f64::from(i) / 6.0).sin_cos();
            DVec2::new(radius - bevel + bevel * cos, centre + bevel * sin)
        }));
    }
    profile.push(DVec2::new(0.0, height));
    let mut soup = Soup::default();
    soup.turned(&profile, segments);
    soup.index()
}

/// A cone.
pub fn cone(radius: f64, height: f64, segments: u32) -> Mesh {
    let mut soup = Soup::default();
    soup.turned(
        &[
            DVec2::ZERO,
            DVec2::new(radius, 0.0),
            // A second ring just under the tip, so that the tip gets normals of its own.
            DVec2::new(radius * 0.02, height * 0.98),
            DVec2::new(0.0, height),
        ],
        segments,
    );
    soup.index()
}

/// A cube whose edges are rounded by `bevel`.
pub fn cube(side: f64, bevel: f64) -> Mesh {
    const ROUND: u32 = 5;
    let inner = side * 0.5 - bevel;
    // A sphere stretched along the axes: coordinates of a grid over one face of a cube.
    let steps = 2 * ROUND + 1;
    let coordinate = |i: u32| {
        let (angle, shift) = if i <= ROUND {
            (
                -0.25 * PI + 0.25 * PI * f64::from(i) / f64::from(ROUND),
                -inner,
            )
        } else {
            (
                0.25 * PI * f64::from(i - ROUND - 1) / f64::from(ROUND),
                inner,
            )
        };
        (angle.tan(), shift)
    };
    let mut soup = Soup::default();
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let n = axes[axis] * sign;
            let u = axes[(axis + 1) % 3];
            let v = n.cross(u);
            soup.grid(steps, steps, |i, j| {
                let ((a, shift_a), (b, shift_b)) = (coordinate(i), coordinate(j));
                let normal = (n + u * a + v * b).normalize_or_zero();
                let core = n * inner + u * shift_a + v * shift_b;
                (core + normal * bevel + DVec3::Y * side * 0.5, normal)
            });
        }
    }
    soup.index()
}

/// Name and mesh of each file in `recordings/meshes`.
pub fn shipped() -> Vec<(&'static str, Mesh)> {
    vec![
        ("teapot", teapot(TEAPOT_SIDE)),
        ("sphere", sphere(0.05, 4)),
        ("ring", ring(0.045, 0.008, 128, 32)),
        ("cube", cube(0.08, 0.004)),
        ("cylinder", cylinder(0.035, 0.10, 0.003, 96)),
        ("cone", cone(0.045, 0.11, 96)),
    ]
}

/// A torus with ripples, of `2 n m` triangles.
pub fn ripples(n: u32, m: u32) -> Mesh {
    let positions = (0..n * m)
        .map(|i| {
            let a = (i / m) as f32 / n as f32 * std::f32::consts::TAU;
            let b = (i % m) as f32 / m as f32 * std::f32::consts::TAU;
            let r = 0.35 + 0.03 * (9.0 * a).sin() * (5.0 * b).cos();
            let ring = 0.65 + r * b.cos();
            Vec3::new(ring * a.cos(), r * b.sin(), ring * a.sin())
        })
        .collect();
    Mesh {
        positions,
        triangles: wrapped_grid(n, m),
        ..Mesh::default()
    }
}

/// The triangles of a grid of `n` by `m` vertices whose opposite borders are connected.
pub fn wrapped_grid(n: u32, m: u32) -> Vec<[u32; 3]> {
    let at = |i: u32, j: u32| (i % n) * m + j % m;
    (0..n * m)
        .flat_map(|k| {
            let (i, j) = (k / m, k % m);
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

#[cfg(test)]
mod tests;

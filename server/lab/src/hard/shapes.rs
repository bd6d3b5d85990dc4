//! Closed solids around the origin, and test rays.

use std::collections::HashMap;
use std::f32::consts::TAU;

use glam::{Vec3, Vec3A};

use ghostlight::accel::Ray;
use ghostlight::numerics::uniform;
use ghostlight::scene::Mesh;
use ghostlight::shapes::wrapped_grid;

/// A mesh of positions and triangles only.
pub fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
    Mesh {
        positions,
        triangles,
        ..Mesh::default()
    }
}

/// A unit sphere of 20 * 4^`levels` triangles.
pub fn icosphere(levels: u32) -> Mesh {
    let g = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let mut positions: Vec<Vec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(|p| Vec3::from(p).normalize_or_zero())
    .to_vec();
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..levels {
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut next = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    let p = positions[i as usize] + positions[j as usize];
                    positions.push(p.normalize_or_zero());
                    positions.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            next.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        triangles = next;
    }
    mesh(positions, triangles)
}

/// A torus around z of `n` by `m` quads.
pub fn torus(n: u32, m: u32) -> Mesh {
    let positions = (0..n * m)
        .map(|i| {
            let (a, b) = (
                (i / m) as f32 / n as f32 * TAU,
                (i % m) as f32 / m as f32 * TAU,
            );
            let r = 0.75 + 0.25 * b.cos();
            Vec3::new(r * a.cos(), r * a.sin(), 0.25 * b.sin())
        })
        .collect();
    mesh(positions, wrapped_grid(n, m))
}

/// The cube [-1, 1]^3, each face a grid of `n` by `n` squares, vertices shared.
pub fn cube(n: i32) -> Mesh {
    let mut positions = Vec::new();
    let mut known: HashMap<[i32; 3], u32> = HashMap::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [0, n] {
            for i in 0..n {
                for j in 0..n {
                    let [a, b, c, d] =
                        [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| {
                            let mut key = [0; 3];
                            key[axis] = side;
                            key[(axis + 1) % 3] = i;
                            key[(axis + 2) % 3] = j;
                            *known.entry(key).or_insert_with(|| {
                                let p = key.map(|k| (2 * k - n) as f32 / n as f32);
                                positions.push(Vec3::from(p));
                                positions.len() as u32 - 1
                            })
                        });
                    triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    mesh(positions, triangles)
}

/// A closed solid of long, thin triangles: a prism of `n` sides, ten thousand times as long as a side is wide.
pub fn needles(n: u32) -> Mesh {
    let mut positions = vec![Vec3::new(0.0, 0.0, -1.0), Vec3::new(0.0, 0.0, 1.0)];
    for i in 0..n {
        let a = i as f32 / n as f32 * TAU;
        let r = 2e-4 * n as f32 / TAU;
        positions.push(Vec3::new(r * a.cos(), r * a.sin(), -1.0));
        positions.push(Vec3::new(r * a.cos(), r * a.sin(), 1.0));
    }
    let triangles = (0..n)
        .flat_map(|i| {
            let (a, b) = (2 + 2 * i, 3 + 2 * i);
            let (c, d) = (2 + 2 * ((i + 1) % n), 3 + 2 * ((i + 1) % n));
            [[a, c, d], [a, d, b], [0, c, a], [1, b, d]]
        })
        .collect();
    mesh(positions, triangles)
}

/// Deterministic random numbers.
pub struct Dice(pub u32, pub u32);

impl Dice {
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        self.1 += 1;
        uniform(self.1, self.0, 7)
    }

    /// Uniform in [-1, 1).
    pub fn signed(&mut self) -> f32 {
        2.0 * self.unit() - 1.0
    }

    /// Uniform in 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f32) as usize).min(n - 1)
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> Vec3A {
        loop {
            let v = Vec3A::new(self.signed(), self.signed(), self.signed());
            if v.length_squared() <= 1.0
                && let Some(v) = v.try_normalize()
            {
                return v;
            }
        }
    }
}

/// A ray from `origin` exactly towards `target`, up to f32 rounding.
pub fn aimed(origin: Vec3A, target: Vec3A) -> Ray {
    Ray {
        origin,
        direction: target - origin,
        t_min: 0.0,
        t_max: f32::INFINITY,
    }
}

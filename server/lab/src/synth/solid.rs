//! Builds the room's geometry: rectangles, chamfered boxes, solids of revolution, tubes and leaves.

use std::f64::consts::TAU;

use glam::{DAffine3, DVec2, DVec3, Vec2};

use super::caster::Patch;
use super::geometry::{Facet, Material, Site, Sites};

/// The geometry collected so far.
#[derive(Debug, Default)]
pub(super) struct Builder {
    /// Surfaces.
    pub(super) patches: Vec<Patch>,
    /// One per patch.
    pub(super) facets: Vec<Facet>,
    /// All irradiance sites.
    pub(super) sites: Vec<Site>,
    /// Pairs of neighbouring sites, across which baked light may be smoothed.
    pub(super) links: Vec<[u32; 2]>,
    /// Materials.
    pub(super) materials: Vec<Material>,
    /// Factor on every distance between sites; above 1, baking is faster and coarser.
    pub(super) coarseness: f64,
}

/// Distance of the outermost sites from a rectangle's border, metres: exactly on the border, half of the
/// hemisphere is inside the neighbouring surface.
const BORDER_M: f64 = 0.0015;

/// Bends sharper than this are creases, radians.
const CREASE_RAD: f64 = 0.6;

impl Builder {
    /// Adds a material.
    pub(super) fn material(&mut self, material: Material) -> u16 {
        self.materials.push(material);
        (self.materials.len() - 1) as u16
    }

    /// A rectangle whose outside is towards `e1 x e2`. `texel_m` is the distance between sites.
    pub(super) fn rectangle(
        &mut self,
        origin: DVec3,
        e1: DVec3,
        e2: DVec3,
        material: u16,
        texel_m: f64,
    ) {
        let normal = e1.cross(e2).normalize_or_zero();
        let (w, h) = (e1.length(), e2.length());
        let count =
            |side: f64| ((side / (texel_m * self.coarseness)).round() as u32 + 1).clamp(2, 512);
        let (columns, rows) = (count(w), count(h));
        let first = self.sites.len() as u32;
        let inset = |i: u32, n: u32, side: f64| {
            let border = (BORDER_M / side).min(0.25);
            (f64::from(i) / f64::from(n - 1)).clamp(border, 1.0 - border)
        };
        for j in 0..rows {
            for i in 0..columns {
                let index = first + j * columns + i;
                self.sites.push(Site {
                    position: origin + e1 * inset(i, columns, w) + e2 * inset(j, rows, h),
                    normal,
                });
                if i > 0 {
                    self.links.push([index - 1, index]);
                }
                if j > 0 {
                    self.links.push([index - columns, index]);
                }
            }
        }
        self.patches.push(Patch {
            origin,
            e1,
            e2,
            triangle: false,
        });
        self.facets.push(Facet {
            normal,
            material,
            size_m: Vec2::new(w as f32, h as f32),
            sites: Sites::Grid {
                first,
                columns,
                rows,
            },
        });
    }

    fn triangle(&mut self, sites: [u32; 3], uv: [Vec2; 3], m: [Vec2; 3], material: u16) {
        let [a, b, c] = sites.map(|i| self.sites[i as usize].position);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if normal == DVec3::ZERO {
            return;
        }
        self.patches.push(Patch {
            origin: a,
            e1: b - a,
            e2: c - a,
            triangle: true,
        });
        self.facets.push(Facet {
            normal,
            material,
            size_m: Vec2::ZERO,
            sites: Sites::Corners { sites, uv, m },
        });
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            self.links.push([sites[a], sites[b]]);
        }
    }

    /// A box with chamfered edges. `frame` is world from box; the bottom of the box is at z = 0, centred on the
    /// origin. Materials: bottom, top, front (-y), back (+y), left (-x), right (+x).
    pub(super) fn chamfered_box(
        &mut self,
        frame: &DAffine3,
        size: DVec3,
        chamfer: f64,
        materials: [u16; 6],
        texel_m: f64,
    ) {
        let half = size * 0.5;
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let place = |p: DVec3| frame.transform_point3(p + DVec3::Z * half.z);
        let material = |axis: usize, sign: f64| {
            let side = usize::from(sign > 0.0);
            materials[match axis {
                2 => side,
                1 => 2 + side,
                _ => 4 + side,
            }]
        };
        // Seen from outside, u points to the right and v up (on top, away from the viewer).
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let normal = axes[axis] * sign;
                let u = if axis == 2 {
                    DVec3::X
                } else {
                    normal.cross(DVec3::NEG_Z)
                };
                let v = normal.cross(u);
                let (lu, lv) = (half.dot(u.abs()) - chamfer, half.dot(v.abs()) - chamfer);
                let corner = normal * half[axis] - u * lu - v * lv;
                self.rectangle(
                    place(corner),
                    frame.transform_vector3(u * lu * 2.0),
                    frame.transform_vector3(v * lv * 2.0),
                    material(axis, sign),
                    texel_m,
                );
            }
        }
        if chamfer <= 0.0 {
            return;
        }
        for axis in 0..3 {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            for sb in [-1.0, 1.0] {
                for sc in [-1.0, 1.0] {
                    let from = axes[b] * sb * half[b] + axes[c] * sc * (half[c] - chamfer)
                        - axes[axis] * (half[axis] - chamfer);
                    let along = axes[axis] * (half[axis] - chamfer) * 2.0;
                    let across = axes[c] * sc * chamfer - axes[b] * sb * chamfer;
                    let outside = along.cross(across).dot(axes[b] * sb + axes[c] * sc) > 0.0;
                    let (e1, e2) = if outside {
                        (along, across)
                    } else {
                        (across, along)
                    };
                    self.rectangle(
                        place(from),
                        frame.transform_vector3(e1),
                        frame.transform_vector3(e2),
                        material(b, sb),
                        texel_m.max(0.02),
                    );
                }
            }
        }
        for sx in [-1.0, 1.0] {
            for sy in [-1.0, 1.0] {
                for sz in [-1.0, 1.0] {
                    let s = DVec3::new(sx, sy, sz);
                    let corner = |axis: usize| {
                        let mut p = s * (half - chamfer);
                        p[axis] = s[axis] * half[axis];
                        place(p)
                    };
                    let mut order = [corner(0), corner(1), corner(2)];
                    if sx * sy * sz < 0.0 {
                        order.swap(1, 2);
                    }
                    let normal = frame.transform_vector3(s).normalize_or_zero();
                    let first = self.sites.len() as u32;
                    self.sites
                        .extend(order.map(|position| Site { position, normal }));
                    self.triangle(
                        [first, first + 1, first + 2],
                        [Vec2::splat(0.5); 3],
                        [Vec2::ZERO; 3],
                        material(0, sx),
                    );
                }
            }
        }
    }

    /// A solid of revolution around the frame's z axis. The profile holds (radius, height) in metres, with the
    /// outside to the right of its direction.
    pub(super) fn turned(
        &mut self,
        frame: &DAffine3,
        profile: &[DVec2],
        segments: u32,
        material: u16,
    ) {
        let rotated = |slope: DVec2| DVec2::new(slope.y, -slope.x).normalize_or_zero();
        let normals: Vec<DVec2> = profile.windows(2).map(|p| rotated(p[1] - p[0])).collect();
        let length: f64 = profile.windows(2).map(|p| p[0].distance(p[1])).sum();
        let normal_frame = frame.matrix3.inverse().transpose();
        let widest = profile.iter().fold(0.0f64, |a, p| a.max(p.x));
        let mut along = 0.0;
        let mut previous: Option<u32> = None;
        for (k, span) in profile.windows(2).enumerate() {
            let blend = |other: Option<&DVec2>| match other {
                Some(n) if n.angle_to(normals[k]).abs() < CREASE_RAD => {
                    (*n + normals[k]).normalize_or_zero()
                }
                _ => normals[k],
            };
            let (before, after) = (
                blend(k.checked_sub(1).and_then(|i| normals.get(i))),
                blend(normals.get(k + 1)),
            );
            let step = span[0].distance(span[1]);
            let mut ring = |p: DVec2, n: DVec2| {
                let first = self.sites.len() as u32;
                for i in 0..=segments {
                    let (sin, cos) =
                        (TAU * f64::from(i % segments) / f64::from(segments)).sin_cos();
                    self.sites.push(Site {
                        position: frame.transform_point3(DVec3::new(p.x * cos, p.x * sin, p.y)),
                        normal: (normal_frame * DVec3::new(n.x * cos, n.x * sin, n.y))
                            .normalize_or_zero(),
                    });
                }
                first
            };
            let smooth = before != normals[k];
            let low = match previous {
                Some(first) if smooth => first,
                _ => ring(span[0], before),
            };
            let high = ring(span[1], after);
            let coordinate = |i: u32, s: f64| {
                let u = f64::from(i) / f64::from(segments);
                (
                    Vec2::new(u as f32, (s / length) as f32),
                    Vec2::new((u * TAU * widest) as f32, s as f32),
                )
            };
            for i in 0..segments {
                let corners = [
                    (low + i, coordinate(i, along)),
                    (low + i + 1, coordinate(i + 1, along)),
                    (high + i, coordinate(i, along + step)),
                    (high + i + 1, coordinate(i + 1, along + step)),
                ];
                for [a, b, c] in [[0, 1, 2], [1, 3, 2]] {
                    let [a, b, c] = [corners[a], corners[b], corners[c]];
                    self.triangle(
                        [a.0, b.0, c.0],
                        [a.1.0, b.1.0, c.1.0],
                        [a.1.1, b.1.1, c.1.1],
                        material,
                    );
                }
            }
            along += step;
            previous = Some(high);
        }
    }

    /// A round bar from `a` to `b`, metres.
    pub(super) fn bar(&mut self, a: DVec3, b: DVec3, radius: f64, material: u16) {
        let length = a.distance(b);
        let turn = glam::DQuat::from_rotation_arc(DVec3::Z, ((b - a) / length).normalize_or_zero());
        let profile = [(0.0, 0.0), (radius, 0.0), (radius, length), (0.0, length)];
        self.turned(
            &DAffine3::from_rotation_translation(turn, a),
            &profile.map(|(r, z)| DVec2::new(r, z)),
            24,
            material,
        );
    }

    /// A round tube through `points`, which are in a plane with the normal `side`. Its ends are open and must be
    /// inside another object.
    pub(super) fn tube(&mut self, points: &[DVec3], side: DVec3, radius: f64, material: u16) {
        const SEGMENTS: u32 = 20;
        let n = points.len();
        let first = self.sites.len() as u32;
        for i in 0..n {
            let along = points[(i + 1).min(n - 1)] - points[i.saturating_sub(1)];
            let out = side.cross(along).normalize_or_zero();
            for k in 0..=SEGMENTS {
                let (sin, cos) = (TAU * f64::from(k % SEGMENTS) / f64::from(SEGMENTS)).sin_cos();
                let normal = out * cos + side * sin;
                self.sites.push(Site {
                    position: points[i] + normal * radius,
                    normal,
                });
            }
        }
        let corner = |i: usize, k: u32| {
            let uv = Vec2::new(k as f32 / SEGMENTS as f32, i as f32 / (n - 1).max(1) as f32);
            (first + i as u32 * (SEGMENTS + 1) + k, uv, uv * 0.03)
        };
        for i in 0..n - 1 {
            for k in 0..SEGMENTS {
                let q = [
                    corner(i, k),
                    corner(i, k + 1),
                    corner(i + 1, k + 1),
                    corner(i + 1, k),
                ];
                for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                    let t = [q[a], q[b], q[c]];
                    self.triangle(t.map(|x| x.0), t.map(|x| x.1), t.map(|x| x.2), material);
                }
            }
        }
    }

    /// A strip through `spine` points with half-widths `half` along `sides`: two surfaces 0.4 mm apart, so that
    /// each face has its own light.
    pub(super) fn leaf(&mut self, spine: &[DVec3], sides: &[DVec3], half: &[f64], material: u16) {
        const THICKNESS_M: f64 = 4e-4;
        let n = spine.len();
        for face in [1.0, -1.0] {
            let first = self.sites.len() as u32;
            for i in 0..n {
                let along = spine[(i + 1).min(n - 1)] - spine[i.saturating_sub(1)];
                let normal = sides[i].cross(along).normalize_or_zero() * face;
                for k in [-1.0, 0.0, 1.0] {
                    // Leaves fold upwards slightly along the rib.
                    let fold = normal * face * half[i] * 0.25 * f64::abs(k);
                    self.sites.push(Site {
                        position: spine[i]
                            + sides[i] * half[i] * k
                            + fold
                            + normal * THICKNESS_M * 0.5,
                        normal: (normal - sides[i] * k * 0.25 * face).normalize_or_zero(),
                    });
                }
            }
            let corner = |i: usize, k: usize| {
                let uv = Vec2::new(k as f32 * 0.5, i as f32 / (n - 1) as f32);
                (first + (i * 3 + k) as u32, uv, uv * Vec2::new(0.03, 0.2))
            };
            for i in 0..n - 1 {
                for k in 0..2 {
                    let q = [
                        corner(i, k),
                        corner(i, k + 1),
                        corner(i + 1, k + 1),
                        corner(i + 1, k),
                    ];
                    for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                        let (b, c) = if face > 0.0 { (b, c) } else { (c, b) };
                        let t = [q[a], q[b], q[c]];
                        self.triangle(t.map(|x| x.0), t.map(|x| x.1), t.map(|x| x.2), material);
                    }
                }
            }
        }
    }
}

//! A mesh in several versions, and which of them a frame shows.
//!
//! How far a version is off is measured, not taken on trust: rays from all over the mesh along its
//! normals find how far away the version lies, and how its normals are turned there.

use std::sync::Arc;

use glam::{Affine3A, Vec3A, Vec4};
use rayon::prelude::*;

use crate::accel::{Blas, BuildLimits, Hit, MASK_VIRTUAL, Ray, Tlas, TlasInstance};
use crate::scene::{Mesh, coarser, takes_forever};

use super::super::Checkpoint;
use super::Placed;

/// Places on a mesh that a version is measured at.
const PROBES: usize = 1 << 15;

/// Share of the probes whose position is off by no more than a version is said to be.
const SHARE: f32 = 0.999;

/// How far shading of a surface that is no mirror moves where normals are turned, as a share of how far
/// mirrored things do: a heuristic.
const MATTE: f32 = 0.25;

/// Least difference of a vertex colour (linear, 0..=1) that is told apart: a heuristic, about five
/// codes of a bright picture.
const COLOR_STEP: f32 = 0.04;

/// Farthest that a version is looked for, as a share of the mesh's radius.
const FARTHEST: f32 = 0.05;

/// One version of a mesh, ready for rays.
pub(super) struct Version {
    pub(super) mesh: Arc<Mesh>,
    pub(super) blas: Arc<Blas>,
    deviation: Deviation,
}

/// How far a version of a mesh is off.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Deviation {
    /// Along the normal, object units: nearly nowhere more ([`SHARE`]).
    position: f32,
    /// Of normals, radians: root mean square.
    normal: f32,
    /// Of vertex colours, object units: how far they are smeared, nearly nowhere more ([`SHARE`]).
    /// Where a colour differs by more than [`COLOR_STEP`], that is the version's triangle's size.
    color: f32,
}

/// What a version is wanted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Use {
    /// To be seen, and things mirrored in it or through it.
    Specular,
    /// To be seen.
    Matte,
    /// To cast shadows on other things.
    Shadow,
}

/// Nodes and leaves of a version's tree that its probes' rays may visit in all: of most meshes they
/// visit a tenth of it. Where triangles overlap in thousands fewer probes are taken.
const MOST_VISITS: usize = 1 << 24;

/// Fewest probes that a version is believed after.
const LEAST_PROBES: usize = 1 << 10;

/// Rays by which the visits of all are told.
const SCOUTS: usize = 256;

/// A mesh as it is and in coarser versions.
pub(super) struct Shape {
    /// Finest first; the first is the mesh itself.
    pub(super) versions: Vec<Version>,
    /// The mesh would have coarser versions, but they take too long to make.
    pub(super) without_versions: bool,
    /// Centre and radius of a ball around the mesh, object space.
    pub(super) ball: Option<(Vec3A, f32)>,
}

impl Shape {
    /// Simplifies a mesh if it is large, and builds its trees; what is wrong with it if that fails.
    /// It has fewer versions, or none, when `checkpoint` gives up.
    pub(super) fn new(mesh: &Arc<Mesh>, checkpoint: &dyn Checkpoint) -> Result<Self, String> {
        let go_on = || checkpoint.go_on();
        let build = |mesh: &Mesh| {
            let blas = Blas::build(mesh, BuildLimits::default()).map_err(|e| e.to_string())?;
            Ok::<_, String>(Arc::new(blas))
        };
        let ball = ball_around(mesh);
        let reach = ball.map_or(0.0, |(_, radius)| radius * FARTHEST);
        let (finest, coarser) = rayon::join(
            || build(mesh),
            || {
                let version = |coarse: Mesh| {
                    if !go_on() {
                        return Ok(None);
                    }
                    let blas = build(&coarse)?;
                    let deviation = Deviation::measured(mesh, &coarse, &blas, reach);
                    Ok(deviation.map(|deviation| Version {
                        mesh: Arc::new(coarse),
                        blas,
                        deviation,
                    }))
                };
                let coarser = coarser(mesh, &go_on).into_par_iter();
                coarser.map(version).collect::<Result<Vec<_>, String>>()
            },
        );
        let mut versions = vec![Version {
            mesh: mesh.clone(),
            blas: finest?,
            deviation: Deviation::default(),
        }];
        let coarser = coarser?;
        let unmeasured = coarser.iter().any(Option::is_none);
        versions.extend(coarser.into_iter().flatten());
        Ok(Self {
            without_versions: versions.len() == 1 && (unmeasured || takes_forever(mesh)),
            versions,
            ball,
        })
    }

    /// Memory held, bytes, beside the mesh itself.
    pub(super) fn memory(&self) -> u64 {
        let trees = self.versions.iter().map(|v| v.blas.memory() as u64);
        let coarser = self.versions[1..].iter().map(|v| v.mesh.bytes());
        trees.chain(coarser).sum()
    }

    /// The coarsest version that is off by no more than `limit_px` pixels where it is nearest to a
    /// camera of focal length `focal_px`.
    pub(super) fn version_for(
        &self,
        wanted: Use,
        placed: &Placed,
        focal_px: f32,
        limit_px: f32,
    ) -> usize {
        let Some(ball) = self.ball.filter(|_| self.versions.len() > 1) else {
            return 0;
        };
        let (center, radius) = placed.ball(ball);
        let nearest = center.length() - radius;
        if nearest <= 0.0 {
            return 0;
        }
        let px_per_unit = focal_px * radius / (ball.1 * nearest);
        // Where a normal is turned, what a surface shows moves over it by the angle times the radius
        // of curvature: a normal of that direction is found that far away. Of a mirror, the mesh's
        // own radius is taken for that; gentle shading shows less of it.
        let px_per_radian = match wanted {
            Use::Specular => px_per_unit * ball.1,
            Use::Matte => px_per_unit * ball.1 * MATTE,
            Use::Shadow => 0.0,
        };
        let good = |Version { deviation, .. }: &Version| {
            let normal = deviation.normal * px_per_radian;
            let color = match wanted {
                Use::Specular | Use::Matte => deviation.color * px_per_unit,
                Use::Shadow => 0.0,
            };
            (deviation.position * px_per_unit).max(normal).max(color) <= limit_px
        };
        self.versions.iter().rposition(good).unwrap_or(0)
    }
}

impl Deviation {
    /// How far `coarse` is off from `mesh`, looked for up to `reach` object units away; `None` where
    /// there is no area to look from, or looking would take too long.
    fn measured(mesh: &Mesh, coarse: &Mesh, blas: &Arc<Blas>, reach: f32) -> Option<Self> {
        let mut tlas = Tlas::new();
        tlas.rebuild(&[TlasInstance {
            blas: blas.clone(),
            camera_from_object: Affine3A::IDENTITY,
            mask: MASK_VIRTUAL,
            filtered: false,
        }]);
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        let mut colors = Vec::new();
        let stride = stride(mesh, blas, reach)?;
        for triangle in (0..mesh.triangles.len()).step_by(stride) {
            let Some(flat) = flat_normal(mesh, triangle) else {
                continue;
            };
            let third = 1.0 / 3.0;
            let at = |i: u32| Vec3A::from(mesh.positions[i as usize]);
            let [a, b, c] = mesh.triangles[triangle].map(at);
            let origin = (a + b + c) * third;
            let met = |direction: Vec3A| {
                tlas.intersect(
                    &Ray {
                        origin,
                        direction,
                        t_min: 0.0,
                        t_max: reach,
                    },
                    MASK_VIRTUAL,
                )
            };
            let nearest = [met(flat), met(-flat)]
                .into_iter()
                .flatten()
                .min_by(|x, y| x.t.total_cmp(&y.t));
            let Some(hit) = nearest else {
                positions.push(reach);
                continue;
            };
            positions.push(hit.t);
            let here = normal_at(mesh, triangle, third, third);
            let Hit { u, v, .. } = hit;
            let there = normal_at(coarse, hit.triangle as usize, u, v);
            if let (Some(here), Some(there)) = (here, there) {
                normals.push(here.angle_between(there));
            }
            if !mesh.colors.is_empty() {
                let here = color_at(mesh, triangle, third, third);
                let there = color_at(coarse, hit.triangle as usize, u, v);
                let differs = (here - there).abs().max_element() > COLOR_STEP;
                let size = longest_side(coarse, hit.triangle as usize);
                colors.push(if differs { size } else { 0.0 });
            }
        }
        positions.sort_unstable_by(f32::total_cmp);
        let last = positions.len().checked_sub(1)? as f32;
        colors.sort_unstable_by(f32::total_cmp);
        let last_color = colors.len().saturating_sub(1) as f32;
        let squares: f32 = normals.iter().map(|angle| angle * angle).sum();
        Some(Self {
            position: positions[(last * SHARE) as usize],
            normal: (squares / normals.len().max(1) as f32).sqrt(),
            color: colors
                .get((last_color * SHARE) as usize)
                .copied()
                .unwrap_or(0.0),
        })
    }
}

/// How many triangles apart probes lie, so that their rays visit no more than [`MOST_VISITS`] nodes;
/// `None` if that leaves too few of them. Counted, not timed: the same mesh gets the same versions.
fn stride(mesh: &Mesh, blas: &Blas, reach: f32) -> Option<usize> {
    let n_triangles = mesh.triangles.len();
    let n_probes = n_triangles.min(PROBES);
    let (mut n_scouts, mut visits) = (0, 0);
    for triangle in (0..n_triangles).step_by(n_triangles.div_ceil(SCOUTS).max(1)) {
        let Some(flat) = flat_normal(mesh, triangle) else {
            continue;
        };
        let at = |i: u32| Vec3A::from(mesh.positions[i as usize]);
        let [a, b, c] = mesh.triangles[triangle].map(at);
        let origin = (a + b + c) * (1.0 / 3.0);
        for end in [origin + flat * reach, origin - flat * reach] {
            visits += blas.visits(origin, end, MOST_VISITS / SCOUTS);
        }
        n_scouts += 1;
    }
    let of_all = visits * n_probes / n_scouts.max(1);
    let affordable = match of_all {
        0..=MOST_VISITS => PROBES,
        more => (n_probes as u64 * MOST_VISITS as u64 / more as u64) as usize,
    };
    (affordable >= LEAST_PROBES).then(|| n_triangles.div_ceil(affordable))
}

/// A triangle's own unit normal; `None` without area.
fn flat_normal(mesh: &Mesh, triangle: usize) -> Option<Vec3A> {
    let at = |i: u32| Vec3A::from(mesh.positions[i as usize]);
    let [a, b, c] = mesh.triangles[triangle].map(at);
    (b - a).cross(c - a).try_normalize()
}

/// The normal that shading sees at a place on a triangle.
fn normal_at(mesh: &Mesh, triangle: usize, u: f32, v: f32) -> Option<Vec3A> {
    if mesh.normals.is_empty() {
        return flat_normal(mesh, triangle);
    }
    let at = |i: u32| Vec3A::from(mesh.normals[i as usize]);
    let [a, b, c] = mesh.triangles[triangle].map(at);
    (a * (1.0 - u - v) + b * u + c * v).try_normalize()
}

/// The vertex colour at a place on a triangle.
fn color_at(mesh: &Mesh, triangle: usize, u: f32, v: f32) -> Vec4 {
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.colors[i as usize]);
    a * (1.0 - u - v) + b * u + c * v
}

/// The longest side of a triangle, object units.
fn longest_side(mesh: &Mesh, triangle: usize) -> f32 {
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.positions[i as usize]);
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// A ball around a mesh, object space: that around the middle of its box.
fn ball_around(mesh: &Mesh) -> Option<(Vec3A, f32)> {
    let (low, high) = mesh.bounds()?;
    let middle = (low + high) * 0.5;
    let radius = mesh
        .positions
        .iter()
        .map(|p| p.distance_squared(middle))
        .fold(0.0, f32::max)
        .sqrt();
    Some((middle.into(), radius))
}

#[cfg(test)]
mod tests {
    use glam::{Mat3A, Vec3};

    use super::*;
    use crate::render::Uninterrupted;

    fn shape(mesh: &Arc<Mesh>) -> Result<Shape, String> {
        Shape::new(mesh, &Uninterrupted)
    }

    #[test]
    fn ordinary_meshes_are_probed_as_often_as_there_may_be() {
        let stride_of = |mesh: &Mesh| {
            let blas = Blas::build(mesh, BuildLimits::default()).unwrap();
            stride(mesh, &blas, 0.05)
        };
        assert_eq!(stride_of(&torus(64, 32)), Some(1));
        assert_eq!(stride_of(&torus(512, 256)), Some(8));
    }

    #[test]
    fn a_mesh_that_takes_forever_is_without_versions_and_says_so() {
        let n = 40_000u32;
        let rim = |i: u32| {
            let (sin, cos) = (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
            Vec3::new(cos, 0.0, sin)
        };
        let mesh = Mesh {
            positions: (0..n).map(rim).chain([Vec3::Y]).collect(),
            triangles: (0..n).map(|i| [n, (i + 1) % n, i]).collect(),
            ..Mesh::default()
        };
        let fan = shape(&Arc::new(mesh)).unwrap();
        assert!(fan.without_versions && fan.versions.len() == 1);
        assert!(!shape(&Arc::new(torus(64, 32))).unwrap().without_versions);
    }
    use crate::hard::shapes::wrapped_grid;

    /// A torus of radii 1 and 0.4, its normals exact, of `2 n m` triangles.
    fn torus(n: u32, m: u32) -> Mesh {
        let angle = |k: u32, of: u32| k as f32 / of as f32 * std::f32::consts::TAU;
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for i in 0..n * m {
            let ((sa, ca), (sb, cb)) = (angle(i / m, n).sin_cos(), angle(i % m, m).sin_cos());
            let ring = 1.0 + 0.4 * cb;
            positions.push(Vec3::new(ring * ca, 0.4 * sb, ring * sa));
            normals.push(Vec3::new(cb * ca, sb, cb * sa));
        }
        Mesh {
            positions,
            normals,
            triangles: wrapped_grid(n, m),
            ..Mesh::default()
        }
    }

    /// Distance to the ideal torus's surface, and the angle of a normal to its own there.
    fn off(p: Vec3A, normal: Vec3A) -> (f32, f32) {
        let flat = Vec3A::new(p.x, 0.0, p.z);
        let tube = p - flat.try_normalize().unwrap();
        (
            (tube.length() - 0.4).abs(),
            normal.angle_between(tube.try_normalize().unwrap()),
        )
    }

    #[test]
    fn a_version_is_off_as_far_as_its_distance_from_the_ideal_surface_says() {
        let mesh = Arc::new(torus(512, 256));
        let shape = shape(&mesh).unwrap();
        assert_eq!(shape.versions.len(), 3);
        assert_eq!(shape.versions[0].deviation, Deviation::default());
        let mut before = 0.0;
        for version in &shape.versions[1..] {
            // Densely over every triangle of the version, how far off the ideal it is: what rays
            // from the mesh along its normals find must agree, but for the mesh's own distance from
            // the ideal and the one in a thousand places left out.
            let (mut farthest, mut squares, mut area) = (0.0f32, 0.0, 0.0);
            for triangle in 0..version.mesh.triangles.len() {
                let at = |i: u32| Vec3A::from(version.mesh.positions[i as usize]);
                let [a, b, c] = version.mesh.triangles[triangle].map(at);
                let size = (b - a).cross(c - a).length();
                for (u, v) in [
                    (1.0 / 3.0, 1.0 / 3.0),
                    (0.5, 0.25),
                    (0.25, 0.5),
                    (0.25, 0.25),
                ] {
                    let p = a * (1.0 - u - v) + b * u + c * v;
                    let normal = normal_at(&version.mesh, triangle, u, v).unwrap();
                    let (distance, angle) = off(p, normal);
                    farthest = farthest.max(distance);
                    squares += size * angle * angle;
                    area += size;
                }
            }
            let normal = (squares / area).sqrt();
            let Deviation {
                position,
                normal: measured,
                color,
            } = version.deviation;
            assert!(
                position < 1.1 * farthest && position > 0.4 * farthest,
                "{position} {farthest}"
            );
            assert!(
                measured < 1.5 * normal && measured > 0.67 * normal,
                "{measured} {normal}"
            );
            assert!(position > before);
            assert_eq!(color, 0.0);
            before = position;
        }
    }

    /// A torus whose every other ring is shrunk to nothing, slivers and triangles without area, far
    /// from the origin: it is what it is, and versions of it are versions.
    #[test]
    fn a_mesh_that_hardly_has_an_area_has_versions_or_none() {
        for (squeeze, at) in [
            (0.0, 0.0),
            (1e-30, 0.0),
            (1e-6, 0.0),
            (1e-3, 1e5),
            (1.0, 9e5),
        ] {
            let mut mesh = torus(512, 128);
            for (i, p) in mesh.positions.iter_mut().enumerate() {
                p.y *= if i / 128 % 2 == 0 { squeeze } else { 1.0 };
                *p = *p * squeeze.max(1e-12) + Vec3::splat(at);
            }
            let shape = shape(&Arc::new(mesh)).unwrap();
            for Version { deviation, .. } in &shape.versions {
                assert!(deviation.position.is_finite() && deviation.normal.is_finite());
            }
        }
    }

    #[test]
    fn colours_that_differ_are_smeared_as_far_as_a_triangle_is_large() {
        let (mut mesh, mut coarse) = (torus(64, 32), torus(32, 16));
        let blas = Arc::new(Blas::build(&coarse, BuildLimits::default()).unwrap());
        let size = (0..coarse.triangles.len()).map(|i| longest_side(&coarse, i));
        let (least, most) = (
            size.clone().fold(f32::MAX, f32::min),
            size.fold(0.0, f32::max),
        );
        let mut measured = |fine: Vec4, rough: Vec4| {
            mesh.colors = vec![fine; mesh.positions.len()];
            coarse.colors = vec![rough; coarse.positions.len()];
            Deviation::measured(&mesh, &coarse, &blas, 0.1)
                .unwrap()
                .color
        };
        let (red, reddish) = (Vec4::X, Vec4::new(0.99, 0.0, 0.0, 0.0));
        assert_eq!(measured(red, red), 0.0);
        assert_eq!(measured(red, reddish), 0.0);
        assert!((least..=most).contains(&measured(red, Vec4::Y)));
    }

    #[test]
    fn the_nearer_and_the_stricter_the_finer() {
        let shape = shape(&Arc::new(torus(512, 256))).unwrap();
        let at = |z: f32, scale: f32| {
            Placed::new(Affine3A::from_mat3_translation(
                (Mat3A::from_diagonal(Vec3::splat(scale))).into(),
                Vec3::new(0.0, 0.0, z),
            ))
        };
        let version =
            |wanted, placed: &Placed, limit| shape.version_for(wanted, placed, 525.0, limit);
        for wanted in [Use::Specular, Use::Matte, Use::Shadow] {
            assert_eq!(version(wanted, &at(1e4, 1.0), 0.5), 2);
            // Within the ball, and behind the camera but within reach of it.
            assert_eq!(version(wanted, &at(0.5, 1.0), 16.0), 0);
            assert_eq!(version(wanted, &at(-1.3, 1.0), 16.0), 0);
            assert_eq!(version(wanted, &at(3.0, 1.0), 0.0), 0);
            let mut last = 0;
            for step in 0..40 {
                let now = version(wanted, &at(1.5 * 1.3f32.powi(step), 1.0), 0.5);
                assert!(now >= last, "{wanted:?} at step {step}");
                last = now;
            }
            // Half as large and half as far is the same picture.
            for z in [3.0, 10.0, 30.0, 100.0] {
                let (whole, half) = (at(z, 1.0), at(0.5 * z, 0.5));
                assert_eq!(version(wanted, &whole, 0.5), version(wanted, &half, 0.5));
            }
        }
        let placed = at(6.0, 1.0);
        let [specular, matte, shadow] =
            [Use::Specular, Use::Matte, Use::Shadow].map(|wanted| version(wanted, &placed, 0.5));
        assert!(specular <= matte && matte <= shadow);
    }
}

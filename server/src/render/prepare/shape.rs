//! A mesh in several versions, and which of them a frame shows.
//!
//! How far a version is off is measured, not taken on trust: rays from all over the mesh along its
//! normals find how far away the version lies, and how its normals are turned there.

use std::sync::Arc;

use glam::{Affine3A, Vec3A, Vec4};
use rayon::prelude::*;

use crate::accel::{Blas, BuildLimits, Hit, MASK_VIRTUAL, Ray, Tlas, TlasInstance};
use crate::render::checkpoint::Checkpoint;
use crate::scene::{Mesh, coarser, takes_forever};

use super::placed::Placed;

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
pub(crate) struct Version {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) blas: Arc<Blas>,
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
pub(crate) enum Use {
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
pub(crate) struct Shape {
    /// Finest first; the first is the mesh itself.
    pub(crate) versions: Vec<Version>,
    /// The mesh would have coarser versions, but they take too long to make.
    pub(crate) without_versions: bool,
    /// Centre and radius of a ball around the mesh, object space.
    pub(crate) ball: Option<(Vec3A, f32)>,
}

impl Shape {
    /// Simplifies a mesh if it is large, and builds its trees; what is wrong with it if that fails.
    /// It has fewer versions, or none, when `checkpoint` gives up.
    pub(crate) fn new(mesh: &Arc<Mesh>, checkpoint: &dyn Checkpoint) -> Result<Self, String> {
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

    /// The mesh itself.
    pub(crate) fn mesh(&self) -> &Arc<Mesh> {
        &self.versions[0].mesh
    }

    /// Memory held, bytes, beside the mesh itself.
    pub(crate) fn memory(&self) -> u64 {
        let trees = self.versions.iter().map(|v| v.blas.memory() as u64);
        let coarser = self.versions[1..].iter().map(|v| v.mesh.bytes());
        trees.chain(coarser).sum()
    }

    /// The coarsest version that is off by no more than `limit_px` pixels where it is nearest to a
    /// camera of focal length `focal_px`.
    pub(crate) fn version_for(
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
mod tests;

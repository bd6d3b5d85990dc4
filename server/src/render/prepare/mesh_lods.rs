//! Levels of detail of a mesh, and their selection for a frame.
//!
//! The error of a level is measured, not taken from the simplifier: rays from points all over the mesh along its
//! normals give the distance to the level's surface, and the angle between their normals there.

use std::sync::Arc;

use glam::{Affine3A, Vec3A, Vec4};
use rayon::prelude::*;

use crate::accel::{Blas, BuildLimits, Hit, MASK_VIRTUAL, Ray, Tlas, TlasInstance};
use crate::render::checkpoint::Checkpoint;
use crate::scene::{Mesh, coarser, takes_forever};

use super::placed::Placed;

/// Number of probes, the points on a mesh at which the error of a level is measured.
const PROBES: usize = 1 << 15;

/// The error is this quantile of the distances at the probes.
const SHARE: f32 = 0.999;

/// Heuristic: for surfaces without specular reflections, how far shading moves if normals differ, as a share of
/// how far reflections do.
const MATTE: f32 = 0.25;

/// Heuristic: least difference of a vertex colour (linear, 0..=1) that counts as an error, about five 8-bit codes
/// of a bright colour.
const COLOR_STEP: f32 = 0.04;

/// Length of a probe's rays, as a share of the mesh's radius.
const FARTHEST: f32 = 0.05;

/// One level of detail: a mesh and its BVH.
pub(crate) struct Lod {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) blas: Arc<Blas>,
    error: LodError,
}

/// Error of a level of detail relative to the original mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct LodError {
    /// Distance along the normal, object units; the quantile [`SHARE`].
    position: f32,
    /// Angle between normals, radians; RMS.
    normal: f32,
    /// How far vertex colours are displaced, object units; the quantile [`SHARE`]. If a colour differs by more
    /// than [`COLOR_STEP`], this is the size of the level's triangle, otherwise 0.
    color: f32,
}

/// The use for which a level of detail is selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Use {
    /// Visible, with specular reflections or refractions.
    Specular,
    /// Visible, without them.
    Matte,
    /// Casts shadows on other surfaces.
    Shadow,
}

/// Most nodes and leaves that all probes of a level may visit; most meshes need a tenth of it. If thousands of
/// triangles overlap, fewer probes are used.
const MOST_VISITS: usize = 1 << 24;

/// Fewest probes for a measurement of the error.
const LEAST_PROBES: usize = 1 << 10;

/// Number of rays from which the number of visits is estimated.
const SCOUTS: usize = 256;

/// A mesh and its coarser levels of detail.
pub(crate) struct MeshLods {
    /// Finest first; the first is the original mesh.
    pub(crate) levels: Vec<Lod>,
    /// The mesh is large enough for coarser levels, but simplifying it would take too long.
    pub(crate) without_lods: bool,
    /// Bounding sphere of the mesh: centre and radius, object space.
    pub(crate) ball: Option<(Vec3A, f32)>,
}

impl MeshLods {
    /// Simplifies a mesh if it is large, and builds a BVH for every level; the error says what is wrong with the
    /// mesh. Coarser levels are left out if `checkpoint` cancels.
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
                let lod = |coarse: Mesh| {
                    if !go_on() {
                        return Ok(None);
                    }
                    let blas = build(&coarse)?;
                    let error = LodError::measured(mesh, &coarse, &blas, reach);
                    Ok(error.map(|error| Lod {
                        mesh: Arc::new(coarse),
                        blas,
                        error,
                    }))
                };
                let coarser = coarser(mesh, &go_on).into_par_iter();
                coarser.map(lod).collect::<Result<Vec<_>, String>>()
            },
        );
        let mut levels = vec![Lod {
            mesh: mesh.clone(),
            blas: finest?,
            error: LodError::default(),
        }];
        let coarser = coarser?;
        let unmeasured = coarser.iter().any(Option::is_none);
        levels.extend(coarser.into_iter().flatten());
        Ok(Self {
            without_lods: levels.len() == 1 && (unmeasured || takes_forever(mesh)),
            levels,
            ball,
        })
    }

    /// The original mesh.
    pub(crate) fn mesh(&self) -> &Arc<Mesh> {
        &self.levels[0].mesh
    }

    /// Memory held in addition to the original mesh, bytes.
    pub(crate) fn memory(&self) -> u64 {
        let trees = self.levels.iter().map(|v| v.blas.memory() as u64);
        let coarser = self.levels[1..].iter().map(|v| v.mesh.bytes());
        trees.chain(coarser).sum()
    }

    /// The coarsest level whose error is at most `limit_px` pixels at the point of the object that is nearest to
    /// a camera of focal length `focal_px`.
    pub(crate) fn lod_for(
        &self,
        wanted: Use,
        placed: &Placed,
        focal_px: f32,
        limit_px: f32,
    ) -> usize {
        let Some(ball) = self.ball.filter(|_| self.levels.len() > 1) else {
            return 0;
        };
        let (center, radius) = placed.ball(ball);
        let nearest = center.length() - radius;
        if nearest <= 0.0 {
            return 0;
        }
        let px_per_unit = focal_px * radius / (ball.1 * nearest);
        // If a normal differs by an angle, a reflection moves over the surface by that angle times the radius of
        // curvature, for which the mesh's own radius is used. Diffuse shading moves less.
        let px_per_radian = match wanted {
            Use::Specular => px_per_unit * ball.1,
            Use::Matte => px_per_unit * ball.1 * MATTE,
            Use::Shadow => 0.0,
        };
        let good = |Lod { error, .. }: &Lod| {
            let normal = error.normal * px_per_radian;
            let color = match wanted {
                Use::Specular | Use::Matte => error.color * px_per_unit,
                Use::Shadow => 0.0,
            };
            (error.position * px_per_unit).max(normal).max(color) <= limit_px
        };
        self.levels.iter().rposition(good).unwrap_or(0)
    }
}

impl LodError {
    /// Error of `coarse` relative to `mesh`, measured with rays of length `reach` (object units); `None` for a
    /// mesh without area, or if it would take too long.
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

/// Step between probed triangles, so that the rays visit at most [`MOST_VISITS`] nodes; `None` if that leaves too
/// few probes. Based on counts and not on time, so that the same mesh always gets the same levels.
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

/// A triangle's geometric unit normal; `None` if it has no area.
fn flat_normal(mesh: &Mesh, triangle: usize) -> Option<Vec3A> {
    let at = |i: u32| Vec3A::from(mesh.positions[i as usize]);
    let [a, b, c] = mesh.triangles[triangle].map(at);
    (b - a).cross(c - a).try_normalize()
}

/// The shading normal at a point on a triangle.
fn normal_at(mesh: &Mesh, triangle: usize, u: f32, v: f32) -> Option<Vec3A> {
    if mesh.normals.is_empty() {
        return flat_normal(mesh, triangle);
    }
    let at = |i: u32| Vec3A::from(mesh.normals[i as usize]);
    let [a, b, c] = mesh.triangles[triangle].map(at);
    (a * (1.0 - u - v) + b * u + c * v).try_normalize()
}

/// The vertex colour at a point on a triangle.
fn color_at(mesh: &Mesh, triangle: usize, u: f32, v: f32) -> Vec4 {
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.colors[i as usize]);
    a * (1.0 - u - v) + b * u + c * v
}

/// The longest side of a triangle, object units.
fn longest_side(mesh: &Mesh, triangle: usize) -> f32 {
    let [a, b, c] = mesh.triangles[triangle].map(|i| mesh.positions[i as usize]);
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// Bounding sphere of a mesh, object space: around the centre of its AABB.
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

//! The ghost surface by brute force in double precision: every triangle that can be hit, in camera space, by signed
//! volumes. Shares nothing with the fast traversals except the definition of the surface: no projection of rays, no
//! (u, v, w), no pyramid.
//!
//! Each result says whether rounding could have changed it. A hit is *sure* if the ray passes through the inside of
//! the surface: away from the triangle's border, or at a border behind which the surface continues and is crossed in
//! the same sense. It is *possible* if a slightly larger triangle would be hit. A result is ambiguous if the two
//! differ.

use glam::DVec3;

use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::{DepthImage, depth_sigma_m};
use ghostlight::ghost::GhostSettings;

/// The true result, as far as it can be determined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// Nearest hit: the ray's parameter, and whether it came from the camera's side.
    Hit {
        /// Parameter of the ray.
        t: f64,
        /// Whether the ray came from the side that faces the camera.
        from_front: bool,
        /// Sine of the angle between ray and surface.
        grazing: f64,
    },
    /// No hit; the ray is always on the camera's side of the surface, and leaves the image or ends in front of the
    /// surface.
    Environment,
    /// No hit; the ray is behind the surface somewhere, or ends in front of a hole.
    Unknown,
    /// Rounding decides whether there is a hit, or which one is the nearest.
    AmbiguousHit,
    /// Surely no hit, but rounding decides between environment and unknown.
    AmbiguousMiss,
}

/// Relative rounding error that the derivations of the fast traversals allow (a contact tolerance of 16 * 640 * 2^-53
/// of w, for a focal length of up to 2000 pixels), as a displacement in triangle sides. Results within it, before
/// division by the sine of the grazing angle, are ambiguous.
const MARGIN: f64 = 4e-9;

/// Below this sine of the angle between ray and triangle the position of a hit is meaningless.
const COPLANAR: f64 = 1e-12;

/// The triangles of a depth map in camera space.
#[derive(Debug)]
pub struct GhostOracle {
    intrinsics: Intrinsics,
    /// Number of cells per row and column.
    cells: (usize, usize),
    /// Unprojected vertices, metres.
    vertices: Vec<DVec3>,
    /// Whether the upper right and the lower left triangle of each cell exist.
    exists: Vec<[bool; 2]>,
}

/// Intersection of a ray with one triangle.
#[derive(Debug, Clone, Copy)]
struct Contact {
    t: f64,
    from_front: bool,
    grazing: f64,
    /// The magnitude that the parameter's rounding error is relative to.
    reach: f64,
    sure: bool,
}

/// Intersection of a line with a triangle: barycentric coordinates and sense of the crossing.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    barycentric: [f64; 3],
    t: f64,
    /// Sine of the angle to the triangle's plane, positive from the camera's side.
    sine: f64,
    /// Smallest barycentric coordinate of a sure hit, scaled by grazing.
    margin: f64,
    /// The larger of t and the distance from the camera in units of t: the magnitude that the rounding error of t is
    /// relative to.
    reach: f64,
}

impl GhostOracle {
    /// The surface as [`ghostlight::ghost`] defines it.
    pub fn new(depth: &DepthImage, intrinsics: &Intrinsics, settings: &GhostSettings) -> Self {
        let (width, height) = (depth.width as usize, depth.height as usize);
        let vertices = (0..width * height)
            .map(|k| {
                let (x, y) = ((k % width) as f64, (k / width) as f64);
                intrinsics.unproject(x, y, f64::from(depth.z_m[k]))
            })
            .collect();
        let cells = (width.saturating_sub(1), height.saturating_sub(1));
        let joined = |p: usize, q: usize| {
            let (a, b) = (depth.z_m[p], depth.z_m[q]);
            let nearer = a.min(b);
            (a - b).abs()
                < settings.edge_relative * nearer + settings.edge_sigmas * depth_sigma_m(nearer)
        };
        let exists = (0..cells.0 * cells.1)
            .map(|k| {
                let a = k / cells.0 * width + k % cells.0;
                let (b, c, d) = (a + 1, a + width, a + width + 1);
                let diagonal = joined(a, d);
                [
                    diagonal && joined(a, b) && joined(b, d),
                    diagonal && joined(a, c) && joined(c, d),
                ]
            })
            .collect();
        Self {
            intrinsics: *intrinsics,
            cells,
            vertices,
            exists,
        }
    }

    /// Number of triangles.
    pub fn n_triangles(&self) -> usize {
        self.exists.iter().flatten().filter(|e| **e).count()
    }

    /// The result for a ray.
    pub fn verdict(&self, ray: &Ray) -> Verdict {
        let origin = ray.origin.as_dvec3();
        let direction = ray.direction.as_dvec3();
        let (t_min, t_max) = (f64::from(ray.t_min), f64::from(ray.t_max));
        let valid = origin.is_finite()
            && direction.is_finite()
            && direction != DVec3::ZERO
            && t_min.is_finite()
            && t_min <= t_max;
        if !valid {
            return Verdict::Unknown;
        }
        let end = self.end(origin, direction, t_max);
        let (mut first_sure, mut first_possible): (Option<Contact>, Option<Contact>) = (None, None);
        let (mut behind_sure, mut behind_possible) = (false, false);
        let (mut covered_sure, mut covered_possible) = (false, false);
        self.for_cells_near(origin, direction, |cell| {
            for half in 0..2 {
                if !self.exists[cell][half] {
                    continue;
                }
                if let Some(contact) = self.contact(cell, half, origin, direction, t_min, t_max) {
                    let earlier =
                        |first: &Option<Contact>| first.is_none_or(|first| contact.t < first.t);
                    if contact.sure && earlier(&first_sure) {
                        first_sure = Some(contact);
                    }
                    if earlier(&first_possible) {
                        first_possible = Some(contact);
                    }
                }
                let corners = self.corners(cell, half);
                let behind = behind(&corners, origin, direction, t_min, t_max);
                behind_sure |= behind == Some(true);
                behind_possible |= behind != Some(false);
                if let End::Inside(towards) = end {
                    let depth = cone_depth(&corners, towards);
                    covered_sure |= depth > MARGIN;
                    covered_possible |= depth > -MARGIN;
                }
            }
        });
        match (first_sure, first_possible) {
            (None, None) => {}
            (Some(sure), Some(possible))
                if (sure.t - possible.t).abs()
                    <= MARGIN / sure.grazing.min(possible.grazing)
                        * sure.reach.max(possible.reach) =>
            {
                return Verdict::Hit {
                    t: sure.t,
                    from_front: sure.from_front,
                    grazing: sure.grazing,
                };
            }
            _ => return Verdict::AmbiguousHit,
        }
        if behind_sure {
            return Verdict::Unknown;
        }
        if behind_possible {
            return Verdict::AmbiguousMiss;
        }
        match end {
            End::Outside => Verdict::Environment,
            End::Inside(_) if covered_sure => Verdict::Environment,
            End::Inside(_) if !covered_possible => Verdict::Unknown,
            _ => Verdict::AmbiguousMiss,
        }
    }

    /// The end of the ray, seen from the camera.
    fn end(&self, origin: DVec3, direction: DVec3, t_max: f64) -> End {
        let towards = if t_max.is_finite() {
            origin + direction * t_max
        } else {
            direction
        };
        // A ray to infinity may always stay beside the camera's plane.
        let near = if t_max.is_finite() {
            f64::from(DepthImage::MIN_M)
        } else {
            0.0
        };
        let (u, v) = self.intrinsics.project(towards);
        let depth = (towards.z - near)
            .min(u.min(v))
            .min((self.cells.0 as f64 - u).min(self.cells.1 as f64 - v));
        if towards.z <= 0.0 || depth < -MARGIN {
            End::Outside
        } else if depth < MARGIN {
            End::Ambiguous
        } else {
            End::Inside(towards)
        }
    }

    /// Visits every cell that the image of the whole line can touch. The line and the camera's centre span a plane,
    /// which intersects the image in a straight line. Rows of cells are intersected with this line, widened by half a
    /// pixel.
    fn for_cells_near(&self, origin: DVec3, direction: DVec3, mut visit: impl FnMut(usize)) {
        let k = &self.intrinsics;
        let normal = origin.cross(direction);
        let degenerate = normal.length() <= 1e-7 * origin.length() * direction.length();
        // normal . ((u - cx)/fx, (v - cy)/fy, 1) = 0 as per_u u + per_v v + constant = 0.
        let per_u = normal.x / k.fx;
        let per_v = normal.y / k.fy;
        let constant = normal.z - per_u * k.cx - per_v * k.cy;
        if degenerate {
            // The image is the pixel of the direction; at z = MIN_M the line is at most this far from the ray through
            // the camera's centre.
            let strayed_px = k.fx.max(k.fy) * 1e-7 * origin.length() / f64::from(DepthImage::MIN_M);
            let (u, v) = k.project(direction);
            let span = |x: f64, n: usize| {
                let low = (x - 3.0 - strayed_px).clamp(0.0, n as f64);
                let high = (x + 3.0 + strayed_px).clamp(0.0, n as f64);
                if low.is_finite() && high.is_finite() {
                    low as usize..high.ceil() as usize
                } else {
                    0..n
                }
            };
            for j in span(v, self.cells.1) {
                for i in span(u, self.cells.0) {
                    visit(j * self.cells.0 + i);
                }
            }
            return;
        }
        for j in 0..self.cells.1 {
            let (mut first, mut last) = (0, self.cells.0);
            if per_u != 0.0 {
                let at = |v: f64| -(per_v * v + constant) / per_u;
                let (a, b) = (at(j as f64 - 0.5), at(j as f64 + 1.5));
                let low = (a.min(b) - 1.5).clamp(0.0, self.cells.0 as f64);
                let high = (a.max(b) + 1.5).clamp(0.0, self.cells.0 as f64);
                // A NaN would be cast to 0 below, so the full row is kept.
                if low.is_finite() && high.is_finite() {
                    (first, last) = (low as usize, high.ceil() as usize);
                }
            } else if per_v != 0.0 {
                let v = -constant / per_v;
                if v < j as f64 - 0.5 || v > j as f64 + 1.5 {
                    continue;
                }
            }
            for i in first..last {
                visit(j * self.cells.0 + i);
            }
        }
    }

    /// The corners of a triangle.
    fn corners(&self, cell: usize, half: usize) -> [DVec3; 3] {
        let width = self.cells.0 + 1;
        let a = cell / self.cells.0 * width + cell % self.cells.0;
        let (b, c, d) = (a + 1, a + width, a + width + 1);
        let corners = if half == 0 { [a, b, d] } else { [a, d, c] };
        corners.map(|k| self.vertices[k])
    }

    /// The hit of the ray on the triangle, if there can be one.
    fn contact(
        &self,
        cell: usize,
        half: usize,
        origin: DVec3,
        direction: DVec3,
        t_min: f64,
        t_max: f64,
    ) -> Option<Contact> {
        let crossing = crossing(&self.corners(cell, half), origin, direction)?;
        let least = crossing.barycentric.into_iter().fold(f64::MAX, f64::min);
        let t_margin = crossing.margin * crossing.reach;
        let possible = least >= -crossing.margin
            && crossing.t >= t_min - t_margin
            && crossing.t <= t_max + t_margin;
        if !possible {
            return None;
        }
        let in_time = crossing.t >= t_min + t_margin && crossing.t <= t_max - t_margin;
        let sure = in_time
            && crossing.sine.abs() > COPLANAR
            && self.goes_on(cell, half, &crossing, direction);
        Some(Contact {
            t: crossing.t,
            from_front: crossing.sine > 0.0,
            grazing: crossing.sine.abs().max(COPLANAR),
            reach: crossing.reach,
            sure,
        })
    }

    /// Whether the surface continues, and is crossed in the same sense, behind every border of the triangle that is
    /// too close to the intersection.
    fn goes_on(&self, cell: usize, half: usize, crossing: &Crossing, direction: DVec3) -> bool {
        let near: Vec<usize> = (0..3)
            .filter(|&k| crossing.barycentric[k] < crossing.margin)
            .collect();
        if near.is_empty() {
            return true;
        }
        let (i, j) = (
            (cell % self.cells.0) as isize,
            (cell / self.cells.0) as isize,
        );
        // Corner k is opposite to the border where its coordinate is zero. There is one triangle behind a border, and
        // there are six around a corner.
        let around = match (half, near.as_slice()) {
            (0, [0]) => vec![(i + 1, j, 1)],
            (0, [1]) => vec![(i, j, 1)],
            (0, [2]) => vec![(i, j - 1, 1)],
            (1, [0]) => vec![(i, j + 1, 0)],
            (1, [1]) => vec![(i - 1, j, 0)],
            (1, [2]) => vec![(i, j, 0)],
            (half, near) => {
                let Some(corner) = (0..3).find(|k| !near.contains(k)) else {
                    return false;
                };
                let (x, y) = match (half, corner) {
                    (_, 0) => (i, j),
                    (0, 1) => (i + 1, j),
                    (0, _) | (1, 1) => (i + 1, j + 1),
                    _ => (i, j + 1),
                };
                vec![
                    (x, y, 0),
                    (x, y, 1),
                    (x - 1, y, 0),
                    (x, y - 1, 1),
                    (x - 1, y - 1, 0),
                    (x - 1, y - 1, 1),
                ]
            }
        };
        around.into_iter().all(|(i, j, half)| {
            let inside =
                i >= 0 && j >= 0 && (i as usize) < self.cells.0 && (j as usize) < self.cells.1;
            if !inside {
                return false;
            }
            let cell = j as usize * self.cells.0 + i as usize;
            let other = normal(&self.corners(cell, half));
            let sine = -other.dot(direction) / (other.length() * direction.length());
            self.exists[cell][half] && sine.abs() > COPLANAR && sine * crossing.sine > 0.0
        })
    }
}

/// The end of a ray, seen from the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    /// Outside the image or in front of the camera's minimum depth.
    Outside,
    /// Inside the image, in this direction.
    Inside(DVec3),
    /// On the border, within rounding.
    Ambiguous,
}

/// Normal of a triangle, of any length, facing the camera.
fn normal(corners: &[DVec3; 3]) -> DVec3 {
    let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if n.dot(corners[0]) > 0.0 { -n } else { n }
}

/// The intersection of the line with a triangle's plane, by signed volumes. `None` if the line is parallel to the
/// plane, so that the position is undefined.
fn crossing(corners: &[DVec3; 3], origin: DVec3, direction: DVec3) -> Option<Crossing> {
    let [a, e1, e2] = [corners[0], corners[1] - corners[0], corners[2] - corners[0]];
    // From the triangle's own edges: differences of distant corners would lose a small triangle seen from far away.
    let from = origin - a;
    let across = direction.cross(e2);
    let volume = e1.dot(across);
    let u = from.dot(across) / volume;
    let v = direction.dot(from.cross(e1)) / volume;
    let n = normal(corners);
    let sine = -n.dot(direction) / (n.length() * direction.length());
    let t = -n.dot(from) / n.dot(direction);
    if !t.is_finite() || volume == 0.0 {
        return None;
    }
    // Rounding error of the distance to the triangle, relative to its height over its longest side.
    let longest = e1.length().max(e2.length()).max((e2 - e1).length());
    let rounding = 16.0 * f64::EPSILON * from.length() * longest / n.length();
    Some(Crossing {
        barycentric: [1.0 - u - v, u, v],
        t,
        sine,
        margin: (MARGIN + rounding) / sine.abs().max(COPLANAR),
        reach: t.abs().max(corners[0].length() / direction.length()),
    })
}

/// How far a direction is inside the cone that a triangle spans at the camera's centre, as its smallest barycentric
/// coordinate; negative outside.
fn cone_depth(corners: &[DVec3; 3], towards: DVec3) -> f64 {
    let [a, b, c] = *corners;
    let volumes = [
        towards.dot(b.cross(c)),
        towards.dot(c.cross(a)),
        towards.dot(a.cross(b)),
    ];
    let sum: f64 = volumes.iter().sum();
    // If sum and solid angle have opposite signs, the direction is in the cone's mirror image behind the camera.
    if sum * a.dot(b.cross(c)) <= 0.0 {
        return f64::NEG_INFINITY;
    }
    volumes
        .into_iter()
        .fold(f64::MAX, |least, volume| least.min(volume / sum))
}

/// Whether the ray is somewhere behind a triangle, seen from the camera: inside its cone and beyond its plane. `None`
/// if rounding decides. Only valid for triangles that the ray does not hit.
fn behind(
    corners: &[DVec3; 3],
    origin: DVec3,
    direction: DVec3,
    t_min: f64,
    t_max: f64,
) -> Option<bool> {
    let [a, b, c] = *corners;
    let orientation = a.dot(b.cross(c)).signum();
    // Inward normals of the cone's sides, and the triangle's plane with its far side as the inside.
    let away = -normal(corners);
    let near = f64::from(DepthImage::MIN_M);
    let spaces = [
        (b.cross(c) * orientation, 0.0),
        (c.cross(a) * orientation, 0.0),
        (a.cross(b) * orientation, 0.0),
        (away, away.dot(a)),
        (DVec3::Z, near),
    ];
    let (mut enter, mut exit) = (t_min, t_max);
    // Depth of the deepest point, for rays parallel to a boundary plane.
    let mut parallel = f64::INFINITY;
    // Largest displacement of either end by rounding: larger for more grazing intersections.
    let mut blur = 0.0f64;
    for (n, offset) in spaces {
        let n_length = n.length();
        let height = (n.dot(origin) - offset) / n_length;
        let slope = n.dot(direction) / n_length;
        if slope.abs() <= COPLANAR * direction.length() {
            parallel = parallel.min(height / a.length());
            continue;
        }
        let t = -height / slope;
        let size = origin.length() + offset.abs() / n_length;
        let moves = 8.0 * f64::EPSILON * size / slope.abs();
        let binds = if slope > 0.0 {
            t + moves > enter
        } else {
            t - moves < exit
        };
        if binds {
            blur = blur.max(moves);
        }
        if slope > 0.0 {
            enter = enter.max(t);
        } else {
            exit = exit.min(t);
        }
    }
    // Length of the ray inside, relative to the distance of the triangle.
    let scale = direction.length() / a.length().max(enter.abs().min(1e12));
    let depth = ((exit - enter) * scale).min(parallel);
    let margin = MARGIN + blur * scale;
    if depth > margin {
        Some(true)
    } else if depth < -margin {
        Some(false)
    } else {
        None
    }
}

//! Rays against every triangle of every instance, in double precision, without a BVH.
//!
//! Each triangle is transformed to camera space and projected along the ray onto a perpendicular plane, where the ray
//! is the origin. The ray hits the triangle if the origin is inside the projection. The distance of the origin from
//! the projection's outline measures the certainty of the result, even for triangles seen edge-on, where the
//! intersection point itself is ill-defined.

use glam::{Affine3A, DMat3, DVec2, DVec3};

use ghostlight::accel::Ray;
use ghostlight::scene::Mesh;

/// A mesh placed in camera space.
#[derive(Debug, Clone, Copy)]
pub struct OracleInstance<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Camera from object space.
    pub camera_from_object: Affine3A,
    /// A ray can hit the instance if the ray's mask shares a bit with this one.
    pub mask: u8,
    /// Largest displacement of its triangles by the arithmetic under test, metres in camera space.
    pub uncertainty: f64,
}

/// Intersection of a ray with a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OracleHit {
    /// Position along the ray, in units of its direction.
    pub t: f64,
    /// Index of the instance.
    pub instance: usize,
    /// Index of the triangle in the mesh.
    pub triangle: usize,
    /// Barycentric weight of vertex 1.
    pub u: f64,
    /// Barycentric weight of vertex 2.
    pub v: f64,
    /// Absolute cosine between ray and normal: the error of `t` is proportional to its reciprocal.
    pub cosine: f64,
}

/// A result and its certainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// Closest-hit: the nearest hit. Any-hit: some hit.
    pub hit: Option<OracleHit>,
    /// Largest displacement of triangles beyond their instance's uncertainty, metres in camera space, that cannot
    /// change the result (closest-hit: the triangle; any-hit: hit or miss). The result is sure if this is positive.
    pub margin: f64,
}

/// A triangle in relation to one ray.
struct Seen {
    hit: OracleHit,
    /// Distance of the ray from the projection's outline, metres; positive inside.
    lateral: f64,
    /// Distance along the ray from `t` to the nearest end of its interval, metres; negative outside.
    along: f64,
    /// Uncertainty of `lateral`, metres.
    blur: f64,
    /// Range of `t` of the hit if the ray is within `blur` of the triangle.
    t_range: (f64, f64),
    /// Whether the ray hits the front face.
    front: bool,
    /// Uncertainty of `along`, metres: the intersection with a plane whose normal has cosine c with the ray moves by
    /// 1/c per displacement.
    blur_along: f64,
}

impl Seen {
    /// Certainty of a hit.
    fn hit_by(&self) -> f64 {
        (self.lateral - self.blur).min(self.along - self.blur_along)
    }

    /// Certainty of a miss.
    fn missed_by(&self) -> f64 {
        (-self.lateral - self.blur).max(-self.along - self.blur_along)
    }

    fn is_hit(&self) -> bool {
        self.lateral >= 0.0 && self.along >= 0.0
    }
}

/// The nearest hit with `t_min <= t <= t_max`.
pub fn closest(instances: &[OracleInstance<'_>], ray: &Ray, mask: u8) -> Verdict {
    let seen = look(instances, ray, mask);
    let winner = seen
        .iter()
        .filter(|s| s.is_hit())
        .min_by(|a, b| a.hit.t.total_cmp(&b.hit.t));
    let speed = ray.direction.as_dvec3().length();
    let margin = seen
        .iter()
        .map(|s| match winner {
            Some(winner) if winner.hit == s.hit => s.hit_by(),
            Some(winner) => {
                let behind = (s.hit.t - winner.hit.t) * speed;
                s.missed_by().max(behind - s.blur_along - winner.blur_along)
            }
            None => s.missed_by(),
        })
        .fold(f64::INFINITY, f64::min);
    Verdict {
        hit: winner.map(|s| s.hit),
        margin,
    }
}

/// Whether there is a hit with `t_min <= t <= t_max`: the one with the highest certainty.
pub fn any(instances: &[OracleInstance<'_>], ray: &Ray, mask: u8) -> Verdict {
    let seen = look(instances, ray, mask);
    let surest = seen
        .iter()
        .filter(|s| s.is_hit())
        .max_by(|a, b| a.hit_by().total_cmp(&b.hit_by()));
    match surest {
        Some(s) => Verdict {
            hit: Some(s.hit),
            margin: s.hit_by(),
        },
        None => Verdict {
            hit: None,
            margin: seen
                .iter()
                .map(Seen::missed_by)
                .fold(f64::INFINITY, f64::min),
        },
    }
}

/// Bounds of the nearest `t >= t_min` at which a ray crosses closed surfaces, even if it passes an edge or a vertex
/// so closely that no triangle is surely hit: triangles within their uncertainty of the ray are grouped by the
/// position of their hits, and a group is a sure crossing if all its triangles have the same facing. (At a silhouette
/// they do not.) The second bound is infinite if no crossing is sure.
pub fn nearest_range(instances: &[OracleInstance<'_>], ray: &Ray, mask: u8) -> (f64, f64) {
    let mut near: Vec<Seen> = look(instances, ray, mask);
    near.retain(|s| s.lateral >= -s.blur && s.t_range.1 >= f64::from(ray.t_min));
    near.sort_by(|a, b| a.t_range.0.total_cmp(&b.t_range.0));
    let Some(first) = near.first().map(|s| s.t_range.0) else {
        return (f64::INFINITY, f64::INFINITY);
    };
    let mut rest = &near[..];
    while let Some(leader) = rest.first() {
        let mut end = leader.t_range.1;
        let mut n = 1;
        while let Some(next) = rest.get(n).filter(|next| next.t_range.0 <= end) {
            end = end.max(next.t_range.1);
            n += 1;
        }
        let starts_after = leader.t_range.0 > f64::from(ray.t_min);
        if starts_after && rest[..n].iter().all(|s| s.front == leader.front) {
            return (first, end);
        }
        rest = &rest[n..];
    }
    (first, f64::INFINITY)
}

fn look(instances: &[OracleInstance<'_>], ray: &Ray, mask: u8) -> Vec<Seen> {
    let origin = ray.origin.as_dvec3();
    let direction = ray.direction.as_dvec3();
    let speed = direction.length();
    let mut seen = Vec::new();
    let Some(forward) = direction.try_normalize() else {
        return seen;
    };
    if !(origin.is_finite() && direction.is_finite() && ray.t_min <= ray.t_max) {
        return seen;
    }
    let (right, down) = forward.any_orthonormal_pair();
    for (instance, source) in instances.iter().enumerate() {
        if source.mask & mask == 0 {
            continue;
        }
        let matrix: DMat3 = source.camera_from_object.matrix3.as_dmat3();
        let shift = source.camera_from_object.translation.as_dvec3() - origin;
        for (triangle, corners) in source.mesh.triangles.iter().enumerate() {
            let corners: [DVec3; 3] =
                corners.map(|i| matrix * source.mesh.positions[i as usize].as_dvec3() + shift);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let Some(normal) = normal.try_normalize() else {
                continue;
            };
            let flat = corners.map(|p| DVec2::new(p.dot(right), p.dot(down)));
            let weights = [
                flat[1].perp_dot(flat[2]),
                flat[2].perp_dot(flat[0]),
                flat[0].perp_dot(flat[1]),
            ];
            let area: f64 = weights.iter().sum();
            let inside = area != 0.0 && weights.iter().all(|w| w * area >= 0.0);
            let outline = distance_to_segment(flat[0], flat[1])
                .min(distance_to_segment(flat[1], flat[2]))
                .min(distance_to_segment(flat[2], flat[0]));
            let z = corners.map(|p| p.dot(forward));
            // Outside the projection, the intersection with the plane may be far away; the triangle itself is no
            // nearer than its nearest corner.
            let t = if inside {
                (weights[0] * z[0] + weights[1] * z[1] + weights[2] * z[2]) / area / speed
            } else {
                z.iter().copied().fold(f64::INFINITY, f64::min) / speed
            };
            let cosine = normal.dot(forward).abs();
            // Intersection with its plane, within the extent of the triangle.
            let plane = corners[0].dot(normal) / normal.dot(forward);
            let slack = source.uncertainty / cosine;
            let nearest = z.iter().copied().fold(f64::INFINITY, f64::min) - source.uncertainty;
            let farthest = z.iter().copied().fold(f64::NEG_INFINITY, f64::max) + source.uncertainty;
            let t_range = (
                (plane - slack).max(nearest).min(farthest) / speed,
                (plane + slack).min(farthest).max(nearest) / speed,
            );
            let (low, high) = (f64::from(ray.t_min), f64::from(ray.t_max));
            seen.push(Seen {
                hit: OracleHit {
                    t,
                    instance,
                    triangle,
                    u: weights[1] / area,
                    v: weights[2] / area,
                    cosine,
                },
                lateral: if inside { outline } else { -outline },
                along: (t - low).min(high - t) * speed,
                blur: source.uncertainty,
                t_range,
                front: normal.dot(forward) < 0.0,
                // Outside the projection, `t` is that of a corner.
                blur_along: if inside && source.uncertainty > 0.0 {
                    source.uncertainty / cosine
                } else {
                    source.uncertainty
                },
            });
        }
    }
    seen
}

/// Distance of the origin from a segment.
fn distance_to_segment(a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let length = along.length_squared();
    let at = if length > 0.0 {
        (-a.dot(along) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (a + along * at).length()
}

#[cfg(test)]
mod tests {
    use glam::{Vec3, Vec3A};

    use super::*;

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        }
    }

    fn down(x: f32, y: f32) -> Ray {
        Ray {
            origin: Vec3A::new(x, y, 2.0),
            direction: Vec3A::new(0.0, 0.0, -4.0),
            t_min: 0.0,
            t_max: 1.0,
        }
    }

    #[test]
    fn a_triangle_is_hit_where_it_is() {
        let mesh = triangle();
        let instances = [OracleInstance {
            mesh: &mesh,
            camera_from_object: Affine3A::IDENTITY,
            mask: 1,
            uncertainty: 0.0,
        }];
        let verdict = closest(&instances, &down(0.25, 0.5), 1);
        let hit = verdict.hit.unwrap();
        assert_eq!((hit.t, hit.u, hit.v, hit.cosine), (0.5, 0.25, 0.5, 1.0));
        // The hypotenuse x + y = 1 is the nearest edge.
        assert!((verdict.margin - 0.25 / 2.0_f64.sqrt()).abs() < 1e-15);
        assert_eq!(any(&instances, &down(0.25, 0.5), 1), verdict);

        let miss = closest(&instances, &down(-0.25, 0.5), 1);
        assert_eq!((miss.hit, miss.margin), (None, 0.25));
        assert_eq!(any(&instances, &down(-0.25, 0.5), 1), miss);
        assert_eq!(closest(&instances, &down(0.25, 0.5), 2).hit, None);
        let short = Ray {
            t_max: 0.25,
            ..down(0.25, 0.5)
        };
        let verdict = closest(&instances, &short, 1);
        assert_eq!((verdict.hit, verdict.margin), (None, 1.0));
    }

    #[test]
    fn uncertainty_eats_the_margin() {
        let mesh = triangle();
        let instances = [OracleInstance {
            mesh: &mesh,
            camera_from_object: Affine3A::IDENTITY,
            mask: 1,
            uncertainty: 0.0625,
        }];
        let verdict = closest(&instances, &down(0.125, 0.25), 1);
        assert_eq!(verdict.margin, 0.0625);
        assert_eq!(any(&instances, &down(0.125, 0.25), 1), verdict);
        // Too near the edge to be sure.
        assert!(closest(&instances, &down(0.03125, 0.25), 1).margin < 0.0);
        assert!(closest(&instances, &down(-0.03125, 0.25), 1).margin < 0.0);
        assert_eq!(closest(&instances, &down(-0.25, 0.25), 1).margin, 0.1875);
    }

    #[test]
    fn the_nearer_of_two_instances_wins() {
        let mesh = triangle();
        let at = |z: f32| OracleInstance {
            mesh: &mesh,
            camera_from_object: Affine3A::from_translation(Vec3::new(0.0, 0.0, z)),
            mask: 1,
            uncertainty: 0.0,
        };
        let instances = [at(-1.0), at(1.0)];
        let hit = closest(&instances, &down(0.25, 0.25), 1).hit.unwrap();
        assert_eq!((hit.instance, hit.t), (1, 0.25));
    }

    #[test]
    fn an_edge_of_a_closed_surface_is_a_sure_crossing_and_a_silhouette_is_not() {
        let cube = crate::hard::shapes::cube(1);
        let at = |origin: Vec3A| Ray {
            origin,
            direction: Vec3A::new(0.0, 0.0, -1.0),
            t_min: 0.0,
            t_max: f32::INFINITY,
        };
        let instances = [OracleInstance {
            mesh: &cube,
            camera_from_object: Affine3A::IDENTITY,
            mask: 1,
            uncertainty: 1e-6,
        }];
        let near = |got: f64, expected: f64| (got - expected).abs() <= 1.001e-6;
        // The diagonal shared by two triangles of a face.
        let (low, high) = nearest_range(&instances, &at(Vec3A::new(0.5, 0.5, 3.0)), 1);
        assert!(near(low, 2.0) && near(high, 2.0), "{low} {high}");
        // Along an edge of the cube: no sure crossing at either end, because side faces and end faces meet there.
        let (low, high) = nearest_range(&instances, &at(Vec3A::new(1.0, 0.5, 3.0)), 1);
        assert!(near(low, 2.0) && high.is_infinite(), "{low} {high}");
        let miss = nearest_range(&instances, &at(Vec3A::new(1.1, 0.0, 3.0)), 1);
        assert_eq!(miss, (f64::INFINITY, f64::INFINITY));
        // From inside: the far face.
        let (low, high) = nearest_range(&instances, &at(Vec3A::ZERO), 1);
        assert!(near(low, 1.0) && near(high, 1.0), "{low} {high}");
    }
}

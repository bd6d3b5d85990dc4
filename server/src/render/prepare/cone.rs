//! Ray cones: the width of a ray, for filtered look-ups in textures, environment maps and the camera's picture
//! (Akenine-Moller et al. 2019, "Texture Level of Detail Strategies for Real-Time Ray Tracing"; for rough
//! reflections Krivanek and Colbert 2008, "Real-time Shading with Filtered Importance Sampling").

use glam::{Vec2, Vec3A};

use crate::scene::Footprint;

/// Heuristic: width of a rough reflection's ray, as a share of the diameter of the directions that it represents;
/// a look-up reaches a texel further to each side. Lower values leave noise, higher ones blur the lobe.
const WIDTH_SHARE: f32 = 0.35;

/// Largest spread, metres of width per metre: a single look-up must not cover half of a hemisphere.
const WIDEST: f32 = 0.7;

/// Least cosine to a surface used for the elongation of the footprint.
const LEAST_COSINE: f32 = 0.05;

/// A ray's width at its start, and its spread.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RayCone {
    /// Width at the start, metres.
    pub(crate) width: f32,
    /// Spread, metres of width per metre of distance.
    pub(crate) spread: f32,
}

impl RayCone {
    /// Width after a distance, metres.
    pub(crate) fn at(self, distance: f32) -> f32 {
        self.width + self.spread * distance
    }

    /// The cone from a distance along the ray on.
    pub(crate) fn after(self, distance: f32) -> Self {
        Self {
            width: self.at(distance),
            ..self
        }
    }

    /// The cone of one of `n` rays that share this one.
    pub(crate) fn share(self, n: u32) -> Self {
        let side = 1.0 / (n.max(1) as f32).sqrt();
        Self {
            width: self.width * side,
            spread: self.spread * side,
        }
    }

    /// The cone of a ray scattered in a direction that represents a solid angle of directions.
    pub(crate) fn scattered(self, solid_angle: f32) -> Self {
        let diameter = 2.0 * (solid_angle * std::f32::consts::FRAC_1_PI).sqrt();
        Self {
            spread: (self.spread + WIDTH_SHARE * diameter).min(WIDEST),
            ..self
        }
    }
}

/// Footprint of a ray of a given width on a triangle, in texture coordinates; `edges` are those of the triangle
/// in camera space, and those in texture coordinates.
pub(crate) fn footprint(
    width: f32,
    incoming: Vec3A,
    normal: Vec3A,
    [e1, e2]: [Vec3A; 2],
    [t1, t2]: [Vec2; 2],
) -> Footprint {
    let cosine = incoming.dot(normal).abs().max(LEAST_COSINE);
    let along = incoming - normal * incoming.dot(normal);
    let (along, aside) = match along.try_normalize() {
        Some(along) => (along, normal.cross(along)),
        None => normal.any_orthonormal_pair(),
    };
    // Expresses a vector in the triangle's plane as a sum of its edges.
    let (g11, g12, g22) = (e1.dot(e1), e1.dot(e2), e2.dot(e2));
    let det = g11 * g22 - g12 * g12;
    let to_texture = |v: Vec3A| {
        let (v1, v2) = (v.dot(e1), v.dot(e2));
        t1 * ((v1 * g22 - v2 * g12) / det) + t2 * ((v2 * g11 - v1 * g12) / det)
    };
    Footprint {
        major: to_texture(along * (width / cosine)),
        minor: to_texture(aside * width),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_footprint_is_drawn_out_where_it_is_seen_at_an_angle() {
        // A triangle of a unit square, seen from straight above and at 60 degrees.
        let edges = [Vec3A::X, Vec3A::Y];
        let texture = [Vec2::X * 2.0, Vec2::Y * 3.0];
        let above = footprint(0.1, -Vec3A::Z, Vec3A::Z, edges, texture);
        let lengths = |f: &Footprint| [f.major.length(), f.minor.length()];
        let mut both = lengths(&above);
        both.sort_by(f32::total_cmp);
        assert!((both[0] - 0.2).abs() < 1e-6 && (both[1] - 0.3).abs() < 1e-6);
        let incoming = Vec3A::new(0.75_f32.sqrt(), 0.0, -0.5);
        let tilted = footprint(0.1, incoming, Vec3A::Z, edges, texture);
        assert!((tilted.major - Vec2::X * 0.4).length() < 1e-6, "{tilted:?}");
        assert!((tilted.minor.length() - 0.3).abs() < 1e-6, "{tilted:?}");
    }

    #[test]
    fn a_cone_grows_and_has_an_end() {
        let pixel = RayCone {
            width: 0.0,
            spread: 0.002,
        };
        assert!((pixel.at(2.0) - 0.004).abs() < 1e-9);
        let rough = RayCone {
            width: pixel.at(2.0),
            ..pixel
        };
        // Three pixels and a share of 0.113 rad.
        assert!(rough.scattered(0.01).spread > pixel.spread + WIDTH_SHARE * 0.11);
        assert_eq!(rough.scattered(f32::INFINITY).spread, WIDEST);
    }
}

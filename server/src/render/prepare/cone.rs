//! How wide a ray has become: what one lookup in a texture, a map or the camera's picture stands for
//! (Akenine-Moller et al. 2019, "Texture Level of Detail Strategies for Real-Time Ray Tracing"; for rough
//! reflections Krivanek and Colbert 2008, "Real-time Shading with Filtered Importance Sampling").

use glam::{Vec2, Vec3A};

use crate::scene::Footprint;

/// Heuristic: a rough reflection's ray is as wide as this share of the diameter of the directions it
/// stands for; a lookup reaches a texel further to each side. Less leaves grain, more blurs the lobe.
const WIDTH_SHARE: f32 = 0.35;

/// Widest spread, metres of width per metre: half of a half sphere is no single lookup's.
const WIDEST: f32 = 0.7;

/// Least cosine to a surface by which its footprint is drawn out.
const LEAST_COSINE: f32 = 0.05;

/// A ray's width where it starts, and how that grows.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RayCone {
    /// Metres.
    pub(crate) width: f32,
    /// Metres per metre.
    pub(crate) spread: f32,
}

impl RayCone {
    /// Width after a distance, metres.
    pub(crate) fn at(self, distance: f32) -> f32 {
        self.width + self.spread * distance
    }

    /// The cone from a distance on.
    pub(crate) fn after(self, distance: f32) -> Self {
        Self {
            width: self.at(distance),
            ..self
        }
    }

    /// That of one of `n` rays which share it.
    pub(crate) fn share(self, n: u32) -> Self {
        let side = 1.0 / (n.max(1) as f32).sqrt();
        Self {
            width: self.width * side,
            spread: self.spread * side,
        }
    }

    /// Sent on in a direction that stands for a solid angle of directions.
    pub(crate) fn scattered(self, solid_angle: f32) -> Self {
        let diameter = 2.0 * (solid_angle * std::f32::consts::FRAC_1_PI).sqrt();
        Self {
            spread: (self.spread + WIDTH_SHARE * diameter).min(WIDEST),
            ..self
        }
    }
}

/// What a ray of a width covers of a triangle, as texture coordinates; `edges` of the triangle, camera
/// space, and of its texture coordinates.
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
    // A vector in the triangle's plane as a sum of its edges.
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
        // A unit square's triangle, seen from straight above and at 60 degrees.
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

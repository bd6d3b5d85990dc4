//! What a surface does with light, as the scene format means its materials (glTF 2.0, appendix
//! B: Lambert under GGX with Schlick's Fresnel; smooth dielectric boundaries by Fresnel's
//! equations), in a form that a path tracer can draw from.
//!
//! One departure: glTF takes from the diffuse part what the *half vector's* Fresnel reflects,
//! which at grazing angles gives back half as much again as arrives. Here it is what the boundary
//! reflects of the view direction, which conserves energy.

use std::f64::consts::{FRAC_1_PI, PI, TAU};

use glam::DVec3;

use super::random::Random;

/// A material at a point.
#[derive(Debug, Clone, Copy)]
pub struct Reflectance {
    /// Diffuse colour of a dielectric.
    pub base: DVec3,
    /// Share of the body that diffuses: 0 for a metal.
    pub diffuse: f64,
    /// Fresnel reflectance head on.
    pub f0: DVec3,
    /// At grazing incidence.
    pub f90: f64,
    /// GGX alpha; 0 is a perfect mirror.
    pub alpha: f64,
    /// Share of what enters that is let through rather than diffused. Such a boundary is smooth,
    /// whatever `alpha` says.
    pub transmission: f64,
    /// Index of refraction.
    pub ior: f64,
    /// A sheet: what passes goes straight on.
    pub thin: bool,
}

/// A surface as one ray meets it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bsdf {
    at: Reflectance,
    /// Unit, back along the ray.
    view: DVec3,
    /// Of the surface itself, towards the viewer.
    geometric: DVec3,
    /// For shading, towards the viewer.
    normal: DVec3,
    /// Index on the far side over that on the near side.
    eta: f64,
}

/// A direction drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampled {
    pub(super) direction: DVec3,
    /// BSDF times cosine over density.
    pub(super) weight: DVec3,
    /// Density per solid angle; `None` for a perfect mirror's or boundary's single direction.
    pub(super) density: Option<f64>,
}

impl Bsdf {
    /// `outward` are the geometric and the shading normal, unit, on the outside.
    pub(super) fn new(at: Reflectance, view: DVec3, outward: [DVec3; 2]) -> Self {
        let side = if outward[0].dot(view) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let geometric = outward[0] * side;
        let normal = outward[1] * side;
        Self {
            at,
            view,
            geometric,
            // A smooth normal that faces away cannot be shaded with.
            normal: if normal.dot(view) > 0.0 {
                normal
            } else {
                geometric
            },
            eta: if side > 0.0 || at.thin {
                at.ior
            } else {
                1.0 / at.ior
            },
        }
    }

    /// Whether no light can be aimed at it.
    pub(super) fn is_singular(&self) -> bool {
        let diffuse = self.at.diffuse * (1.0 - self.at.transmission);
        diffuse == 0.0 && (self.at.transmission > 0.0 || self.at.alpha == 0.0)
    }

    /// Of a direction to the surface's normal.
    pub(super) fn cosine(&self, light: DVec3) -> f64 {
        self.normal.dot(light)
    }

    fn fresnel(&self, cosine: f64) -> DVec3 {
        let rise = (1.0 - cosine).clamp(0.0, 1.0).powi(5);
        self.at.f0 + (DVec3::splat(self.at.f90) - self.at.f0).max(DVec3::ZERO) * rise
    }

    /// Reflectance of a smooth boundary, both faces of a thin one.
    fn boundary(&self) -> f64 {
        let cos_i = self.normal.dot(self.view).min(1.0);
        let sin2_t = (1.0 - cos_i * cos_i) / (self.eta * self.eta);
        if sin2_t >= 1.0 {
            return 1.0;
        }
        let cos_t = (1.0 - sin2_t).sqrt();
        let s = (cos_i - self.eta * cos_t) / (cos_i + self.eta * cos_t);
        let p = (self.eta * cos_i - cos_t) / (self.eta * cos_i + cos_t);
        let r = 0.5 * (s * s + p * p);
        if self.at.thin { 2.0 * r / (1.0 + r) } else { r }
    }

    /// Probabilities of the lobes: mirror direction, boundary crossed, glossy, diffuse.
    fn lobes(&self) -> [f64; 4] {
        if self.at.transmission > 0.0 {
            let r = self.boundary();
            let passes = (1.0 - r) * self.at.transmission;
            return [r, passes, 0.0, 1.0 - r - passes];
        }
        let fresnel = self.fresnel(self.normal.dot(self.view)).max_element();
        let body = self.at.base.max_element() * self.at.diffuse * (1.0 - fresnel);
        // Any split is unbiased; by what is reflected it is quiet. A black body reflects all
        // of its little by gloss.
        let gloss = if body > 0.0 {
            fresnel / (fresnel + body)
        } else {
            1.0
        };
        if self.at.alpha == 0.0 {
            [gloss, 0.0, 0.0, 1.0 - gloss]
        } else {
            [0.0, 0.0, gloss, 1.0 - gloss]
        }
    }

    /// Reflected radiance per irradiance from `light` (unit, away from the surface), without the
    /// single directions of mirrors and boundaries; and the density of drawing it.
    pub(super) fn evaluate(&self, light: DVec3) -> (DVec3, f64) {
        let (nv, nl) = (self.normal.dot(self.view), self.normal.dot(light));
        if nl <= 0.0 || self.geometric.dot(light) <= 0.0 {
            return (DVec3::ZERO, 0.0);
        }
        let [mirror, passes, gloss, diffuse] = self.lobes();
        let body = self.at.base * (self.at.diffuse * FRAC_1_PI);
        let mut density = diffuse * nl * FRAC_1_PI;
        if self.at.transmission > 0.0 {
            return (body * (1.0 - mirror - passes), density);
        }
        let body = body * (DVec3::ONE - self.fresnel(nv));
        if self.at.alpha == 0.0 {
            return (body, density);
        }
        let half = (self.view + light).normalize_or_zero();
        let fresnel = self.fresnel(half.dot(self.view));
        let a2 = self.at.alpha * self.at.alpha;
        let nh = self.normal.dot(half);
        let facets = a2 / (PI * (nh * nh * (a2 - 1.0) + 1.0).powi(2));
        // Smith's masking: G1 of one direction, and of both correlated by height.
        let lambda = |c: f64| 0.5 * ((1.0 + a2 * (1.0 - c * c).max(0.0) / (c * c)).sqrt() - 1.0);
        let (lv, ll) = (lambda(nv), lambda(nl));
        density += gloss * facets / ((1.0 + lv) * 4.0 * nv);
        let shine = fresnel * (facets / ((1.0 + lv + ll) * 4.0 * nv * nl));
        (body + shine, density)
    }

    /// Draws a direction; `None` where the path ends.
    pub(super) fn sample(&self, random: &mut Random) -> Option<Sampled> {
        let [mirror, passes, gloss, _] = self.lobes();
        let (choice, a, b) = (random.unit(), random.unit(), random.unit());
        let single = |direction: DVec3, weight: DVec3| Sampled {
            direction,
            weight,
            density: None,
        };
        if choice < mirror {
            let weight = if self.at.transmission > 0.0 {
                DVec3::ONE
            } else {
                self.fresnel(self.normal.dot(self.view)) / mirror
            };
            return Some(single(self.mirrored(), weight));
        }
        if choice < mirror + passes {
            // Through a smooth boundary radiance is not rescaled by the index: a path that
            // enters also leaves, and the two factors cancel.
            return Some(single(self.refracted(), self.at.base));
        }
        let (x, y) = self.normal.any_orthonormal_pair();
        let (sin, cos) = (TAU * b).sin_cos();
        let direction = if choice < mirror + passes + gloss {
            let half = self.visible_facet([x, y], a, sin, cos);
            half * (2.0 * half.dot(self.view)) - self.view
        } else {
            // Lambert: density cosine / pi.
            let r = a.sqrt();
            x * (r * cos) + y * (r * sin) + self.normal * (1.0 - a).sqrt()
        };
        let (value, density) = self.evaluate(direction);
        (density > 0.0).then(|| Sampled {
            direction,
            weight: value * (self.normal.dot(direction) / density),
            density: Some(density),
        })
    }

    /// About the triangle's own normal where the smooth one would send the ray inside.
    fn mirrored(&self) -> DVec3 {
        let about = |n: DVec3| n * (2.0 * n.dot(self.view)) - self.view;
        let smooth = about(self.normal);
        if smooth.dot(self.geometric) > 0.0 {
            smooth
        } else {
            about(self.geometric)
        }
    }

    /// Snell's law; about the triangle's own normal where the smooth one would keep the ray
    /// outside.
    fn refracted(&self) -> DVec3 {
        if self.at.thin {
            return -self.view;
        }
        let about = |n: DVec3| {
            let cos_i = n.dot(self.view);
            let sin2_t = (1.0 - cos_i * cos_i) / (self.eta * self.eta);
            n * (cos_i / self.eta - (1.0 - sin2_t).max(0.0).sqrt()) - self.view / self.eta
        };
        let smooth = about(self.normal);
        if smooth.dot(self.geometric) < 0.0 {
            smooth
        } else {
            about(self.geometric)
        }
    }

    /// A facet's normal, drawn from those that the viewer sees (Heitz 2018, "Sampling the GGX
    /// Distribution of Visible Normals").
    fn visible_facet(&self, [x, y]: [DVec3; 2], a: f64, sin: f64, cos: f64) -> DVec3 {
        let alpha = self.at.alpha;
        let local = DVec3::new(
            alpha * self.view.dot(x),
            alpha * self.view.dot(y),
            self.view.dot(self.normal),
        )
        .normalize_or_zero();
        let flat = local.x.hypot(local.y);
        let t1 = if flat > 0.0 {
            DVec3::new(-local.y, local.x, 0.0) / flat
        } else {
            DVec3::X
        };
        let t2 = local.cross(t1);
        let (p1, along) = (a.sqrt() * cos, a.sqrt() * sin);
        let s = 0.5 * (1.0 + local.z);
        let p2 = (1.0 - s) * (1.0 - p1 * p1).max(0.0).sqrt() + s * along;
        let m = t1 * p1 + t2 * p2 + local * (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt();
        let m = DVec3::new(alpha * m.x, alpha * m.y, m.z.max(0.0)).normalize_or_zero();
        x * m.x + y * m.y + self.normal * m.z
    }
}

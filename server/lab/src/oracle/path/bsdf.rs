//! The scattering of light by a surface, as the scene format defines its materials (glTF 2.0, appendix B: Lambert
//! under GGX with Schlick's Fresnel; smooth dielectric boundaries by the Fresnel equations), in a form that a path
//! tracer can sample.
//!
//! There is one difference: glTF subtracts the Fresnel reflectance of the *half vector* from the diffuse part, which
//! at grazing angles reflects half as much again as arrives. Here the reflectance of the view direction is
//! subtracted, which conserves energy.

use std::f64::consts::{FRAC_1_PI, PI, TAU};

use glam::DVec3;

use super::random::Random;

/// A material at a point.
#[derive(Debug, Clone, Copy)]
pub struct Reflectance {
    /// Diffuse colour of a dielectric.
    pub base: DVec3,
    /// Diffuse share of the body: 0 for a metal.
    pub diffuse: f64,
    /// Fresnel reflectance at normal incidence.
    pub f0: DVec3,
    /// Fresnel reflectance at grazing incidence.
    pub f90: f64,
    /// GGX alpha; 0 is a perfect mirror.
    pub alpha: f64,
    /// Share of the entering light that is transmitted instead of diffused. A transmissive boundary is smooth,
    /// independent of `alpha`.
    pub transmission: f64,
    /// Index of refraction.
    pub ior: f64,
    /// A thin sheet: transmitted light continues straight on.
    pub thin: bool,
}

/// A surface at the hit of one ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bsdf {
    at: Reflectance,
    /// Unit vector, back along the ray.
    view: DVec3,
    /// Normal of the surface itself, towards the viewer.
    geometric: DVec3,
    /// Shading normal, towards the viewer.
    normal: DVec3,
    /// Index on the far side divided by that on the near side.
    eta: f64,
}

/// A sampled direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampled {
    pub(super) direction: DVec3,
    /// BSDF times cosine, divided by density.
    pub(super) weight: DVec3,
    /// Density per solid angle; `None` for the single direction of a perfect mirror or boundary.
    pub(super) density: Option<f64>,
}

impl Bsdf {
    /// `outward` contains the geometric and the shading normal, unit vectors on the outside.
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
            // A shading normal that faces away cannot be used.
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

    /// Whether the BSDF is singular, so that light sampling is useless.
    pub(super) fn is_singular(&self) -> bool {
        let diffuse = self.at.diffuse * (1.0 - self.at.transmission);
        diffuse == 0.0 && (self.at.transmission > 0.0 || self.at.alpha == 0.0)
    }

    /// Cosine of a direction to the surface's normal.
    pub(super) fn cosine(&self, light: DVec3) -> f64 {
        self.normal.dot(light)
    }

    fn fresnel(&self, cosine: f64) -> DVec3 {
        let rise = (1.0 - cosine).clamp(0.0, 1.0).powi(5);
        self.at.f0 + (DVec3::splat(self.at.f90) - self.at.f0).max(DVec3::ZERO) * rise
    }

    /// Reflectance of a smooth boundary, or of both faces of a thin one.
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

    /// Probabilities of the lobes: mirror direction, transmission, glossy, diffuse.
    fn lobes(&self) -> [f64; 4] {
        if self.at.transmission > 0.0 {
            let r = self.boundary();
            let passes = (1.0 - r) * self.at.transmission;
            return [r, passes, 0.0, 1.0 - r - passes];
        }
        let fresnel = self.fresnel(self.normal.dot(self.view)).max_element();
        let body = self.at.base.max_element() * self.at.diffuse * (1.0 - fresnel);
        // Any probabilities are unbiased; those in proportion to reflectance have low noise. A black body has only
        // its glossy lobe.
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

    /// Reflected radiance per irradiance from `light` (unit vector, away from the surface), without the single
    /// directions of mirrors and boundaries; and the sampling density.
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
        // Smith's masking: G1 of one direction, and the height-correlated G2 of both.
        let lambda = |c: f64| 0.5 * ((1.0 + a2 * (1.0 - c * c).max(0.0) / (c * c)).sqrt() - 1.0);
        let (lv, ll) = (lambda(nv), lambda(nl));
        density += gloss * facets / ((1.0 + lv) * 4.0 * nv);
        let shine = fresnel * (facets / ((1.0 + lv + ll) * 4.0 * nv * nl));
        (body + shine, density)
    }

    /// Samples a direction; `None` if the path ends.
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
            // Radiance is not scaled by the index at a smooth boundary: a path that enters also leaves, and the two
            // factors cancel.
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

    /// The mirror direction; about the geometric normal if the shading normal would send the ray inside.
    fn mirrored(&self) -> DVec3 {
        let about = |n: DVec3| n * (2.0 * n.dot(self.view)) - self.view;
        let smooth = about(self.normal);
        if smooth.dot(self.geometric) > 0.0 {
            smooth
        } else {
            about(self.geometric)
        }
    }

    /// The refracted direction by Snell's law; about the geometric normal if the shading normal would keep the ray
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

    /// Samples a microfacet normal among those visible to the viewer (Heitz 2018, "Sampling the GGX Distribution of
    /// Visible Normals").
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

//! Ray queries of the surface, for one ray or many.

use super::contact::Contact;
use super::segment::{Clipped, End, Segment};
use crate::accel::Ray;
use crate::ghost::outcome::{GhostHit, GhostOutcome};
use crate::ghost::settings::Traversal;
use crate::ghost::surface::GhostSurface;

impl GhostSurface {
    /// The outcome of a ray.
    pub fn trace(&self, traversal: Traversal, ray: &Ray) -> GhostOutcome {
        self.trace_with(ray, |segment| match traversal {
            Traversal::BresenhamNearest => self.first_contact_bresenham(segment, false),
            Traversal::Bresenham => self.first_contact_bresenham(segment, true),
            Traversal::Dda => self.first_contact_dda(segment),
            Traversal::Pyramid => self.first_contact_pyramid_single(self.level, segment, false),
        })
    }

    /// [`Self::trace`] with the pyramid for many rays; the fastest traversal.
    ///
    /// # Panics
    /// If `out` is shorter than `rays`.
    pub fn trace_batch(&self, rays: &[Ray], out: &mut [GhostOutcome]) {
        assert!(out.len() >= rays.len(), "ghost rays: one outcome each");
        if !self.trace_rays(rays, out) {
            for (ray, out) in rays.iter().zip(out) {
                *out = self.trace(Traversal::Pyramid, ray);
            }
        }
    }

    /// Whether the ray hits the surface with `t_min <= t <= t_max`, from either side.
    pub fn occluded(&self, ray: &Ray) -> bool {
        match self.frustum.clip(ray) {
            Clipped::Inside(segment) => self
                .first_contact_pyramid_single(self.level, &segment, true)
                .hit
                .is_some(),
            Clipped::Invalid | Clipped::Outside => false,
        }
    }

    /// [`Self::occluded`] for many rays.
    ///
    /// # Panics
    /// If `out` is shorter than `rays`.
    pub fn occluded_batch(&self, rays: &[Ray], out: &mut [bool]) {
        assert!(out.len() >= rays.len(), "ghost rays: one answer each");
        if !self.occlude_rays(rays, out) {
            for (ray, out) in rays.iter().zip(out) {
                *out = self.occluded(ray);
            }
        }
    }

    /// Clips, traverses, and converts the result to an outcome.
    #[inline(always)]
    fn trace_with(&self, ray: &Ray, traverse: impl FnOnce(&Segment) -> Contact) -> GhostOutcome {
        let segment = match self.frustum.clip(ray) {
            Clipped::Invalid => return GhostOutcome::Unknown,
            Clipped::Outside => return GhostOutcome::Environment,
            Clipped::Inside(segment) => segment,
        };
        self.outcome(&segment, &traverse(&segment))
    }

    /// The outcome that follows from a traversal's result.
    #[inline(always)]
    pub(crate) fn outcome(&self, segment: &Segment, contact: &Contact) -> GhostOutcome {
        if let Some(hit) = contact.hit {
            return GhostOutcome::Hit(GhostHit {
                // Adding 0.0 turns -0.0 into +0.0.
                t: segment.t(hit.s).min(f64::from(f32::MAX)) as f32 + 0.0,
                u: (segment.u + hit.s * segment.du) as f32,
                v: (segment.v + hit.s * segment.dv) as f32,
                from_front: hit.from_front,
            });
        }
        let unknown = contact.behind
            || (segment.end == End::Inside
                && !self.covered(segment.u + segment.du, segment.v + segment.dv));
        if unknown {
            GhostOutcome::Unknown
        } else {
            GhostOutcome::Environment
        }
    }
}

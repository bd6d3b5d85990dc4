//! Many rays at once, by the pyramid.
//!
//! A ray's way down the pyramid is one chain of dependent loads and tests. So a few dozen rays
//! are under way together, each taking one step per round: the processor works on many chains
//! at a time. Rays that need a node and rays that need a cell wait in two lists, which keeps
//! each round's code the same for all rays in it.

use fearless_simd::Simd;

use super::pyramid::{Flight, Next};
use super::segment::{Clipped, Segment};
use super::{Contact, GhostOutcome, GhostSurface};
use crate::accel::Ray;

/// Rays under way together: their state, about 320 bytes each, stays in the first-level cache.
const FLIGHTS: usize = 64;

/// Numbers of flights that wait for the same kind of step.
struct Queue {
    flights: [u8; FLIGHTS],
    n: usize,
}

impl Queue {
    const EMPTY: Self = Self {
        flights: [0; FLIGHTS],
        n: 0,
    };

    /// Adds a flight if `wanted`; written without a branch, since which list a flight goes to
    /// cannot be predicted.
    #[inline(always)]
    fn push_if(&mut self, flight: u8, wanted: bool) {
        // Never full: there are FLIGHTS of them, each in one list.
        self.flights[self.n % FLIGHTS] = flight;
        self.n += usize::from(wanted);
    }
}

impl GhostSurface {
    #[inline(always)]
    pub(super) fn trace_rays<S: Simd>(&self, simd: S, rays: &[Ray], out: &mut [GhostOutcome]) {
        self.in_flight(simd, rays, false, |place, clipped, contact| {
            out[place] = match clipped {
                Clipped::Invalid => GhostOutcome::Unknown,
                Clipped::Outside => GhostOutcome::Environment,
                Clipped::Inside(segment) => self.outcome(segment, contact),
            };
        });
    }

    #[inline(always)]
    pub(super) fn occlude_rays<S: Simd>(&self, simd: S, rays: &[Ray], out: &mut [bool]) {
        self.in_flight(simd, rays, true, |place, _, contact| {
            out[place] = contact.hit.is_some();
        });
    }

    /// Traces rays in groups and reports each once, in any order within its group.
    #[inline(always)]
    fn in_flight<S: Simd>(
        &self,
        simd: S,
        rays: &[Ray],
        any: bool,
        mut report: impl FnMut(usize, Clipped<&Segment>, &Contact),
    ) {
        let mut flights: [Option<Flight>; FLIGHTS] = [None; FLIGHTS];
        for (group, rays) in rays.chunks(FLIGHTS).enumerate() {
            let first = group * FLIGHTS;
            let (mut nodes, mut cells) = (Queue::EMPTY, Queue::EMPTY);
            for (k, ray) in rays.iter().enumerate() {
                match self.frustum.clip(ray) {
                    Clipped::Inside(segment) if !self.levels.is_empty() => {
                        flights[k] = Some(Flight::start(self, &segment, any));
                        nodes.push_if(k as u8, true);
                    }
                    clipped => report(first + k, clipped.as_ref(), &Contact::default()),
                }
            }
            while nodes.n + cells.n > 0 {
                let (mut next_nodes, mut next_cells) = (Queue::EMPTY, Queue::EMPTY);
                for (queue, is_cell) in [(&nodes, false), (&cells, true)] {
                    for &k in &queue.flights[..queue.n] {
                        let Some(flight) = &mut flights[usize::from(k) % FLIGHTS] else {
                            continue;
                        };
                        let next = if is_cell {
                            flight.visit_cell(self)
                        } else {
                            flight.visit_node(simd, self)
                        };
                        flight.prefetch(simd, self, next);
                        next_nodes.push_if(k, next == Next::Node);
                        next_cells.push_if(k, next == Next::Cell);
                    }
                }
                (nodes, cells) = (next_nodes, next_cells);
            }
            for (k, flight) in flights.iter_mut().enumerate() {
                if let Some(flight) = flight.take() {
                    report(first + k, Clipped::Inside(&flight.segment), &flight.contact);
                }
            }
        }
    }
}

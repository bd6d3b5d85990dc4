//! The traversal of the pyramid by a group: sets of lanes take steps in turn, are refilled from the queue, and
//! are interrupted for the exact tests of cells.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

use super::cells::Candidates;
use super::lockstep::{CellResults, Lanes, WalkConstants};
use super::queue::{Contacts, Ids, Walk};
use super::segments::{CELLS, Group, SETS};
use crate::ghost::surface::GhostSurface;

/// Number of lanes that may be idle or wait for a test before the others are interrupted.
const PATIENCE: u32 = 11;

/// Runs the exact tests for which lanes wait.
#[inline(always)]
fn test_cells<S: Simd>(
    constants: &WalkConstants<'_, S>,
    sets: &mut [Lanes<S>; SETS],
    group: &Group,
    contacts: &mut Contacts,
    uncertain: &mut Ids,
) {
    let simd = constants.simd;
    let mut cells = Candidates::NONE;
    for lanes in sets.iter() {
        lanes.candidates(simd, &mut cells);
    }
    let mut results = CellResults {
        goes_on: 0,
        behind: 0,
    };
    for first in (0..cells.n).step_by(CELLS) {
        let hits = constants.surface.cell_contacts(simd, group, &cells, first);
        // If a contact is on the cell's border, a neighbour may have an equal contact.
        let shared = if constants.any {
            0
        } else {
            hits.hit & !hits.interior
        };
        let unsettled = hits.unsettled | shared;
        let settled = hits.hit & !unsettled;
        let filled = (u64::MAX >> (64 - (cells.n - first).min(CELLS))) as u32;
        let ids = u32x8::from_slice(simd, &cells.id[first..first + CELLS]);
        contacts.append(simd, ids, &hits.s, [settled & filled, hits.from_front]);
        let ids = ids.combine(ids);
        uncertain.append(simd, ids, unsettled & filled);
        results.goes_on |= (!(hits.hit | unsettled) & 0xff) << first;
        results.behind |= (hits.behind & !unsettled) << first;
    }
    for lanes in sets {
        results = lanes.resume(simd, results);
    }
}

impl GhostSurface {
    /// Traverses the pyramid with all queued segments of a group.
    #[inline(always)]
    pub(crate) fn walk_group<S: Simd>(&self, simd: S, walk: &mut Walk, group: &Group, any: bool) {
        let constants = WalkConstants::new(simd, self, any);
        let Walk {
            queue,
            uncertain,
            behind,
            contacts,
            ..
        } = walk;
        let mut sets: [_; SETS] = std::array::from_fn(|_| Lanes::new(simd));
        let mut next = 0;
        loop {
            let mut idle = 0;
            let mut stuck = false;
            for lanes in &sets {
                idle += 16 - lanes.active.count_ones();
                stuck |= lanes.active == 0;
            }
            if idle >= PATIENCE || stuck {
                let waits = sets.iter().any(|lanes| lanes.at_cell != 0);
                if waits {
                    test_cells(&constants, &mut sets, group, contacts, uncertain);
                }
                let mut busy = 0;
                for lanes in &mut sets {
                    lanes.retire(&constants, uncertain, behind);
                    if next < queue.n && lanes.active != 0xffff {
                        lanes.refill(&constants, queue, &mut next);
                    }
                    busy |= lanes.active;
                }
                if busy == 0 {
                    break;
                }
            }
            for lanes in &mut sets {
                if lanes.active != 0 {
                    lanes.step(&constants);
                }
            }
        }
    }
}

//! A group's way through the pyramid: sets of lanes take steps in turn, are refilled from the
//! segments that wait, and are interrupted for the exact tests of cells.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

use super::cells::Candidates;
use super::lockstep::{Answers, Lanes, Terrain};
use super::queue::{Contacts, Ids, Walk};
use super::segments::{CELLS, Group, SETS};
use crate::ghost::surface::GhostSurface;

/// Lanes that may idle or wait before the others are interrupted for them.
const PATIENCE: u32 = 11;

/// The exact tests that lanes wait for.
#[inline(always)]
fn test_cells<S: Simd>(
    terrain: &Terrain<'_, S>,
    sets: &mut [Lanes<S>; SETS],
    group: &Group,
    contacts: &mut Contacts,
    uncertain: &mut Ids,
) {
    let simd = terrain.simd;
    let mut cells = Candidates::NONE;
    for lanes in sets.iter() {
        lanes.candidates(simd, &mut cells);
    }
    let mut answers = Answers {
        goes_on: 0,
        behind: 0,
    };
    for first in (0..cells.n).step_by(CELLS) {
        let hits = terrain.surface.cell_contacts(simd, group, &cells, first);
        // Where a contact lies on the cell's border, a neighbour may hold an equal one.
        let shared = if terrain.any {
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
        answers.goes_on |= (!(hits.hit | unsettled) & 0xff) << first;
        answers.behind |= (hits.behind & !unsettled) << first;
    }
    for lanes in sets {
        answers = lanes.resume(simd, answers);
    }
}

impl GhostSurface {
    /// Walks all segments of a group that wait.
    #[inline(always)]
    pub(crate) fn walk_group<S: Simd>(&self, simd: S, walk: &mut Walk, group: &Group, any: bool) {
        let terrain = Terrain::new(simd, self, any);
        let Walk {
            waiting,
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
                    test_cells(&terrain, &mut sets, group, contacts, uncertain);
                }
                let mut busy = 0;
                for lanes in &mut sets {
                    lanes.retire(&terrain, uncertain, behind);
                    if next < waiting.n && lanes.active != 0xffff {
                        lanes.refill(&terrain, waiting, &mut next);
                    }
                    busy |= lanes.active;
                }
                if busy == 0 {
                    break;
                }
            }
            for lanes in &mut sets {
                if lanes.active != 0 {
                    lanes.step(&terrain);
                }
            }
        }
    }
}

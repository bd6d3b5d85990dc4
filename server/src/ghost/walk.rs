//! A group's way through the pyramid: sets of lanes take steps in turn, are refilled from the
//! segments that wait, and are interrupted for the exact tests of cells.

use fearless_simd::Simd;

use super::cell::CellHit;
use super::cells::{CELLS, Candidate};
use super::group::{GROUP, Group, LANES};
use super::lockstep::{Answers, Lanes, SETS, Terrain};
use super::waiting::{Uncertain, Walk};
use super::{Contact, GhostSurface};

/// Lanes that may idle or wait before the others are interrupted for them.
const PATIENCE: u32 = 9;

/// The exact tests that lanes wait for.
#[inline(always)]
fn test_cells<S: Simd>(
    terrain: &Terrain<'_, S>,
    sets: &mut [Lanes<S>; SETS],
    group: &Group,
    contacts: &mut [Contact; GROUP],
    uncertain: &mut Uncertain,
) {
    let surface = terrain.surface;
    let mut list = [Candidate { id: 0, x: 0, y: 0 }; SETS * LANES];
    let mut n = 0;
    for lanes in sets.iter() {
        lanes.candidates(&mut list, &mut n);
    }
    let mut answers = Answers {
        goes_on: 0,
        behind: 0,
    };
    for (chunk, cells) in list[..n].chunks(CELLS).enumerate() {
        let hits = surface.cell_contacts(terrain.simd, group, cells);
        for (k, cell) in cells.iter().enumerate() {
            let bit = |bits: u32| bits >> k & 1 != 0;
            let contact = &mut contacts[cell.id % GROUP];
            let interior = bit(hits.interior);
            if bit(hits.unsettled) || (bit(hits.hit) && !interior && !terrain.any) {
                // Where it lies on the cell's border, a neighbour may hold an equal contact.
                uncertain.push(cell.id as u32);
            } else if bit(hits.hit) {
                let hit = CellHit {
                    s: hits.s[k],
                    from_front: bit(hits.from_front),
                    interior,
                };
                contact.offer(hit, cell.y * surface.cells_x + cell.x);
            } else {
                contact.behind |= bit(hits.behind);
                let place = chunk * CELLS + k;
                answers.goes_on |= 1 << place;
                answers.behind |= u32::from(contact.behind) << place;
            }
        }
    }
    for lanes in sets {
        answers = lanes.resume(terrain.simd, answers);
    }
}

impl GhostSurface {
    /// Walks all segments of a group that wait.
    #[inline(always)]
    pub(super) fn walk_group<S: Simd>(&self, simd: S, walk: &mut Walk, group: &Group, any: bool) {
        let terrain = Terrain::new(simd, self, any);
        let Walk {
            waiting,
            uncertain,
            contacts,
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
                    lanes.step(&terrain, uncertain);
                }
            }
        }
    }
}

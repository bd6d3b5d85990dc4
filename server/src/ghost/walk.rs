//! A group's way through the pyramid: sets of lanes take steps in turn, are refilled from the
//! segments that wait, and are interrupted for the exact tests of cells.

use fearless_simd::Simd;

use super::GhostSurface;
use super::cells::{CELLS, Candidate};
use super::group::{Group, LANES, Ones};
use super::lockstep::{Answers, Lanes, SETS, Terrain};
use super::waiting::{Found, Uncertain, Walk};

/// Lanes that may idle or wait before the others are interrupted for them.
const PATIENCE: u32 = 11;

/// The exact tests that lanes wait for.
#[inline(always)]
fn test_cells<S: Simd>(
    terrain: &Terrain<'_, S>,
    sets: &mut [Lanes<S>; SETS],
    group: &Group,
    found: &mut Found,
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
        // Where a contact lies on the cell's border, a neighbour may hold an equal one.
        let shared = if terrain.any {
            0
        } else {
            hits.hit & !hits.interior
        };
        let unsettled = hits.unsettled | shared;
        let settled = hits.hit & !unsettled;
        for lane in Ones::of(unsettled & ((1 << cells.len()) - 1)) {
            uncertain.push(cells[lane].id as u32);
        }
        for lane in Ones::of(settled) {
            let from_front = hits.from_front >> lane & 1 != 0;
            found.put_hit(cells[lane].id, hits.s[lane], from_front);
        }
        let behind = hits.behind & !unsettled;
        for lane in Ones::of(behind) {
            found.put_behind(cells[lane].id, true);
        }
        answers.goes_on |= (!(hits.hit | unsettled) & 0xff) << (chunk * CELLS);
        answers.behind |= behind << (chunk * CELLS);
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
            found,
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
                    test_cells(&terrain, &mut sets, group, found, uncertain);
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
                    lanes.step(&terrain, found, uncertain);
                }
            }
        }
    }
}

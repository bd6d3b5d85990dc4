//! The stack of a packet traversal: children by parent and slot, nearest on top.

use fearless_simd::{Simd, f32x8, prelude::*};

use crate::accel::build::layout::{self, Cell, STACK};
use crate::accel::traverse::single::{StackEntry, prefetch_child};

/// Pushes the children in `bits` of the node at cell `index`, nearest on top; returns the new stack height.
#[inline(always)]
pub(crate) fn push<S: Simd>(
    simd: S,
    cells: &[Cell],
    index: u32,
    near: f32x8<S>,
    mut bits: u64,
    stack: &mut [StackEntry; STACK],
    mut height: usize,
) -> usize {
    let node = layout::node(cells, index);
    let near = near.to_array();
    let bottom = height;
    let waiting = |slot: usize| StackEntry {
        near: near[slot & 7],
        child: index << 3 | (slot & 7) as u32,
    };
    // Pushes the first two children branch-free, the nearer on top, because the branch would be unpredictable; most
    // nodes have no more. With one child, both are the same; with none, the height does not change.
    let rest = bits & bits.wrapping_sub(1);
    let first = bits.trailing_zeros() as usize & 7;
    let second = (rest | bits << 8).trailing_zeros() as usize & 7;
    prefetch_child(simd, cells, node.children[first]);
    prefetch_child(simd, cells, node.children[second]);
    let swap = usize::from(near[second] < near[first]).wrapping_neg();
    let change = (first ^ second) & swap;
    let two = usize::from(rest != 0);
    stack[height] = waiting(second ^ change);
    stack[height + two] = waiting(first ^ change);
    height += usize::from(bits != 0) + two;
    bits = rest & rest.wrapping_sub(1);
    while bits != 0 {
        let slot = bits.trailing_zeros() as usize & 7;
        bits &= bits - 1;
        let entry = waiting(slot);
        prefetch_child(simd, cells, node.children[slot]);
        // Insertion sort, nearest on top: two or three children are usual.
        let mut at = height;
        while at > bottom && stack[at - 1].near < entry.near {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = entry;
        height += 1;
    }
    height
}

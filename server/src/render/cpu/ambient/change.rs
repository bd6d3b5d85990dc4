//! The change of ambient light at the pixels of real surfaces, and how a tile keeps it.

use glam::Vec3A;

use crate::render::prepare::occluder::LEAST_SHARE;
use crate::render::prepare::tile_plan::TILE;

/// What virtual objects change of the ambient light at a pixel of the ghost surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct AmbientChange {
    /// Irradiance that they add; negative where they take more away.
    pub(crate) delta: Vec3A,
    /// Irradiance with real things only: ambient light and lamps.
    pub(crate) real: Vec3A,
    /// Unit normal of the surface as the estimate took it; zero where there is none.
    pub(crate) normal: Vec3A,
    /// No record served: gathered at this pixel alone, or left to those beside it.
    pub(crate) own: Own,
}

/// The share of light that is left after a change, as a share of it; one where nobody would see it.
pub(crate) fn share_of(change: Vec3A) -> Vec3A {
    if change.abs().max_element() < 0.5 * LEAST_SHARE {
        return Vec3A::ONE;
    }
    (Vec3A::ONE + change).max(Vec3A::ZERO)
}

/// How a pixel that no record serves came by its change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Own {
    /// A record serves.
    #[default]
    No,
    /// By its own rays: grainy until it is filtered.
    Gathered,
    /// Not yet: the filter fills it in from those beside it that were.
    Missing,
}

impl AmbientChange {
    /// Em / Er where lamps are as they were.
    pub(crate) fn share(&self) -> Vec3A {
        if self.delta == Vec3A::ZERO {
            return Vec3A::ONE;
        }
        share_of(self.delta / self.real.max(Vec3A::splat(f32::MIN_POSITIVE)))
    }
}

/// How the changes of a tile are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kept {
    /// There are none; what lies in the buffers is of an earlier frame.
    Nowhere,
    /// At a few nodes, for the tile is a part of one surface.
    AtNodes,
    /// At each pixel.
    AtPixels,
    /// At each pixel, and some gathered for themselves: those are filtered.
    Filtered,
}

/// The changes at the pixels of a tile.
#[derive(Debug, Clone)]
pub(crate) struct AmbientTile {
    pub(crate) kept: Kept,
    pub(crate) nodes: [Node; NODES * NODES],
    /// By pixel; empty until a tile needs that, as most never do.
    pub(crate) raw: Vec<AmbientChange>,
    pub(crate) filtered: Vec<AmbientChange>,
}

impl AmbientTile {
    pub(crate) fn new() -> Self {
        Self {
            kept: Kept::Nowhere,
            nodes: [Node::default(); NODES * NODES],
            raw: Vec::new(),
            filtered: Vec::new(),
        }
    }

    /// Whether there are any changes.
    pub(crate) fn any(&self) -> bool {
        self.kept != Kept::Nowhere
    }

    /// The change at a place of the tile.
    pub(crate) fn at(&self, place: usize) -> AmbientChange {
        match self.kept {
            Kept::Nowhere => AmbientChange::default(),
            Kept::AtNodes => Node::change_at(&self.nodes, place),
            Kept::AtPixels => self.raw[place],
            Kept::Filtered => self.filtered[place],
        }
    }

    /// Em / Er at a place of the tile where lamps are as they were.
    pub(crate) fn share_at(&self, place: usize) -> Vec3A {
        match self.kept {
            Kept::AtNodes => Node::share_at(&self.nodes, place),
            _ => self.at(place).share(),
        }
    }

    /// The change before the filter.
    pub(crate) fn raw_at(&self, place: usize) -> Option<AmbientChange> {
        match self.kept {
            Kept::Nowhere => None,
            Kept::AtNodes => Some(Node::change_at(&self.nodes, place)),
            Kept::AtPixels | Kept::Filtered => Some(self.raw[place]),
        }
    }
}

/// Nodes along a side of a tile that is a part of one surface.
pub(crate) const NODES: usize = 4;

/// Pixels from one node to the next: the last node is the last pixel.
pub(crate) const NODE_STEP: u32 = (TILE - 1) / (NODES as u32 - 1);

/// A change, and the share of light that is left, at a node of a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Node {
    pub(crate) change: AmbientChange,
    /// Share of real light that is added; negative where it is taken.
    pub(crate) share: Vec3A,
}

impl Node {
    pub(crate) fn new(change: AmbientChange) -> Self {
        let real = change.real.max(Vec3A::splat(f32::MIN_POSITIVE));
        Self {
            change,
            share: change.delta / real,
        }
    }

    /// The first of the four nodes around a place, and how far it is from that to the others.
    fn around(place: usize) -> (usize, f32, f32) {
        let (dx, dy) = (place as u32 % TILE, place as u32 / TILE);
        let last = NODES as u32 - 2;
        let (i, j) = ((dx / NODE_STEP).min(last), (dy / NODE_STEP).min(last));
        let part = |d: u32, i: u32| (d - i * NODE_STEP) as f32 / NODE_STEP as f32;
        ((j * NODES as u32 + i) as usize, part(dx, i), part(dy, j))
    }

    /// Em / Er at a place of the tile.
    pub(crate) fn share_at(nodes: &[Self; NODES * NODES], place: usize) -> Vec3A {
        let (i, s, t) = Self::around(place);
        let row = |i: usize| nodes[i].share.lerp(nodes[i + 1].share, s);
        share_of(row(i).lerp(row(i + NODES), t))
    }

    /// The change at a place of the tile.
    pub(crate) fn change_at(nodes: &[Self; NODES * NODES], place: usize) -> AmbientChange {
        let (i, s, t) = Self::around(place);
        let corners = [i, i + 1, i + NODES, i + NODES + 1].map(|i| &nodes[i].change);
        mix(corners, s, t)
    }
}

/// Between four changes.
pub(crate) fn mix([a, b, c, d]: [&AmbientChange; 4], s: f32, t: f32) -> AmbientChange {
    let mix = |of: fn(&AmbientChange) -> Vec3A| of(a).lerp(of(b), s).lerp(of(c).lerp(of(d), s), t);
    AmbientChange {
        delta: mix(|change| change.delta),
        real: mix(|change| change.real),
        normal: mix(|change| change.normal)
            .try_normalize()
            .unwrap_or(a.normal),
        own: Own::No,
    }
}

/// The changes of every active tile, by its place in the list.
#[derive(Clone, Copy)]
pub(crate) struct AmbientChanges<'a>(pub(crate) &'a [AmbientTile]);

impl AmbientChanges<'_> {
    /// Whether ambient light changes anywhere in a tile.
    pub(crate) fn any(&self, slot: usize) -> bool {
        self.0.get(slot).is_some_and(AmbientTile::any)
    }

    /// Em / Er at a place of a tile where lamps are as they were.
    pub(crate) fn share(&self, slot: usize, place: usize) -> Vec3A {
        self.0
            .get(slot)
            .map_or(Vec3A::ONE, |tile| tile.share_at(place))
    }

    /// Change at a place of a tile.
    pub(crate) fn at(&self, slot: usize, place: usize) -> AmbientChange {
        self.0
            .get(slot)
            .map_or_else(AmbientChange::default, |tile| tile.at(place))
    }
}

//! The change of ambient light at the pixels of real surfaces, and its storage in a tile.

use glam::Vec3A;

use crate::render::prepare::occluder::LEAST_SHARE;
use crate::render::prepare::tile_plan::TILE;

/// The change that virtual objects cause in the ambient light at a pixel of the ghost surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct AmbientChange {
    /// Irradiance that they add; negative if they remove more.
    pub(crate) delta: Vec3A,
    /// Irradiance with real objects only: ambient light and lamps.
    pub(crate) real: Vec3A,
    /// Unit normal of the surface that the estimate used; zero if there is none.
    pub(crate) normal: Vec3A,
    /// Whether the change was gathered at this pixel because no record was valid.
    pub(crate) own: Own,
}

/// The remaining share of light after a change (given as a share); exactly one if the change is invisible.
pub(crate) fn share_of(change: Vec3A) -> Vec3A {
    if change.abs().max_element() < 0.5 * LEAST_SHARE {
        return Vec3A::ONE;
    }
    (Vec3A::ONE + change).max(Vec3A::ZERO)
}

/// How the change at a pixel without a valid record is found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Own {
    /// A record is valid there.
    #[default]
    No,
    /// With rays of the pixel's own: noisy until it is filtered.
    Gathered,
    /// Not found yet: the filter fills it in from neighbouring pixels that were gathered.
    Missing,
}

impl AmbientChange {
    /// Em / Er if lamps are unchanged.
    pub(crate) fn share(&self) -> Vec3A {
        if self.delta == Vec3A::ZERO {
            return Vec3A::ONE;
        }
        share_of(self.delta / self.real.max(Vec3A::splat(f32::MIN_POSITIVE)))
    }
}

/// How the changes of a tile are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kept {
    /// There are none; the buffers hold values of an earlier frame.
    Nowhere,
    /// At a few nodes, because the tile is part of one surface.
    AtNodes,
    /// At every pixel.
    AtPixels,
    /// At every pixel, and filtered, because some pixels were gathered individually.
    Filtered,
}

/// The changes at the pixels of a tile.
#[derive(Debug, Clone)]
pub(crate) struct AmbientTile {
    pub(crate) kept: Kept,
    pub(crate) nodes: [Node; NODES * NODES],
    /// By pixel; empty until a tile needs it, which most never do.
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

    /// Whether there are changes in the tile.
    pub(crate) fn any(&self) -> bool {
        self.kept != Kept::Nowhere
    }

    /// The change at a pixel of the tile.
    pub(crate) fn at(&self, place: usize) -> AmbientChange {
        match self.kept {
            Kept::Nowhere => AmbientChange::default(),
            Kept::AtNodes => Node::change_at(&self.nodes, place),
            Kept::AtPixels => self.raw[place],
            Kept::Filtered => self.filtered[place],
        }
    }

    /// Em / Er at a pixel of the tile if lamps are unchanged.
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

/// Nodes along each side of a tile that is part of one surface.
pub(crate) const NODES: usize = 4;

/// Pixels from one node to the next: the last node is the last pixel.
pub(crate) const NODE_STEP: u32 = (TILE - 1) / (NODES as u32 - 1);

/// The change, and the remaining share of light, at a node of a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Node {
    pub(crate) change: AmbientChange,
    /// Change as a share of the real light; negative if light is removed.
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

    /// The first of the four nodes around a pixel, and the fractions towards the others.
    fn around(place: usize) -> (usize, f32, f32) {
        let (dx, dy) = (place as u32 % TILE, place as u32 / TILE);
        let last = NODES as u32 - 2;
        let (i, j) = ((dx / NODE_STEP).min(last), (dy / NODE_STEP).min(last));
        let part = |d: u32, i: u32| (d - i * NODE_STEP) as f32 / NODE_STEP as f32;
        ((j * NODES as u32 + i) as usize, part(dx, i), part(dy, j))
    }

    /// Em / Er at a pixel of the tile.
    pub(crate) fn share_at(nodes: &[Self; NODES * NODES], place: usize) -> Vec3A {
        let (i, s, t) = Self::around(place);
        let row = |i: usize| nodes[i].share.lerp(nodes[i + 1].share, s);
        share_of(row(i).lerp(row(i + NODES), t))
    }

    /// The change at a pixel of the tile.
    pub(crate) fn change_at(nodes: &[Self; NODES * NODES], place: usize) -> AmbientChange {
        let (i, s, t) = Self::around(place);
        let corners = [i, i + 1, i + NODES, i + NODES + 1].map(|i| &nodes[i].change);
        mix(corners, s, t)
    }
}

/// Bilinear interpolation of four changes.
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

/// The changes of every active tile, by its index in the list.
#[derive(Clone, Copy)]
pub(crate) struct AmbientChanges<'a>(pub(crate) &'a [AmbientTile]);

impl AmbientChanges<'_> {
    /// Whether ambient light changes anywhere in a tile.
    pub(crate) fn any(&self, slot: usize) -> bool {
        self.0.get(slot).is_some_and(AmbientTile::any)
    }

    /// Em / Er at a pixel of a tile if lamps are unchanged.
    pub(crate) fn share(&self, slot: usize, place: usize) -> Vec3A {
        self.0
            .get(slot)
            .map_or(Vec3A::ONE, |tile| tile.share_at(place))
    }

    /// The change at a pixel of a tile.
    pub(crate) fn at(&self, slot: usize, place: usize) -> AmbientChange {
        self.0
            .get(slot)
            .map_or_else(AmbientChange::default, |tile| tile.at(place))
    }
}

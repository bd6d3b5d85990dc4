//! Contacts of segments with the surface.

/// A contact within a cell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellHit {
    /// Segment parameter.
    pub(crate) s: f64,
    /// Whether the ray came from the free side.
    pub(crate) from_front: bool,
    /// Away from the cell's borders: no other cell can have an earlier or equal contact.
    pub(crate) interior: bool,
}

/// The result of a traversal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contact {
    pub(crate) hit: Option<CellHit>,
    /// Cell of the hit, to decide between equal hits.
    pub(crate) cell: usize,
    /// The segment was behind some triangle.
    pub(crate) behind: bool,
}

impl Contact {
    pub(crate) const NONE: Self = Self {
        hit: None,
        cell: 0,
        behind: false,
    };

    /// Keeps the earliest contact; of equal ones that of the lowest cell, so that the result does not depend on
    /// the order of visits.
    #[inline(always)]
    pub(crate) fn offer(&mut self, hit: CellHit, cell: usize) {
        let earlier = self
            .hit
            .is_none_or(|best| (hit.s, cell) < (best.s, self.cell));
        if earlier {
            self.hit = Some(hit);
            self.cell = cell;
        }
    }
}

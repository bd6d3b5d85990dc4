//! Scans of progressive images: bands of coefficients, first their upper bits and then bit by bit (ITU-T T.81, annex
//! G).

use super::{ALL_MISSING, Bits, Huffman, Image};

/// Most blocks of a component: pictures of 67 million pixels. Bounds the memory that a few bytes can request.
const MAX_BLOCKS: u32 = 1 << 20;

/// The AC coefficients of a scan of one component.
struct Band<'a> {
    first: usize,
    last: usize,
    table: &'a Huffman,
    /// Remaining blocks without new coefficients.
    empty: u32,
}

impl Image {
    /// Parses a scan whose data begins at `start`; returns its end.
    pub(super) fn progressive_scan(
        &mut self,
        segment: &[u8],
        bytes: &[u8],
        start: usize,
    ) -> Option<usize> {
        let n = usize::from(*segment.first()?);
        let list = segment.get(1..1 + 2 * n)?;
        let &[first, last, bits_of] = segment.get(1 + 2 * n..)?.first_chunk::<3>()?;
        let (before, after) = (bits_of >> 4, bits_of & 15);
        let range = usize::from(first)..usize::from(last) + 1;
        if range.is_empty() || range.end > 64 || (first == 0) != (last == 0) {
            return None;
        }
        let mut parts = Vec::with_capacity(n);
        for c in list.chunks_exact(2) {
            let place = self.components.iter().position(|other| other.id == c[0])?;
            parts.push((place, c[1]));
            // The bits must come in order, without gaps.
            let expected = if before == 0 { ALL_MISSING } else { before };
            for missing in self.components[place].missing.get_mut(range.clone())? {
                if *missing != expected || (before > 0 && after + 1 != before) {
                    return None;
                }
                *missing = after;
            }
        }
        let mut bits = Bits::new(bytes, start);
        match (parts.as_slice(), first) {
            (parts, 0) => self.first_coefficients(parts, before > 0, &mut bits)?,
            (&[(place, tables)], _) => {
                let n_blocks = self.blocks_of(place).filter(|&n| n <= MAX_BLOCKS)?;
                let mut nonzero = std::mem::take(&mut self.components[place].nonzero);
                nonzero.resize(n_blocks as usize, 0);
                let mut band = Band {
                    first: range.start,
                    last: range.end - 1,
                    table: self.tables[1].get(usize::from(tables & 15))?.as_ref()?,
                    empty: 0,
                };
                for (unit, block) in (0..).zip(&mut nonzero) {
                    if self.restart_before(unit, &mut bits)? {
                        band.empty = 0;
                    }
                    match before {
                        0 => bits.found(&mut band, block)?,
                        _ => bits.refined(&mut band, block)?,
                    }
                }
                self.components[place].nonzero = nonzero;
            }
            // A band of several components is invalid.
            _ => return None,
        }
        Some(bits.at)
    }

    /// The first coefficient of each block, or one more bit of it.
    fn first_coefficients(
        &self,
        parts: &[(usize, u8)],
        refines: bool,
        bits: &mut Bits<'_>,
    ) -> Option<()> {
        let (h_most, v_most) = self.most_sampled()?;
        let units = match parts {
            [(place, _)] => self.blocks_of(*place)?,
            _ => self.width.div_ceil(8 * h_most) * self.height.div_ceil(8 * v_most),
        };
        for unit in 0..units {
            self.restart_before(unit, bits)?;
            for (place, tables) in parts {
                let c = &self.components[*place];
                let blocks = match parts.len() {
                    1 => 1,
                    _ => c.horizontal * c.vertical,
                };
                for _ in 0..blocks {
                    if refines {
                        bits.bit()?;
                        continue;
                    }
                    let table = self.tables[0].get(usize::from(tables >> 4))?.as_ref()?;
                    let category = bits.symbol(table)?;
                    bits.skip(u32::from(category).min(16))?;
                }
            }
        }
        Some(())
    }
}

impl Bits<'_> {
    /// Parses a block in the first scan of a band.
    fn found(&mut self, band: &mut Band<'_>, nonzero: &mut u64) -> Option<()> {
        if band.empty > 0 {
            band.empty -= 1;
            return Some(());
        }
        let mut k = band.first;
        while k <= band.last {
            let symbol = self.symbol(band.table)?;
            let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
            match (run, size) {
                (15, 0) => k += 16,
                (run, 0) => {
                    band.empty = (1 << run) - 1 + self.number(run as u32)?;
                    return Some(());
                }
                _ => {
                    k += run;
                    self.skip(size)?;
                    *nonzero |= 1_u64.checked_shl(k as u32)?;
                    k += 1;
                }
            }
        }
        (k == band.last + 1).then_some(())
    }

    /// Parses a block in a later scan: one more bit of the known coefficients, and new coefficients.
    fn refined(&mut self, band: &mut Band<'_>, nonzero: &mut u64) -> Option<()> {
        let mut k = band.first;
        while band.empty == 0 && k <= band.last {
            let symbol = self.symbol(band.table)?;
            let (mut run, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
            match (run, size) {
                (15, 0) => {}
                (run, 0) => {
                    // The run includes this block.
                    band.empty = (1 << run) + self.number(run)?;
                    break;
                }
                (_, 1) => self.skip(1)?,
                _ => return None,
            }
            // Skips the given number of coefficients that stay zero; the next zero one is the new coefficient, if
            // there is one.
            loop {
                if k > band.last {
                    return None;
                }
                let bit = 1_u64 << k;
                k += 1;
                if *nonzero & bit != 0 {
                    self.bit()?;
                } else if run == 0 {
                    if size == 1 {
                        *nonzero |= bit;
                    }
                    break;
                } else {
                    run -= 1;
                }
            }
        }
        if band.empty > 0 {
            band.empty -= 1;
            let rest = (k..=band.last).filter(|k| *nonzero >> k & 1 == 1).count();
            self.skip(rest as u32)?;
        }
        Some(())
    }
}

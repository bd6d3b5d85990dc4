//! Checks whether all blocks of a JPEG are present, for files without the end-of-image marker (cameras and stream
//! dumps omit it). Parses the Huffman codes of sequential and progressive images (ITU-T T.81) without decoding
//! pixels.

mod progressive;

/// The end of the last block's bytes, if every block of every component is present with all bits of each coefficient;
/// `None` for damaged or incomplete files and for lossless or arithmetic coding.
pub(super) fn end_of_blocks(bytes: &[u8]) -> Option<usize> {
    let mut image = Image::default();
    let mut at = 2;
    loop {
        let &[0xFF, marker] = bytes.get(at..at + 2)?.first_chunk::<2>()? else {
            return None;
        };
        match marker {
            0xFF => {
                at += 1;
                continue;
            }
            0x01 | 0xD0..=0xD7 => {
                at += 2;
                continue;
            }
            _ => {}
        }
        let length = usize::from(u16::from_be_bytes(*bytes.get(at + 2..)?.first_chunk()?));
        let segment = bytes.get(at + 4..at + 2 + length)?;
        at += 2 + length;
        match marker {
            0xC0 | 0xC1 => image.frame(segment)?,
            0xC2 => {
                image.frame(segment)?;
                image.progressive = true;
            }
            0xC4 => image.huffman(segment)?,
            // Other kinds of frames: lossless, hierarchical, arithmetic.
            0xC3 | 0xC5..=0xC7 | 0xC9..=0xCF => return None,
            0xDD => {
                image.restart_interval =
                    u32::from(u16::from_be_bytes(*segment.first_chunk::<2>()?));
            }
            0xDA => {
                at = match image.progressive {
                    false => image.scan(segment, bytes, at)?,
                    true => image.progressive_scan(segment, bytes, at)?,
                };
                if image.components.iter().all(Component::is_whole) {
                    return Some(at);
                }
            }
            _ => {}
        }
    }
}

#[derive(Debug, Default)]
struct Image {
    width: u32,
    height: u32,
    components: Vec<Component>,
    /// By class (DC, AC) and table number.
    tables: [[Option<Huffman>; 4]; 2],
    restart_interval: u32,
    progressive: bool,
}

#[derive(Debug)]
struct Component {
    id: u8,
    horizontal: u32,
    vertical: u32,
    /// Per coefficient: number of its last bits that are still missing.
    missing: [u8; 64],
    /// Per block of a progressive image: the coefficients that are not zero so far.
    nonzero: Vec<u64>,
}

/// Value for a coefficient that no scan has contained yet.
const ALL_MISSING: u8 = u8::MAX;

impl Component {
    fn is_whole(&self) -> bool {
        self.missing == [0; 64]
    }
}

/// A canonical Huffman code.
#[derive(Debug)]
struct Huffman {
    /// Number of codes of each length from 1 to 16 bits.
    counts: [u8; 16],
    values: Vec<u8>,
}

impl Image {
    fn frame(&mut self, segment: &[u8]) -> Option<()> {
        let &[_, h1, h0, w1, w0, n] = segment.first_chunk::<6>()?;
        (self.height, self.width) = (
            u16::from_be_bytes([h1, h0]).into(),
            u16::from_be_bytes([w1, w0]).into(),
        );
        let list = segment.get(6..6 + 3 * usize::from(n))?;
        self.components = list
            .chunks_exact(3)
            .map(|c| Component {
                id: c[0],
                horizontal: u32::from(c[1] >> 4),
                vertical: u32::from(c[1] & 15),
                missing: [ALL_MISSING; 64],
                nonzero: Vec::new(),
            })
            .collect();
        let sampled =
            |c: &Component| (1..=4).contains(&c.horizontal) && (1..=4).contains(&c.vertical);
        let good = self.width > 0 && self.height > 0 && (1..=4).contains(&n);
        (good && self.components.iter().all(sampled)).then_some(())
    }

    fn huffman(&mut self, mut segment: &[u8]) -> Option<()> {
        while !segment.is_empty() {
            let (&head, rest) = segment.split_first()?;
            let counts = *rest.first_chunk::<16>()?;
            let n = counts.iter().map(|&c| usize::from(c)).sum::<usize>();
            let values = rest.get(16..16 + n)?.to_vec();
            let slot = self
                .tables
                .get_mut(usize::from(head >> 4))?
                .get_mut(usize::from(head & 15))?;
            *slot = Some(Huffman { counts, values });
            segment = &rest[16 + n..];
        }
        Some(())
    }

    fn most_sampled(&self) -> Option<(u32, u32)> {
        let most = |side: fn(&Component) -> u32| self.components.iter().map(side).max();
        Some((most(|c| c.horizontal)?, most(|c| c.vertical)?))
    }

    /// Number of blocks of a component in a scan of its own.
    fn blocks_of(&self, place: usize) -> Option<u32> {
        let c = &self.components[place];
        let (h_most, v_most) = self.most_sampled()?;
        let across = (self.width * c.horizontal).div_ceil(h_most).div_ceil(8);
        let down = (self.height * c.vertical).div_ceil(v_most).div_ceil(8);
        Some(across * down)
    }

    /// Skips the restart marker before a unit that has one; returns whether it did.
    fn restart_before(&self, unit: u32, bits: &mut Bits<'_>) -> Option<bool> {
        let every = self.restart_interval;
        let has = every > 0 && unit > 0 && unit.is_multiple_of(every);
        if has {
            bits.restart()?;
        }
        Some(has)
    }

    /// Parses a scan whose data begins at `start`; returns its end.
    fn scan(&mut self, segment: &[u8], bytes: &[u8], start: usize) -> Option<usize> {
        let n = usize::from(*segment.first()?);
        let list = segment.get(1..1 + 2 * n)?;
        let (h_most, v_most) = self.most_sampled()?;
        // Per component of the scan: its index, tables and blocks per unit.
        let mut parts = Vec::with_capacity(n);
        for c in list.chunks_exact(2) {
            let place = self.components.iter().position(|other| other.id == c[0])?;
            let component = &self.components[place];
            let dc = self.tables[0].get(usize::from(c[1] >> 4))?.as_ref()?;
            let ac = self.tables[1].get(usize::from(c[1] & 15))?.as_ref()?;
            parts.push((place, dc, ac, component.horizontal * component.vertical));
        }
        let units = if let [(place, .., blocks)] = parts.as_mut_slice() {
            // A scan of one component counts its own blocks, independent of its sampling factors.
            *blocks = 1;
            self.blocks_of(*place)?
        } else {
            self.width.div_ceil(8 * h_most) * self.height.div_ceil(8 * v_most)
        };
        let mut bits = Bits::new(bytes, start);
        for unit in 0..units {
            self.restart_before(unit, &mut bits)?;
            for (_, dc, ac, blocks) in &parts {
                for _ in 0..*blocks {
                    bits.block(dc, ac)?;
                }
            }
        }
        let places: Vec<usize> = parts.iter().map(|(place, ..)| *place).collect();
        for place in places {
            self.components[place].missing = [0; 64];
        }
        Some(bits.at)
    }
}

/// Entropy-coded bits, up to a marker or the end of the file.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Unread bits of `current`.
    left: u32,
    current: u8,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            left: 0,
            current: 0,
        }
    }

    fn bit(&mut self) -> Option<u32> {
        if self.left == 0 {
            self.current = *self.bytes.get(self.at)?;
            self.at += 1;
            if self.current == 0xFF {
                // After 0xFF, a stuffed zero is skipped; any other byte belongs to a marker.
                if self.bytes.get(self.at) != Some(&0) {
                    return None;
                }
                self.at += 1;
            }
            self.left = 8;
        }
        self.left -= 1;
        Some(u32::from(self.current >> self.left & 1))
    }

    fn number(&mut self, n: u32) -> Option<u32> {
        (0..n).try_fold(0, |all, _| Some(all << 1 | self.bit()?))
    }

    fn skip(&mut self, n: u32) -> Option<()> {
        for _ in 0..n {
            self.bit()?;
        }
        Some(())
    }

    fn symbol(&mut self, table: &Huffman) -> Option<u8> {
        let (mut code, mut first, mut index) = (0u32, 0u32, 0usize);
        for count in table.counts {
            code = code << 1 | self.bit()?;
            let count = u32::from(count);
            if code.checked_sub(first)? < count {
                return table.values.get(index + (code - first) as usize).copied();
            }
            index += count as usize;
            first = (first + count) << 1;
        }
        None
    }

    fn block(&mut self, dc: &Huffman, ac: &Huffman) -> Option<()> {
        let category = self.symbol(dc)?;
        self.skip(u32::from(category).min(16))?;
        let mut k = 1;
        while k < 64 {
            let symbol = self.symbol(ac)?;
            let (run, size) = (symbol >> 4, u32::from(symbol & 15));
            match (run, size) {
                (15, 0) => k += 16,
                (_, 0) => return Some(()),
                _ => {
                    k += u32::from(run) + 1;
                    self.skip(size)?;
                }
            }
        }
        // More than 64 coefficients: damaged.
        (k <= 64).then_some(())
    }

    fn restart(&mut self) -> Option<()> {
        self.left = 0;
        while self.bytes.get(self.at) == Some(&0xFF) && self.bytes.get(self.at + 1) == Some(&0xFF) {
            self.at += 1;
        }
        match self.bytes.get(self.at..self.at + 2)? {
            [0xFF, 0xD0..=0xD7] => {
                self.at += 2;
                Some(())
            }
            _ => None,
        }
    }
}

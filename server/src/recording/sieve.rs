//! Checks every picture of a recording without decoding it, so that a frame with an empty, cut or unsupported file is
//! left out before playback. A picture whose first and last bytes are not sufficient is decoded once.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::PathBuf;

use crate::codec::CodecError;

use super::left_out::{LeftOut, name_of};
use super::location::Location;
use super::rig::{DepthRays, same_aspect};
use super::{Entry, Listing};

/// Bytes read from each end of a file: a header with its size, and the last marker with some padding after it.
const END_BYTES: usize = 64;
/// Bytes read of a picture in an archive: a JPEG's size comes after its profiles and previews. If these are longer,
/// the picture is decoded.
const PACKED_HEAD_BYTES: u64 = 64 << 10;
/// Most segments of a JPEG that are searched for its size: profiles and previews can be some dozens.
const MAX_JPEG_SEGMENTS: usize = 500;

/// Width and height.
type Size = (u32, u32);

/// The use of a picture, which determines how it is decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Color,
    Depth,
    Confidence,
}

/// Leaves out the frames with an unusable picture, and adds notes on them.
pub(super) fn sieve(listing: &mut Listing) {
    let n = listing.entries.len();
    note_unreadable_names(listing);
    let mut left = LeftOut::default();
    let mut kept: Vec<(Entry, Option<Size>, Option<Size>)> = Vec::with_capacity(n);
    for entry in std::mem::take(&mut listing.entries) {
        match sizes(&entry) {
            Ok((color, depth)) => kept.push((entry, color, depth)),
            Err((name, reason)) => left.add(name, reason),
        }
    }
    left.note(
        n,
        "frames have a picture that cannot be read and are left out",
        &mut listing.notes,
    );

    let mut other_size = LeftOut::default();
    if let Some(usual) = usual_size(kept.iter().filter_map(|(_, color, _)| *color)) {
        let (width, height) = usual;
        kept.retain(|(entry, color, _)| match color {
            Some((w, h)) if (*w, *h) != usual => {
                other_size.add(
                    name_of(&entry.color),
                    format!("image size: expected {width}x{height} as most have, got {w}x{h}"),
                );
                false
            }
            _ => true,
        });
    }
    other_size.note(
        n,
        "frames have colour of another size and are left out",
        &mut listing.notes,
    );

    // If the intrinsics fit no picture at all, decoding all pictures would only delay the error.
    let mut misfit = LeftOut::default();
    let camera = &listing.rig.color;
    kept.retain(|(entry, color, _)| match color {
        Some((w, h)) => match camera.for_image(*w, *h, &entry.color) {
            Ok(_) => true,
            Err(error) => {
                misfit.add(name_of(&entry.color), error);
                false
            }
        },
        None => true,
    });
    misfit.note(
        n,
        "frames do not fit the intrinsics and are left out",
        &mut listing.notes,
    );

    let mut other_aspect = LeftOut::default();
    if listing.rig.depth == DepthRays::Registered {
        kept.retain(|(entry, color, depth)| match (color, depth) {
            (Some((w, h)), Some(depth)) if !same_aspect((*w, *h), *depth) => {
                let reason = format!(
                    "{}: depth size: expected {w}x{h} or its aspect ratio, as the colour image, got {}x{}",
                    entry.depth.path().display(),
                    depth.0,
                    depth.1
                );
                other_aspect.add(name_of(&entry.depth), reason);
                false
            }
            _ => true,
        });
    }
    other_aspect.note(
        n,
        "frames have depth that does not fit their colour and are left out",
        &mut listing.notes,
    );
    listing.entries = kept.into_iter().map(|(entry, ..)| entry).collect();
}

/// Notes files beside the pictures whose names are not UTF-8; they belong to no frame.
fn note_unreadable_names(listing: &mut Listing) {
    let paths = listing.entries.iter().flat_map(|e| [&e.color, &e.depth]);
    let folders = paths.filter_map(|picture| picture.parent());
    let folders: BTreeMap<PathBuf, Location> = folders
        .map(|folder| (folder.path().to_owned(), folder))
        .collect();
    let mut left = LeftOut::default();
    let mut n = 0;
    for folder in folders.values() {
        let names = folder.unreadable_names();
        if names.is_empty() {
            continue;
        }
        n += names.len() + folder.file_names().map_or(0, |names| names.len());
        for name in names {
            left.add(name, "expected UTF-8");
        }
    }
    left.note(
        n,
        "files have names that are not UTF-8 and are left out",
        &mut listing.notes,
    );
}

/// The most frequent size; the first one on a tie.
fn usual_size(sizes: impl Iterator<Item = Size>) -> Option<Size> {
    let mut counts: HashMap<Size, (usize, usize)> = HashMap::new();
    for (place, size) in sizes.enumerate() {
        counts.entry(size).or_insert((0, place)).0 += 1;
    }
    let most = |(_, (count, place)): &(Size, (usize, usize))| (*count, usize::MAX - place);
    counts.into_iter().max_by_key(most).map(|(size, _)| size)
}

/// Sizes of colour and depth if known; else the picture that cannot be read, and the reason.
fn sizes(entry: &Entry) -> Result<(Option<Size>, Option<Size>), (String, CodecError)> {
    let look = |picture: &Location, kind| look(picture, kind).map_err(|e| (name_of(picture), e));
    let color = look(&entry.color, Kind::Color)?;
    let depth = look(&entry.depth, Kind::Depth)?;
    if let Some(picture) = &entry.confidence {
        look(picture, Kind::Confidence)?;
    }
    Ok((color, depth))
}

/// The size of a picture, if its header contains it; an error if it cannot be read.
fn look(picture: &Location, kind: Kind) -> Result<Option<Size>, CodecError> {
    match ends(picture) {
        Ok(Ends::Whole(size)) => Ok(size),
        // Empty, of an unknown format, or probably cut: the picture is decoded, and the decoder's error is more
        // precise.
        Ok(Ends::Doubtful) | Err(_) => match kind {
            Kind::Color => picture.color().map(|image| (image.width, image.height)),
            Kind::Depth => picture.depth().map(|image| (image.width, image.height)),
            Kind::Confidence => picture.gray8().map(|image| (image.width, image.height)),
        }
        .map(Some),
    }
}

/// Result of checking both ends of a picture's file.
enum Ends {
    /// Beginning and end are present; the size if known.
    Whole(Option<Size>),
    /// An end is missing, or the format is unknown.
    Doubtful,
}

fn ends(picture: &Location) -> std::io::Result<Ends> {
    let Some(path) = picture.on_disk() else {
        // The end of a compressed picture is known only after all of it is inflated, and a checksum protects it: only
        // its head is read.
        let bytes = picture.head(PACKED_HEAD_BYTES)?;
        let head = &bytes[..bytes.len().min(END_BYTES)];
        return judge(head, |_| true, &mut Cursor::new(&bytes));
    };
    // Checked before opening, because opening a pipe would wait for its writer.
    if !std::fs::metadata(path)?.is_file() {
        return Ok(Ends::Doubtful);
    }
    let mut file = BufReader::with_capacity(4096, File::open(path)?);
    let mut head = Vec::with_capacity(END_BYTES);
    (&mut file).take(END_BYTES as u64).read_to_end(&mut head)?;
    let length = file.seek(SeekFrom::End(0))?;
    file.seek(SeekFrom::Start(length.saturating_sub(END_BYTES as u64)))?;
    let mut tail = Vec::with_capacity(END_BYTES);
    (&mut file).take(END_BYTES as u64).read_to_end(&mut tail)?;
    let ends_in = |mark: &[u8]| tail.windows(mark.len()).any(|bytes| bytes == mark);
    judge(&head, ends_in, &mut file)
}

/// Checks the first bytes of a picture, with `ends_in` to test whether its last bytes contain a marker.
fn judge(
    head: &[u8],
    ends_in: impl Fn(&[u8]) -> bool,
    file: &mut (impl Read + Seek),
) -> std::io::Result<Ends> {
    Ok(match head {
        [
            0x89,
            b'P',
            b'N',
            b'G',
            0x0D,
            0x0A,
            0x1A,
            0x0A,
            _,
            _,
            _,
            _,
            b'I',
            b'H',
            b'D',
            b'R',
            size @ ..,
        ] if ends_in(b"IEND") => {
            let side = |at: usize| Some(u32::from_be_bytes(*size.get(at..)?.first_chunk()?));
            Ends::Whole(side(0).zip(side(4)))
        }
        [0xFF, 0xD8, ..] if ends_in(&[0xFF, 0xD9]) => {
            file.seek(SeekFrom::Start(2))?;
            jpeg_size(file)?.map_or(Ends::Doubtful, |size| Ends::Whole(Some(size)))
        }
        // Formats without an end marker; a cut file is detected when it is decoded.
        [b'I', b'I', 42, 0, ..]
        | [b'M', b'M', 0, 42, ..]
        | [0x93, b'N', b'U', b'M', b'P', b'Y', ..]
        | [0x76, 0x2F, 0x31, 0x01, ..]
        | [b'P', b'2' | b'5' | b'f', b'\n' | b'\r' | b' ' | b'\t', ..] => Ends::Whole(None),
        _ => Ends::Doubtful,
    })
}

/// The size in a JPEG's frame header; the reader is positioned after the first marker.
fn jpeg_size(file: &mut (impl Read + Seek)) -> std::io::Result<Option<Size>> {
    for _ in 0..MAX_JPEG_SEGMENTS {
        let mut marker = [0; 2];
        file.read_exact(&mut marker)?;
        // Fill bytes may precede a marker.
        while marker == [0xFF, 0xFF] {
            file.read_exact(&mut marker[1..])?;
        }
        match marker {
            [0xFF, 0x01 | 0xD0..=0xD8] => continue,
            // Frame headers: baseline, progressive and others, except the three codes with another use.
            [0xFF, 0xC0..=0xCF] if !matches!(marker[1], 0xC4 | 0xC8 | 0xCC) => {
                let mut header = [0; 7];
                file.read_exact(&mut header)?;
                let [_, _, _, h1, h0, w1, w0] = header;
                let side = |high, low| u32::from(u16::from_be_bytes([high, low]));
                return Ok(Some((side(w1, w0), side(h1, h0))));
            }
            // A scan before any size.
            [0xFF, 0xDA | 0xD9] => return Ok(None),
            [0xFF, _] => {
                let mut length = [0; 2];
                file.read_exact(&mut length)?;
                let rest = i64::from(u16::from_be_bytes(length)) - 2;
                if rest < 0 {
                    return Ok(None);
                }
                file.seek_relative(rest)?;
            }
            _ => return Ok(None),
        }
    }
    Ok(None)
}

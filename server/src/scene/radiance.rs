//! Radiance pictures (.hdr, .pic) from untrusted bytes: any program's signature, any line ends, all eight
//! orientations, uncompressed and both run-length encodings, RGBE and XYZE. Texels are radiance: the exposures and
//! colour corrections in the header are undone.

/// A decoded map: rows from the top, columns from the left.
#[derive(Debug)]
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Linear, unchecked: the file may hold negative and infinite values.
    pub(super) texels: Vec<[f32; 3]>,
    /// Notes on unusual content.
    pub(super) notes: Vec<String>,
}

/// Most lines of a header; real files have ten.
const MAX_LINES: usize = 1000;

/// Linear Rec. 709 from CIE XYZ.
const RGB_FROM_XYZ: [[f32; 3]; 3] = [
    [3.240_97, -1.537_383_2, -0.498_610_76],
    [-0.969_243_65, 1.875_967_5, 0.041_555_06],
    [0.055_630_08, -0.203_976_96, 1.056_971_5],
];

/// The header.
struct Header {
    /// Number and length of the scan lines.
    n_lines: u32,
    line_length: u32,
    /// Whether the scan lines are columns.
    is_transposed: bool,
    /// Whether the order of the lines, and of the texels in a line, is reversed.
    is_flipped: [bool; 2],
    is_xyz: bool,
    /// Factor applied to each channel by the writer.
    applied: [f32; 3],
    notes: Vec<String>,
}

/// Decodes a picture. `reserve` is called with its size before it is allocated.
pub(super) fn decode(
    bytes: &[u8],
    reserve: impl FnOnce(u32, u32) -> Result<(), String>,
) -> Result<Picture, String> {
    let mut rest = bytes;
    let header = read_header(&mut rest)?;
    let (width, height) = match header.is_transposed {
        false => (header.line_length, header.n_lines),
        true => (header.n_lines, header.line_length),
    };
    reserve(width, height)?;
    let mut texels = vec![[0.0; 3]; width as usize * height as usize];
    let mut line = vec![[0u8; 4]; header.line_length as usize];
    for i in 0..header.n_lines {
        read_line(&mut rest, &mut line)
            .ok_or_else(|| format!("its texels end early, in line {i} of {}", header.n_lines))?;
        for (k, &rgbe) in line.iter().enumerate() {
            let turned = |i: u32, n: u32, is_flipped: bool| if is_flipped { n - 1 - i } else { i };
            let across = turned(i, header.n_lines, header.is_flipped[0]);
            let along = turned(k as u32, header.line_length, header.is_flipped[1]);
            let (column, row) = match header.is_transposed {
                false => (along, across),
                true => (across, along),
            };
            texels[row as usize * width as usize + column as usize] = texel(rgbe, &header);
        }
    }
    Ok(Picture {
        width,
        height,
        texels,
        notes: header.notes,
    })
}

/// Shared exponent: the mantissas are 8-bit fractions.
fn texel([r, g, b, e]: [u8; 4], header: &Header) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    let scale = (f32::from(e) - 136.0).exp2();
    let mut color = [r, g, b].map(|c| f32::from(c) * scale);
    if header.is_xyz {
        color = RGB_FROM_XYZ.map(|row| row.iter().zip(color).map(|(m, c)| m * c).sum());
    }
    std::array::from_fn(|k| color[k] / header.applied[k])
}

/// The next line without its line end; `None` at the end of the file.
fn next_line<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let end = rest.iter().position(|&b| b == b'\n')?;
    let line = &rest[..end];
    *rest = &rest[end + 1..];
    Some(line.strip_suffix(b"\r").unwrap_or(line))
}

fn read_header(rest: &mut &[u8]) -> Result<Header, String> {
    let cut = || "its header is cut short".to_owned();
    let mut header = Header {
        n_lines: 0,
        line_length: 0,
        is_transposed: false,
        is_flipped: [false; 2],
        is_xyz: false,
        applied: [1.0; 3],
        notes: Vec::new(),
    };
    for _ in 0..MAX_LINES {
        let line = String::from_utf8_lossy(next_line(rest).ok_or_else(cut)?).into_owned();
        let line = line.trim();
        if line.is_empty() {
            let size = next_line(rest).ok_or_else(cut)?;
            size_line(&String::from_utf8_lossy(size), &mut header)?;
            return Ok(header);
        }
        if line.starts_with('#') {
            continue;
        }
        let Some((name, value)) = line.split_once('=') else {
            continue;
        };
        variable(name.trim(), value.trim(), &mut header)?;
    }
    Err(format!("its header has more than {MAX_LINES} lines"))
}

fn variable(name: &str, value: &str, header: &mut Header) -> Result<(), String> {
    let numbers: Vec<f32> = value
        .split_whitespace()
        .map_while(|word| word.parse().ok())
        .collect();
    let usable = |x: &f32| *x > 0.0 && x.is_finite();
    match name.to_ascii_uppercase().as_str() {
        "FORMAT" if value.eq_ignore_ascii_case("32-bit_rle_rgbe") => {}
        "FORMAT" if value.eq_ignore_ascii_case("32-bit_rle_xyze") => {
            header.is_xyz = true;
            header
                .notes
                .push("its XYZ colours are converted to Rec. 709".to_owned());
        }
        "FORMAT" => {
            return Err(format!(
                "expected the format 32-bit_rle_rgbe or 32-bit_rle_xyze, got {value:?}"
            ));
        }
        // Both may occur several times; the factors are multiplied.
        "EXPOSURE" => match numbers.first().filter(|x| usable(x)) {
            Some(x) => header.applied = header.applied.map(|applied| applied * x),
            None => header.notes.push(format!("EXPOSURE {value:?} left out")),
        },
        "COLORCORR" => match numbers.as_slice() {
            [r, g, b, ..] if [r, g, b].into_iter().all(usable) => {
                for (applied, x) in header.applied.iter_mut().zip([r, g, b]) {
                    *applied *= x;
                }
            }
            _ => header.notes.push(format!("COLORCORR {value:?} left out")),
        },
        _ => {}
    }
    if !header.applied.iter().all(usable) {
        return Err(format!("its exposures multiply to {:?}", header.applied));
    }
    Ok(())
}

/// Parses a size such as `-Y 512 +X 1024`: scan lines first; minus is down and left.
fn size_line(line: &str, header: &mut Header) -> Result<(), String> {
    let fail = || format!("expected its size as in \"-Y 512 +X 1024\", got {line:?}");
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[first, n_lines, second, line_length] = words.as_slice() else {
        return Err(fail());
    };
    let number = |word: &str| word.parse::<u32>().map_err(|_| fail());
    header.n_lines = number(n_lines)?;
    header.line_length = number(line_length)?;
    header.is_transposed = match (first, second) {
        ("-Y" | "+Y", "-X" | "+X") => false,
        ("-X" | "+X", "-Y" | "+Y") => true,
        _ => return Err(fail()),
    };
    header.is_flipped = [first, second].map(|axis| matches!(axis, "+Y" | "-X"));
    Ok(())
}

/// Decodes a scan line; `None` if the bytes are damaged or end early.
fn read_line(rest: &mut &[u8], line: &mut [[u8; 4]]) -> Option<()> {
    let n = line.len();
    if let &[2, 2, high, low, ..] = *rest
        && high < 128
        && n >= 8
        && usize::from(high) << 8 | usize::from(low) == n
    {
        *rest = &rest[4..];
        return (0..4).try_for_each(|channel| read_channel(rest, line, channel));
    }
    let mut at = 0;
    let mut shift = 0;
    while at < n {
        let (&texel, after) = rest.split_first_chunk::<4>()?;
        *rest = after;
        let [1, 1, 1, count] = texel else {
            line[at] = texel;
            at += 1;
            shift = 0;
            continue;
        };
        // Repeats the last texel; the counts of consecutive repeats are digits, lowest first.
        let n_repeats = usize::from(count).checked_shl(shift)?;
        shift += 8;
        let last = *line.get(at.checked_sub(1)?)?;
        line.get_mut(at..at.checked_add(n_repeats)?)?.fill(last);
        at += n_repeats;
        if shift > 24 {
            return None;
        }
    }
    Some(())
}

/// Decodes one channel of a scan line in runs: codes over 128 repeat a byte, others precede literal bytes.
fn read_channel(rest: &mut &[u8], line: &mut [[u8; 4]], channel: usize) -> Option<()> {
    let mut at = 0;
    while at < line.len() {
        let (&code, after) = rest.split_first()?;
        *rest = after;
        let (n, is_run) = match code {
            0 => return None,
            129.. => (usize::from(code - 128), true),
            _ => (usize::from(code), false),
        };
        let texels = line.get_mut(at..at + n)?;
        let bytes = rest.get(..if is_run { 1 } else { n })?;
        for (texel, byte) in texels.iter_mut().zip(bytes.iter().cycle()) {
            texel[channel] = *byte;
        }
        *rest = &rest[bytes.len()..];
        at += n;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(bytes: &[u8]) -> Result<Picture, String> {
        decode(bytes, |width, height| match width.checked_mul(height) {
            Some(1..=4096) => Ok(()),
            _ => Err(format!("{width}x{height}")),
        })
    }

    /// Texels with powers of two as values, in file order.
    fn file(header: &str, size: &str, texels: &[u8]) -> Vec<u8> {
        let mut bytes = format!("{header}\n\n{size}\n").into_bytes();
        bytes.extend(texels.iter().flat_map(|&e| [128, 128, 128, 128 + e]));
        bytes
    }

    fn reds(picture: &Picture) -> Vec<f32> {
        picture.texels.iter().map(|t| t[0]).collect()
    }

    #[test]
    fn every_orientation_lands_upright() {
        // Rows 1 2 4 and 8 16 32, in the order of the file.
        let upright = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
        for (size, exponents) in [
            ("-Y 2 +X 3", [1, 2, 3, 4, 5, 6]),
            ("+Y 2 +X 3", [4, 5, 6, 1, 2, 3]),
            ("-Y 2 -X 3", [3, 2, 1, 6, 5, 4]),
            ("+Y 2 -X 3", [6, 5, 4, 3, 2, 1]),
            ("+X 3 -Y 2", [1, 4, 2, 5, 3, 6]),
            ("+X 3 +Y 2", [4, 1, 5, 2, 6, 3]),
            ("-X 3 -Y 2", [3, 6, 2, 5, 1, 4]),
            ("-X 3 +Y 2", [6, 3, 5, 2, 4, 1]),
        ] {
            let bytes = file("#?RADIANCE\nFORMAT=32-bit_rle_rgbe", size, &exponents);
            let picture = read(&bytes).unwrap();
            assert_eq!((picture.width, picture.height), (3, 2), "{size}");
            assert_eq!(reds(&picture), upright, "{size}");
        }
    }

    #[test]
    fn headers_of_every_program_are_read() {
        for header in [
            "#?RGBE\nFORMAT=32-bit_rle_rgbe",
            "#?AUTOPANO\n# comment\nSOFTWARE=x\nformat = 32-bit_rle_rgbe",
            "#?RADIANCE\r\nFORMAT=32-bit_rle_rgbe\r",
            "#?RADIANCE",
        ] {
            assert_eq!(
                reds(&read(&file(header, "-Y 1 +X 2", &[1, 2])).unwrap()),
                [1.0, 2.0]
            );
        }
        let crlf = b"#?RGBE\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n-Y 1 +X 1\r\n\x80\x80\x80\x81";
        assert_eq!(reds(&read(crlf).unwrap()), [1.0]);
    }

    #[test]
    fn what_was_applied_is_undone() {
        let bytes = file(
            "#?RADIANCE\nEXPOSURE=2\nEXPOSURE= 4.0\nCOLORCORR= 1 0.5 2",
            "-Y 1 +X 1",
            &[4],
        );
        assert_eq!(read(&bytes).unwrap().texels, [[1.0, 2.0, 0.5]]);
        let bytes = file("#?RADIANCE\nEXPOSURE=0\nCOLORCORR=1 2", "-Y 1 +X 1", &[1]);
        let picture = read(&bytes).unwrap();
        assert_eq!((picture.texels[0], picture.notes.len()), ([1.0; 3], 2));
        // An equal-energy grey in XYZ is nearly grey.
        let bytes = file("#?RADIANCE\nFORMAT=32-bit_rle_xyze", "-Y 1 +X 1", &[1]);
        let picture = read(&bytes).unwrap();
        assert!(
            (picture.texels[0][1] - 0.948).abs() < 1e-3,
            "{:?}",
            picture.texels
        );
        assert_eq!(picture.notes.len(), 1);
    }

    #[test]
    fn both_run_length_codings_are_read() {
        let mut old = file("#?RADIANCE", "-Y 1 +X 300", &[1]);
        // 1 + 43 + 256 texels.
        old.extend([1, 1, 1, 43, 1, 1, 1, 1]);
        assert_eq!(reds(&read(&old).unwrap()), [1.0; 300]);
        let mut new = file("#?RADIANCE", "-Y 1 +X 8", &[]);
        new.extend([2, 2, 0, 8]);
        new.extend([128 + 8, 128]);
        new.extend([4, 128, 0, 128, 0, 128 + 4, 64]);
        new.extend([128 + 8, 0]);
        new.extend([128 + 8, 129]);
        let picture = read(&new).unwrap();
        assert_eq!(picture.texels[0], [1.0, 1.0, 0.0]);
        assert_eq!((picture.texels[1][1], picture.texels[7][1]), (0.0, 0.5));
        for bytes in [old, new] {
            for n in 0..bytes.len() {
                assert!(read(&bytes[..n]).is_err(), "{n}");
            }
        }
    }

    #[test]
    fn damage_is_one_clear_error() {
        for (header, size, problem) in [
            (
                "#?RADIANCE\nFORMAT=jpeg",
                "-Y 1 +X 1",
                "expected the format",
            ),
            ("#?RADIANCE", "-Y 1 +Y 1", "expected its size"),
            ("#?RADIANCE", "-Y 1 +X -1", "expected its size"),
            ("#?RADIANCE", "1 1", "expected its size"),
            (
                "#?RADIANCE\nEXPOSURE=1e30\nEXPOSURE=1e30",
                "-Y 1 +X 1",
                "multiply",
            ),
            ("#?RADIANCE", "-Y 1 +X 2", "end early, in line 0 of 1"),
        ] {
            let error = read(&file(header, size, &[1])).unwrap_err();
            assert!(error.contains(problem) && !error.contains('\n'), "{error}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(
            size in "[-+][XY] [0-9]{1,3} [-+][XY] [0-9]{1,3}",
            tail in prop::collection::vec(prop_oneof![any::<u8>(), 0u8..3], 0..300),
        ) {
            let mut bytes = file("#?RADIANCE", &size, &[]);
            bytes.extend(tail);
            let _ = read(&bytes);
        }
    }
}

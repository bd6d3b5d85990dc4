//! Lines, words and numbers of OBJ and MTL.

use std::borrow::Cow;

/// The next line without its line end (LF, CR LF, or CR alone), joined with its continuation lines, and the number of
/// lines. A backslash continues a line, even with blanks after it, but not in a comment.
pub(in crate::scene) fn take_line<'a>(rest: &mut &'a [u8]) -> (Cow<'a, [u8]>, usize) {
    fn one<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
        let end = rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let (line, after) = rest.split_at(end.unwrap_or(rest.len()));
        *rest = match after {
            [b'\r', b'\n', after @ ..] | [_, after @ ..] => after,
            [] => after,
        };
        line
    }
    fn continued(line: &[u8]) -> Option<&[u8]> {
        line.trim_ascii_end().strip_suffix(b"\\")
    }
    let line = one(rest);
    let Some(head) = continued(line).filter(|_| !line.trim_ascii_start().starts_with(b"#")) else {
        return (Cow::Borrowed(line), 0);
    };
    let mut joined = head.to_vec();
    let mut extra = 0;
    while !rest.is_empty() {
        joined.push(b' ');
        let line = one(rest);
        extra += 1;
        match continued(line) {
            Some(head) => joined.extend_from_slice(head),
            None => {
                joined.extend_from_slice(line);
                break;
            }
        }
    }
    (Cow::Owned(joined), extra)
}

/// The first word, and the rest.
pub(in crate::scene) fn split_keyword(line: &[u8]) -> (&[u8], &[u8]) {
    let line = line.trim_ascii_start();
    let end = line
        .iter()
        .position(u8::is_ascii_whitespace)
        .unwrap_or(line.len());
    line.split_at(end)
}

/// The words before a comment.
pub(super) fn tokens(values: &[u8]) -> impl Iterator<Item = &[u8]> {
    values
        .split(u8::is_ascii_whitespace)
        .filter(|token| !token.is_empty())
        .take_while(|token| token[0] != b'#')
}

/// A word, formatted for a message.
pub(super) fn show(token: &[u8]) -> String {
    let head = &token[..token.len().min(40)];
    format!("{:?}", String::from_utf8_lossy(head))
}

/// The numbers at the start of a line.
pub(super) struct Numbers<'a, const N: usize> {
    /// NaN after the last number.
    pub(super) values: [f64; N],
    /// Their number, at most N.
    pub(super) n: usize,
    /// The first word that is not a number.
    pub(super) unreadable: Option<&'a [u8]>,
    /// Whether any has a decimal comma.
    pub(super) commas: bool,
}

/// Reads up to N numbers.
pub(super) fn numbers<const N: usize>(values: &[u8]) -> Numbers<'_, N> {
    let mut read = Numbers {
        values: [f64::NAN; N],
        n: 0,
        unreadable: None,
        commas: false,
    };
    for (slot, token) in read.values.iter_mut().zip(tokens(values)) {
        read.n += 1;
        match number(token) {
            Some((value, comma)) => {
                *slot = value;
                read.commas |= comma;
            }
            None => read.unreadable = read.unreadable.or(Some(token)),
        }
    }
    read
}

/// A number, and whether it has a decimal comma.
fn number(token: &[u8]) -> Option<(f64, bool)> {
    let text = std::str::from_utf8(token).ok()?;
    if let Ok(value) = text.parse() {
        return Some((value, false));
    }
    let (whole, fraction) = text.split_once(',')?;
    let digits = |text: &str| {
        !text.is_empty()
            && text
                .bytes()
                .all(|b| b.is_ascii_digit() || b == b'e' || b == b'-')
    };
    if !digits(fraction) {
        return None;
    }
    let value = format!("{whole}.{fraction}").parse().ok()?;
    Some((value, true))
}

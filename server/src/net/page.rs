//! The browser client, built into the binary.

/// Embeds files of `client-web/`, by their paths in it.
macro_rules! files {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_bytes!(concat!("../../../client-web/", $path)))),*]
    };
}

/// Path below `/client/` and content; `index.html` is served at `/` as well.
const FILES: &[(&str, &[u8])] = files![];

/// A file of the client and its media type.
pub(super) fn file(path: &str) -> Option<(&'static str, &'static [u8])> {
    let &(name, bytes) = FILES.iter().find(|(name, _)| *name == path)?;
    Some((media_type(name), bytes))
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js" | "mjs") => "text/javascript; charset=utf-8",
        Some("json") => "application/json",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        _ => "application/octet-stream",
    }
}

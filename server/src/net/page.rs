//! The browser client, built into the binary.

/// Embeds files of `client-web/`, by their paths in it.
macro_rules! files {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_bytes!(concat!("../../../client-web/", $path)))),*]
    };
}

/// Path below `/client/` and content; `index.html` is served at `/` as well.
const FILES: &[(&str, &[u8])] = files![
    "index.html",
    "style.css",
    "icon.svg",
    "src/clock.js",
    "src/composite.js",
    "src/connection.js",
    "src/control.js",
    "src/controls.js",
    "src/decoder.worker.js",
    "src/depth.js",
    "src/dom.js",
    "src/frame.js",
    "src/main.js",
    "src/placements.js",
    "src/png.js",
    "src/protocol.js",
    "src/requests.js",
    "src/stages.js",
    "src/quality.js",
    "src/stats.js",
    "src/view.js",
    "src/wire.js",
    "src/zstd.js",
];

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Files of a folder of the client, as the page names them.
    fn listed(folder: &str) -> Vec<String> {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../client-web");
        std::fs::read_dir(path.join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .map(|name| match folder {
                "" => name,
                _ => format!("{folder}/{name}"),
            })
            .collect()
    }

    #[test]
    fn every_script_and_style_of_the_page_is_served() {
        let mut expected = listed("src");
        expected.extend(listed("").into_iter().filter(|name| {
            let kind = name.rsplit('.').next();
            matches!(kind, Some("html" | "css" | "svg"))
        }));
        expected.sort();
        let mut served: Vec<_> = FILES.iter().map(|(name, _)| (*name).to_owned()).collect();
        served.sort();
        assert_eq!(served, expected);
        assert!(file("src/main.js").is_some_and(|(kind, _)| kind.starts_with("text/javascript")));
        assert_eq!(file("../Cargo.toml"), None);
    }
}

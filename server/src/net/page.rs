//! The browser client, built into the binary.

use include_dir::{Dir, include_dir};

/// The page's own files, by their paths below `/client/`; `index.html` is served at `/` as well.
const FILES: [(&str, &[u8]); 3] = [
    (
        "index.html",
        include_bytes!("../../../client-web/index.html"),
    ),
    ("style.css", include_bytes!("../../../client-web/style.css")),
    ("icon.svg", include_bytes!("../../../client-web/icon.svg")),
];

/// Its modules, served below `/client/src/`.
static MODULES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../client-web/src");

/// A file of the client and its media type.
pub(super) fn file(path: &str) -> Option<(&'static str, &'static [u8])> {
    let bytes = match path.strip_prefix("src/") {
        Some(module) => MODULES.get_file(module)?.contents(),
        None => FILES.iter().find(|(name, _)| *name == path)?.1,
    };
    Some((media_type(path), bytes))
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit('.').next() {
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

    /// The files in a folder of the client, with the paths that the page uses.
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
        assert!(expected.len() > 15, "{expected:?}");
        for name in expected {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../client-web");
            let bytes = std::fs::read(path.join(&name)).unwrap();
            assert_eq!(
                file(&name).map(|(_, served)| served),
                Some(&bytes[..]),
                "{name}"
            );
        }
        assert!(file("src/main.js").is_some_and(|(kind, _)| kind.starts_with("text/javascript")));
        for path in [
            "../Cargo.toml",
            "src/../../Cargo.toml",
            "src/",
            "package.json",
        ] {
            assert_eq!(file(path), None, "{path}");
        }
    }
}

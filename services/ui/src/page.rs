//! The files of the page, which are part of the program: it works without any other network.

use tangent_page_libraries as page_libraries;

/// Files of the page: path, media type and content.
const FILES: &[(&str, &str, &[u8])] = &[
    ("/", HTML, include_bytes!("../page/index.html")),
    ("/style.css", CSS, include_bytes!("../page/style.css")),
    ("/page.js", JS, include_bytes!("../page/page.js")),
    ("/link.js", JS, include_bytes!("../page/link.js")),
    ("/plot.js", JS, include_bytes!("../page/plot.js")),
    ("/teach.js", JS, include_bytes!("../page/teach.js")),
    ("/scene.js", JS, include_bytes!("../page/scene.js")),
    ("/texts.js", JS, include_bytes!("../page/texts.js")),
    (
        "/texts.en.json",
        JSON,
        include_bytes!("../page/texts.en.json"),
    ),
    ("/icon.svg", SVG, include_bytes!("../page/icon.svg")),
    (
        "/vendor/three.core.min.js",
        JS,
        page_libraries::THREE_CORE.as_bytes(),
    ),
    (
        "/vendor/three.module.min.js",
        JS,
        page_libraries::THREE.as_bytes(),
    ),
    (
        "/vendor/OrbitControls.js",
        JS,
        page_libraries::ORBIT_CONTROLS.as_bytes(),
    ),
    ("/vendor/uPlot.esm.js", JS, page_libraries::UPLOT.as_bytes()),
    (
        "/vendor/uPlot.min.css",
        CSS,
        page_libraries::UPLOT_STYLE.as_bytes(),
    ),
    ("/vendor/NOTICE.md", TEXT, page_libraries::NOTICE.as_bytes()),
    (
        "/vendor/LICENSE.three.txt",
        TEXT,
        page_libraries::THREE_LICENSE.as_bytes(),
    ),
    (
        "/vendor/LICENSE.uPlot.txt",
        TEXT,
        page_libraries::UPLOT_LICENSE.as_bytes(),
    ),
];

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const JSON: &str = "application/json";
const SVG: &str = "image/svg+xml";
const TEXT: &str = "text/plain; charset=utf-8";

/// Media type and content of a file of the page.
pub fn file(path: &str) -> Option<(&'static str, &'static [u8])> {
    let (_, kind, content) = FILES.iter().find(|(known, ..)| *known == path)?;
    Some((kind, content))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn text(path: &str) -> &'static str {
        std::str::from_utf8(file(path).unwrap().1).unwrap()
    }

    /// Every file that the page names is served, and none is fetched from elsewhere.
    #[test]
    fn the_page_is_whole_and_needs_no_other_host() {
        let own = FILES
            .iter()
            .filter(|(path, ..)| !path.starts_with("/vendor/"));
        let mut named = BTreeSet::new();
        for (path, kind, content) in own {
            let content = std::str::from_utf8(content).unwrap();
            for host in ["https://", "//cdn", "http://"] {
                let plain = content.replace("http://www.w3.org/2000/svg", "");
                assert!(!plain.contains(host), "{path}: {host}");
            }
            if *kind == JS || *kind == HTML {
                for word in content.split(['"', '\'']) {
                    if word.starts_with("./") || word.starts_with("/vendor/") {
                        named.insert(word.trim_start_matches('.').to_owned());
                    }
                }
            }
        }
        assert!(named.len() >= 8, "{named:?}");
        for path in named {
            assert!(file(&path).is_some(), "{path} is not served");
        }
        assert!(file("/nothing").is_none() && file("/../Cargo.toml").is_none());
    }

    /// Every text that the page shows stands in the file of the language, and no other.
    #[test]
    fn every_text_is_in_the_file_of_the_language_and_is_used() {
        let texts: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(text("/texts.en.json")).unwrap();
        let source: String = [
            "/",
            "/page.js",
            "/plot.js",
            "/scene.js",
            "/link.js",
            "/teach.js",
        ]
        .map(text)
        .concat();
        let mut used = BTreeSet::new();
        for (start, end) in [
            ("data-text=\"", '"'),
            ("data-label=\"", '"'),
            ("say(\"", '"'),
        ] {
            for rest in source.split(start).skip(1) {
                used.insert(rest.split(end).next().unwrap().to_owned());
            }
        }
        for key in &used {
            assert!(texts.contains_key(key), "{key} has no text");
        }
        // Keys that are composed from what the service sends.
        let composed = ["light.", "part.", "phase.", "action.", "role."];
        for key in texts.keys() {
            let is_composed = composed.iter().any(|c| key.starts_with(c));
            let known = is_composed || source.contains(&format!("\"{key}\""));
            assert!(known, "{key} is not used");
        }
        for phase in tangent_control::Phase::ALL {
            let key = format!("phase.{}", phase.name());
            assert!(texts.contains_key(&key), "{key}");
        }
    }

    #[test]
    fn libraries_of_others_have_their_licence_beside_them() {
        let notice = text("/vendor/NOTICE.md");
        for (path, ..) in FILES {
            if let Some(name) = path.strip_prefix("/vendor/")
                && name.ends_with("s")
                && !name.starts_with("LICENSE")
            {
                assert!(notice.contains(name), "{name}");
            }
        }
        assert!(text("/vendor/LICENSE.three.txt").contains("three.js authors"));
        assert!(text("/vendor/LICENSE.uPlot.txt").contains("Leon Sorokin"));
        assert!(text("/vendor/uPlot.esm.js").contains("Leon Sorokin"));
        let version = text("/vendor/three.core.min.js").contains("\"180\"");
        assert!(version && notice.contains("0.180.0"));
    }
}

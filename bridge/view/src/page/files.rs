//! The files that browsers fetch.

use super::{PageOptions, PanelScript};
use std::borrow::Cow;
use std::path::Path;

/// The page, as names and contents.
static FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/page_files.rs"));

/// The file of a path that begins with a slash, and its media type.
pub(super) fn find(path: &str, options: &PageOptions) -> Option<(Cow<'static, [u8]>, &'static str)> {
    let name = match path.strip_prefix('/')? {
        "" if options.start.is_empty() => "index.html",
        "" => options.start,
        name => name,
    };
    if let Some(panel) = name.strip_prefix("panels/").and_then(|rest| rest.strip_suffix("/panel.js"))
        && let Some(panel) = options.panels.iter().find(|known| known.name == panel)
    {
        return Some((script(&panel.script)?, "text/javascript; charset=utf-8"));
    }
    let media_type = media_type(name)?;
    if cfg!(debug_assertions)
        && let Some(contents) = from_source(name)
    {
        return Some((contents.into(), media_type));
    }
    let (_, contents) = FILES.iter().find(|(known, _)| *known == name)?;
    Some((Cow::Borrowed(contents), media_type))
}

fn script(script: &PanelScript) -> Option<Cow<'static, [u8]>> {
    match script {
        PanelScript::Text(Cow::Borrowed(text)) => Some(text.as_bytes().into()),
        PanelScript::Text(Cow::Owned(text)) => Some(text.clone().into_bytes().into()),
        PanelScript::File(path) => {
            let read = downbeat_msgs::user_file::read(path);
            let read = read.inspect_err(|error| tracing::warn!("the panel {}: {error}", path.display()));
            read.ok().map(Cow::Owned)
        }
    }
}

/// The file in the source tree, so that who works on the page sees an edit by a reload.
fn from_source(name: &str) -> Option<Vec<u8>> {
    let is_plain = |part: &str| {
        !part.starts_with('.')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte))
    };
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/page"));
    name.split('/').all(is_plain).then(|| std::fs::read(folder.join(name)).ok()).flatten()
}

fn media_type(name: &str) -> Option<&'static str> {
    Some(match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "json" | "webmanifest" => "application/json",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::Panel;

    #[test]
    fn only_files_of_the_page_are_found() {
        let options = PageOptions::default();
        assert!(find("/", &options).is_some_and(|(_, media_type)| media_type.starts_with("text/html")));
        assert!(find("/app.js", &options).is_some());
        for wrong in [
            "",
            "app.js",
            "//app.js",
            "/../Cargo.toml",
            "/../build.rs",
            "/panels/../../Cargo.toml",
            "/.hidden.js",
            "/./app.js",
            "/%2e%2e/app.js",
            "/panels/x/panel.js",
            "/app.js/",
            "/\0.js",
            "/page",
        ] {
            assert!(find(wrong, &options).is_none(), "{wrong}");
        }
    }

    #[test]
    fn a_panel_is_found_by_its_name() {
        let panel = |name: &str, script| Panel {
            name: name.into(),
            title: String::new(),
            module: String::new(),
            script,
            topics: Vec::new(),
        };
        let panels = vec![
            panel("chart", PanelScript::Text("export default {}".into())),
            panel("gone", PanelScript::File("/nowhere/panel.js".into())),
        ];
        let options = PageOptions { panels, ..PageOptions::default() };
        let found = find("/panels/chart/panel.js", &options).map(|(contents, _)| contents);
        assert_eq!(found.as_deref(), Some(b"export default {}".as_slice()));
        assert!(find("/panels/gone/panel.js", &options).is_none());
    }
}

//! The recordings of the cell, and the reports beside them.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use serde::Serialize;

/// Largest number of recordings that are listed, the newest first.
const LISTED_MAX: usize = 200;
/// Beginning of a report that is searched for its result, bytes.
const HEAD_MAX: u64 = 2048;
/// What stands before the result in a report.
const RESULT: &str = "<meta name=\"tangent-result\" content=\"";

/// A recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingFile {
    /// Name of the file.
    pub file: String,
    /// Its size, bytes.
    pub bytes: u64,
    /// Time of the last change, s since the Unix epoch.
    pub changed_s: u64,
    /// Name of the report beside it, if there is one.
    pub report: Option<String>,
    /// How the task of that report ended, in words.
    pub result: Option<String>,
}

/// The recordings of a folder, the newest first.
pub fn list(folder: &Path) -> Vec<RecordingFile> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<RecordingFile> = entries
        .filter_map(|entry| {
            let file = entry.file_name().into_string().ok()?;
            let metadata = entry.metadata().ok()?;
            let changed = metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
            let report = is_name(&file, ".mcap").then(|| file.replace(".mcap", ".html"))?;
            let page = folder.join(&report);
            Some(RecordingFile {
                bytes: metadata.len(),
                changed_s: changed.as_secs(),
                result: result(&page),
                report: page.is_file().then_some(report),
                file,
            })
        })
        .collect();
    found.sort_by(|a, b| (b.changed_s, &b.file).cmp(&(a.changed_s, &a.file)));
    found.truncate(LISTED_MAX);
    found
}

/// The result in the head of a report; `None` without a report, or in one of an older version.
fn result(page: &Path) -> Option<String> {
    let mut head = Vec::new();
    File::open(page)
        .ok()?
        .take(HEAD_MAX)
        .read_to_end(&mut head)
        .ok()?;
    let head = String::from_utf8_lossy(&head);
    let (_, rest) = head.split_once(RESULT)?;
    let (text, _) = rest.split_once('"')?;
    let plain = text.replace("&lt;", "<").replace("&gt;", ">");
    Some(plain.replace("&quot;", "\"").replace("&amp;", "&"))
}

/// Path of a recording or a report, given by its name alone; `None` if there is none.
pub fn path(folder: &Path, file: &str) -> Option<PathBuf> {
    let path = folder.join(file);
    let good = is_name(file, ".html") || is_name(file, ".mcap");
    (good && path.is_file()).then_some(path)
}

fn is_name(name: &str, end: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    name.len() <= 200 && name.ends_with(end) && !name.starts_with('.') && name.chars().all(good)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_are_listed_with_the_reports_beside_them() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.mcap", "a.html", "b.mcap", "c.txt", "cell.toml"] {
            fs::write(folder.path().join(name), name).unwrap();
        }
        let page = format!("<!DOCTYPE html><head>{RESULT}wipe &lt;a&gt;: completed\"></head>");
        fs::write(folder.path().join("a.html"), page).unwrap();
        let mut listed = list(folder.path());
        listed.sort_by(|a, b| a.file.cmp(&b.file));
        assert_eq!(listed.len(), 2);
        assert_eq!(listed[0].report.as_deref(), Some("a.html"));
        assert_eq!(listed[0].result.as_deref(), Some("wipe <a>: completed"));
        assert_eq!(listed[1].result, None);
        assert_eq!((listed[1].report.as_deref(), listed[1].bytes), (None, 6));
        assert!(path(folder.path(), "a.html").is_some());
        assert!(path(folder.path(), "b.mcap").is_some());
        for name in ["cell.toml", "b.html", "../a.html", "", "c.txt", ".html"] {
            assert_eq!(path(folder.path(), name), None, "{name}");
        }
        assert_eq!(list(Path::new("/nowhere")), []);
    }
}

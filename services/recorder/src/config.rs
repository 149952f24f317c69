//! Settings of the recorder.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use tangent_runtime::CellConfig;

use crate::writer::FileOptions;

/// Settings of the recorder.
#[derive(Clone, Debug, PartialEq)]
pub struct RecorderConfig {
    /// Folder of the recordings. It is created if it does not exist.
    pub folder: PathBuf,
    /// First part of the names of the files: the cell.
    pub prefix: String,
    /// Key patterns to record, relative to the cell: `*` is one part of a key, `**` any number of
    /// parts.
    pub include: Vec<String>,
    /// Key patterns not to record, even if `include` matches.
    pub exclude: Vec<String>,
    /// Names of the cells to record; empty: the bus's own, whose topics then have no prefix.
    pub cells: Vec<String>,
    /// Size after which a new file begins, bytes.
    pub rotate_bytes: u64,
    /// Time after which a new file begins.
    pub rotate_after: Duration,
    /// Time after which received messages are synced to the disk; the end of the process or a power
    /// cut loses at most that much.
    pub flush_every: Duration,
    /// Largest size of all recordings in the folder, with torn copies, bytes. Beyond it, the oldest
    /// files are deleted; `None`: never.
    pub keep_bytes: Option<u64>,
    /// Time since the last write after which recordings are deleted; `None`: never.
    pub keep_for: Option<Duration>,
    /// Free space on the disk below which writing stops, bytes: the file's index still needs room.
    pub free_min_bytes: u64,
    /// Whether chunks are compressed with zstd.
    pub compress: bool,
    /// Whether the messages of `wrench/raw` are packed into arrays.
    pub pack: bool,
    /// Files stored inside each recording: name and text.
    pub attachments: Vec<(String, String)>,
    /// Names and values stored inside each recording as metadata `tangent`, beside the version.
    pub facts: BTreeMap<String, String>,
    /// Largest number of messages that wait for the disk.
    pub queue: usize,
}

impl Default for RecorderConfig {
    fn default() -> Self {
        Self {
            folder: PathBuf::from("recordings"),
            prefix: "cell".to_owned(),
            include: vec!["**".to_owned()],
            exclude: Vec::new(),
            cells: Vec::new(),
            rotate_bytes: 1 << 30,
            rotate_after: Duration::from_secs(3600),
            flush_every: Duration::from_millis(400),
            keep_bytes: None,
            keep_for: None,
            free_min_bytes: 64 << 20,
            compress: true,
            pack: true,
            attachments: Vec::new(),
            facts: version_facts(),
            queue: 1 << 16,
        }
    }
}

impl RecorderConfig {
    /// From a cell's `[recorder]` section. The cell file's text is not in it: add it with
    /// [`Self::with_attachment`].
    pub fn from_cell(cell: &CellConfig) -> Self {
        let section = &cell.recorder;
        let mut facts = version_facts();
        facts.insert("cell".to_owned(), cell.cell.name.clone());
        facts.insert("robot".to_owned(), cell.robot.model.clone());
        facts.insert("controller".to_owned(), cell.controller.preset.clone());
        if !section.cells.is_empty() {
            facts.insert("cells".to_owned(), section.cells.join(","));
        }
        Self {
            folder: section.folder.clone(),
            prefix: cell.cell.name.clone(),
            include: section.include.clone(),
            exclude: section.exclude.clone(),
            cells: section.cells.clone(),
            rotate_bytes: (section.rotate_mb * 1e6) as u64,
            rotate_after: Duration::from_secs_f64(section.rotate_s),
            keep_bytes: Some(section.keep_bytes).filter(|&bytes| bytes > 0),
            keep_for: Some(section.keep_days)
                .filter(|&days| days > 0.0)
                .map(|days| Duration::from_secs_f64(days * 86_400.0)),
            compress: section.compress,
            pack: section.pack,
            facts,
            queue: section.queue_messages,
            ..Self::default()
        }
    }

    /// Options of its files.
    pub(crate) fn options(&self) -> FileOptions {
        FileOptions {
            compress: self.compress,
            pack: self.pack,
        }
    }

    /// Adds a fact about the run: `scenario`, `seed`, `estimator`.
    pub fn with_fact(mut self, name: &str, value: &str) -> Self {
        self.facts.insert(name.to_owned(), value.to_owned());
        self
    }

    /// Adds a file that is stored inside each recording: `task.toml`, `scenario.toml`.
    pub fn with_attachment(mut self, name: &str, text: &str) -> Self {
        self.attachments.push((name.to_owned(), text.to_owned()));
        self
    }
}

/// Facts about the program that need no query.
fn version_facts() -> BTreeMap<String, String> {
    [
        ("version", env!("CARGO_PKG_VERSION")),
        ("target_arch", std::env::consts::ARCH),
        ("target_os", std::env::consts::OS),
        (
            "build",
            if cfg!(debug_assertions) {
                "debug"
            } else {
                "release"
            },
        ),
    ]
    .map(|(name, value)| (name.to_owned(), value.to_owned()))
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cell_that_ships_is_taken_over_key_by_key() {
        let cell = CellConfig::default_cell();
        let config = RecorderConfig::from_cell(&cell)
            .with_fact("seed", "7")
            .with_attachment("cell.toml", "[cell]");
        assert_eq!(config.prefix, "cell1");
        assert_eq!(config.rotate_bytes, 1_024_000_000);
        assert_eq!(config.rotate_after, Duration::from_secs(3600));
        assert_eq!(config.queue, 65_536);
        assert_eq!((config.keep_bytes, config.keep_for), (None, None));
        assert_eq!(config.include, ["**"]);
        assert_eq!(config.facts["seed"], "7");
        assert_eq!(config.facts["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(config.attachments[0].0, "cell.toml");
    }
}

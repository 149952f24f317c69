//! The kind of a file, inferred from its keys.

use std::fmt;

use toml::Table;

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A cell: robot, sensor, tool, limits, network.
    Cell,
    /// A task: force, path, estimators.
    Task,
    /// A scenario of the simulator.
    Scenario,
    /// A robot model.
    Model,
}

/// The kind cannot be inferred from the file's keys.
#[derive(Debug, thiserror::Error)]
pub enum KindError {
    /// The file is not valid TOML.
    #[error("not TOML: {0}")]
    NotToml(String),
    /// None of its keys is known.
    #[error(
        "neither a cell ([robot], [sensor], ...), a task ([force], [path], ...), a scenario ([plant], [task], ...) nor a \
         robot model (dof, [dh], ...): its keys are {0}; state the kind with --kind"
    )]
    UnknownKeys(String),
}

/// Keys at the top of each kind of file.
const KEYS: [(FileKind, &[&str]); 4] = [
    (
        FileKind::Cell,
        &[
            "cell",
            "robot",
            "sensor",
            "tool",
            "camera",
            "limits",
            "zenoh",
            "recorder",
            "ros2",
            "simulator",
            "realtime",
        ],
    ),
    (
        FileKind::Task,
        &[
            "force",
            "path",
            "approach",
            "end",
            "timeouts",
            "switching",
            "tare",
        ],
    ),
    (
        FileKind::Scenario,
        &[
            "kind",
            "plant",
            "task",
            "duration_s",
            "estimation",
            "control",
            "sensing",
            "pipeline",
        ],
    ),
    (
        FileKind::Model,
        &["dof", "dh", "joint_names", "bodies", "home_rad", "flange"],
    ),
];

/// The kind with most of its keys in the text.
///
/// # Errors
/// The text is not TOML, or contains none of the known keys.
pub fn of(text: &str) -> Result<FileKind, KindError> {
    let table: Table = text.parse().map_err(|error: toml::de::Error| {
        KindError::NotToml(error.to_string().trim_end().to_owned())
    })?;
    let found = KEYS
        .iter()
        .map(|(kind, keys)| {
            (
                keys.iter().filter(|key| table.contains_key(**key)).count(),
                kind,
            )
        })
        .max_by_key(|(count, _)| *count)
        .filter(|(count, _)| *count > 0);
    found.map(|(_, kind)| *kind).ok_or_else(|| {
        let keys: Vec<&str> = table.keys().map(String::as_str).collect();
        KindError::UnknownKeys(if keys.is_empty() {
            "none".to_owned()
        } else {
            keys.join(", ")
        })
    })
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cell => "cell",
            Self::Task => "task",
            Self::Scenario => "scenario",
            Self::Model => "model",
        })
    }
}

//! What a file is, seen from its keys.

use toml::Table;

use crate::cli::FileKind;

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
/// No TOML, or none of the known keys.
pub fn of(text: &str) -> Result<FileKind, String> {
    let table: Table = text
        .parse()
        .map_err(|error: toml::de::Error| format!("not TOML: {}", error.to_string().trim_end()))?;
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
        format!(
            "neither a cell ([robot], [sensor], ...), a task ([force], [path], ...), a scenario ([plant], [task], ...) nor a robot model (dof, [dh], ...): its keys are {}; say which with --kind",
            if keys.is_empty() { "none".to_owned() } else { keys.join(", ") }
        )
    })
}

/// As it is called on the command line.
pub fn name(kind: FileKind) -> &'static str {
    match kind {
        FileKind::Cell => "cell",
        FileKind::Task => "task",
        FileKind::Scenario => "scenario",
        FileKind::Model => "model",
    }
}

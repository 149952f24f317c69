//! Task files that the page offers.

use std::fs;
use std::io;
use std::path::Path;

use serde::Serialize;
use tangent_control::Task;

/// Largest number of files that are listed.
const FILES_MAX: usize = 200;
/// Largest file that is read, bytes.
const BYTES_MAX: u64 = 256 * 1024;

/// A task file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskFile {
    /// Name of the file.
    pub file: String,
    /// Name of the task.
    pub name: String,
    /// Wanted force, N.
    pub force_n: f64,
}

/// The task files of a folder, by name. Files that are no tasks are left out.
pub fn list(folder: &Path) -> Vec<TaskFile> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| is_file_name(name))
        .take(FILES_MAX)
        .collect();
    names.sort();
    let task = |file: String| {
        let task: Task = text(folder, &file).ok()?.parse().ok()?;
        Some(TaskFile {
            file,
            name: task.name.clone(),
            force_n: task.force.reference_n,
        })
    };
    names.into_iter().filter_map(task).collect()
}

/// Text of a task file, given by its name alone.
///
/// # Errors
/// The name is not one of a task file in the folder, or the file cannot be read.
pub fn text(folder: &Path, file: &str) -> io::Result<String> {
    if !is_file_name(file) {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "not the name of a task file",
        ));
    }
    let path = folder.join(file);
    if fs::metadata(&path)?.len() > BYTES_MAX {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("larger than {BYTES_MAX} bytes"),
        ));
    }
    fs::read_to_string(path)
}

/// Whether this is a plain name that ends with `.toml`.
fn is_file_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    name.len() <= 100 && name.ends_with(".toml") && !name.starts_with('.') && name.chars().all(good)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_tasks_are_listed_and_only_plain_names_are_read() {
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/tasks");
        let listed = list(&shipped);
        assert!(
            listed
                .iter()
                .any(|t| t.file == "raster.toml" && t.force_n > 0.0)
        );
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("tasks")).unwrap();
        let tasks = folder.path().join("tasks");
        fs::write(folder.path().join("cell.toml"), "secret").unwrap();
        fs::write(tasks.join("note.toml"), "a = 1").unwrap();
        assert_eq!(list(&tasks), []);
        assert_eq!(list(&folder.path().join("nowhere")), []);
        for name in [
            "../cell.toml",
            "/etc/passwd",
            "a/b.toml",
            "..toml",
            "",
            "note",
        ] {
            assert!(text(&tasks, name).is_err(), "{name}");
        }
        assert_eq!(text(&tasks, "note.toml").unwrap(), "a = 1");
        fs::write(tasks.join("big.toml"), vec![b'#'; 300 * 1024]).unwrap();
        assert!(text(&tasks, "big.toml").is_err());
    }
}

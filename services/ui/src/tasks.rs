//! Task files that the page offers, and those that it saves.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

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

/// Why a task file is not saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The cell has no folder of its own for them.
    #[error(
        "there is no folder {} (ui.tasks): make it, and start the page again; the tasks that ship are not changed",
        .0.display()
    )]
    NoFolder(PathBuf),
    /// The name is not one of a task file.
    #[error("the name \"{0}\" is not allowed: 1 to 60 letters, digits, - and _")]
    Name(String),
    /// A file of this name exists, and was not to be replaced.
    #[error("{0} exists: replace it, or choose another name")]
    Exists(String),
    /// The folder is full.
    #[error("the folder has {FILES_MAX} task files: delete some first")]
    Full,
    /// Nothing can be saved.
    #[error("{0}")]
    Draft(String),
    /// The file cannot be written.
    #[error("{file} cannot be written: {source}")]
    Io {
        /// Name of the file.
        file: String,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Whether a task file of this name may be saved in the folder.
///
/// # Errors
/// Why not.
pub fn may_save(folder: &Path, file: &str, replace: bool) -> Result<(), SaveError> {
    let name = file.strip_suffix(".toml").unwrap_or_default();
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    if !(1..=60).contains(&name.len()) || !name.chars().all(good) {
        return Err(SaveError::Name(name.to_owned()));
    }
    // A link that leads nowhere is there, too.
    let exists = fs::symlink_metadata(folder.join(file)).is_ok();
    if exists && !replace {
        return Err(SaveError::Exists(file.to_owned()));
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let count = names.filter(|name| is_file_name(name)).count();
    if !exists && count >= FILES_MAX {
        return Err(SaveError::Full);
    }
    Ok(())
}

/// Saves a task file in the folder, whole or not at all. A link of this name is replaced, and what
/// it leads to is left alone.
///
/// # Errors
/// As [`may_save`]; or the file cannot be written.
pub fn save(folder: &Path, file: &str, text: &str, replace: bool) -> Result<(), SaveError> {
    may_save(folder, file, replace)?;
    let failed = |source: io::Error| match source.kind() {
        io::ErrorKind::AlreadyExists => SaveError::Exists(file.to_owned()),
        _ => SaveError::Io {
            file: file.to_owned(),
            source,
        },
    };
    let target = folder.join(file);
    // Only whole files have a name that is listed.
    let partial = folder.join(format!(".{file}.{}.part", std::process::id()));
    let _ = fs::remove_file(&partial);
    let mut opened = fs::File::create_new(&partial).map_err(failed)?;
    let written = opened
        .write_all(text.as_bytes())
        .and_then(|()| opened.sync_all())
        .and_then(|()| match replace {
            true => fs::rename(&partial, &target),
            // Unlike renaming, this fails if the name has been taken meanwhile.
            false => fs::hard_link(&partial, &target),
        });
    let _ = fs::remove_file(&partial);
    written.map_err(failed)
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
    fn a_task_is_saved_in_the_folder_alone_and_replaces_nothing_unasked() {
        let outside = tempfile::tempdir().unwrap();
        let tasks = outside.path().join("tasks");
        fs::create_dir(&tasks).unwrap();
        let read = |file: &str| fs::read_to_string(tasks.join(file)).unwrap();
        save(&tasks, "lid.toml", "a = 1", false).unwrap();
        let again = save(&tasks, "lid.toml", "a = 2", false).unwrap_err();
        assert!(matches!(again, SaveError::Exists(_)), "{again}");
        assert_eq!(read("lid.toml"), "a = 1");
        save(&tasks, "lid.toml", "a = 2", true).unwrap();
        assert_eq!(read("lid.toml"), "a = 2");
        let long = format!("{}.toml", "a".repeat(61));
        let names = [
            "../x.toml",
            "a/b.toml",
            ".toml",
            ".x.toml",
            "a.b.toml",
            "a",
            "a b.toml",
            "/x.toml",
            &long,
        ];
        for name in names {
            for replace in [false, true] {
                let refused = save(&tasks, name, "", replace).unwrap_err();
                assert!(matches!(refused, SaveError::Name(_)), "{name}: {refused}");
            }
        }
        // A link out of the folder is replaced, and not followed.
        let secret = outside.path().join("cell.toml");
        fs::write(&secret, "secret").unwrap();
        std::os::unix::fs::symlink(&secret, tasks.join("link.toml")).unwrap();
        assert!(save(&tasks, "link.toml", "a = 3", false).is_err());
        save(&tasks, "link.toml", "a = 3", true).unwrap();
        assert_eq!(fs::read_to_string(&secret).unwrap(), "secret");
        let left: Vec<_> = fs::read_dir(&tasks).unwrap().flatten().collect();
        assert_eq!(left.len(), 2, "{left:?}");
    }

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

//! Files of the operating system (`/proc`, `/sys`, `/etc`), below a root that tests replace.

use std::fs;
use std::path::{Path, PathBuf};

/// Root folder below which the files are read.
pub struct System {
    root: PathBuf,
}

impl System {
    /// This machine.
    pub fn here() -> Self {
        Self::below("/")
    }

    /// A file tree in the layout of a machine.
    pub fn below(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Path of `path` on this system.
    pub fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// Text of a file without surrounding white space; `None` if it cannot be read.
    pub fn text(&self, path: &str) -> Option<String> {
        let bytes = fs::read(self.path(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    /// Value of a file that contains one number.
    pub fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    /// Whether this file or folder exists.
    pub fn exists(&self, path: &str) -> bool {
        self.path(path).exists()
    }

    /// Sorted names in a folder; empty if it cannot be read.
    pub fn names(&self, path: &str) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(self.path(path))
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    /// Last component of a link's target.
    pub fn link_name(&self, path: &str) -> Option<String> {
        let target = fs::read_link(self.path(path)).ok()?;
        let name = Path::new(&target).file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// Path of this process's control group for a version 1 controller such as `cpu`, below the
    /// controller's root.
    pub fn group_v1(&self, controller: &str) -> Option<String> {
        let text = self.text("/proc/self/cgroup")?;
        text.lines().find_map(|line| {
            let mut parts = line.splitn(3, ':');
            let (_, names, path) = (parts.next()?, parts.next()?, parts.next()?);
            names
                .split(',')
                .any(|name| name == controller)
                .then(|| path.trim_end_matches('/').to_owned())
        })
    }

    /// Path of this process's version 2 control group, below the root of the hierarchy.
    pub fn group_v2(&self) -> Option<String> {
        let text = self.text("/proc/self/cgroup")?;
        let path = text.lines().find_map(|line| line.strip_prefix("0::"))?;
        Some(path.trim_end_matches('/').to_owned())
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A system that consists of the given files, for tests.
    pub fn machine(files: &[(&str, &str)]) -> (tempfile::TempDir, System) {
        let folder = tempfile::tempdir().unwrap();
        let system = System::below(folder.path());
        for (path, text) in files {
            let path = system.path(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        (folder, system)
    }

    #[test]
    fn control_groups_of_both_versions() {
        let text = "4:cpu,cpuacct:/docker/abc\n1:name=systemd:/x\n0::/user.slice\n";
        let (_folder, system) = machine(&[("/proc/self/cgroup", text)]);
        assert_eq!(system.group_v1("cpu").as_deref(), Some("/docker/abc"));
        assert_eq!(system.group_v1("memory"), None);
        assert_eq!(system.group_v2().as_deref(), Some("/user.slice"));
    }
}

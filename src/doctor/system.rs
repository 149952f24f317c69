//! The system's own files (`/proc`, `/sys`, `/etc`), below a root that tests replace.

use std::fs;
use std::path::{Path, PathBuf};

/// Where the files are read.
pub struct System {
    root: PathBuf,
}

impl System {
    /// This machine.
    pub fn here() -> Self {
        Self::below("/")
    }

    /// A tree of files that looks like a machine.
    pub fn below(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Where `path` is on this system.
    pub fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// A file's text without the space around it; `None` when it cannot be read.
    pub fn text(&self, path: &str) -> Option<String> {
        let bytes = fs::read(self.path(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    /// A file that holds one number.
    pub fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    /// True when there is such a file or folder.
    pub fn exists(&self, path: &str) -> bool {
        self.path(path).exists()
    }

    /// Names in a folder, sorted; none when it cannot be read.
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

    /// Last part of what a link leads to.
    pub fn link_name(&self, path: &str) -> Option<String> {
        let target = fs::read_link(self.path(path)).ok()?;
        let name = Path::new(&target).file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// The control group of this process for a version 1 controller such as `cpu`, from the controller's top.
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

    /// The same for version 2.
    pub fn group_v2(&self) -> Option<String> {
        let text = self.text("/proc/self/cgroup")?;
        let path = text.lines().find_map(|line| line.strip_prefix("0::"))?;
        Some(path.trim_end_matches('/').to_owned())
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A machine made of these files.
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

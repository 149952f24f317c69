//! File systems that fill up or hang, under the recorder's folder. Mounting one requires root;
//! without it, the faults that need one are skipped, with the reason.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use tangent_compose::with_causes;

use crate::error::{Context, Result, bail};

/// Size of the file system, MB; the recorder keeps 64 MB free.
const SIZE_MB: u64 = 1024;

/// A small file system mounted on a folder; unmounted when dropped.
pub struct SmallDisk {
    folder: PathBuf,
    image: PathBuf,
    frozen: bool,
}

impl SmallDisk {
    /// Mounts an ext4 image through a loop device.
    ///
    /// # Errors
    /// What is missing, most likely the permission to mount.
    pub fn mount(image: &Path, folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder)?;
        File::create(image)?.set_len(SIZE_MB << 20)?;
        run("mkfs.ext4", &["-q", "-F", &text(image)])?;
        run("mount", &["-o", "loop", &text(image), &text(folder)])?;
        Ok(Self {
            folder: folder.to_owned(),
            image: image.to_owned(),
            frozen: false,
        })
    }

    /// Fills the file system completely.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn fill(&self) -> Result<()> {
        fs::create_dir_all(self.filler())?;
        for shift in (0..10).rev() {
            let size = format!("{}M", 1 << shift);
            let file = self.filler().join(&size);
            // The first sizes may not fit. In the end, less than a megabyte is left.
            if run("fallocate", &["-l", &size, &text(&file)]).is_err() {
                fs::remove_file(&file).ok();
            }
        }
        Ok(())
    }

    /// Frees the space again.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn empty(&self) -> Result<()> {
        Ok(fs::remove_dir_all(self.filler())?)
    }

    fn filler(&self) -> PathBuf {
        self.folder.join("somebody_elses")
    }

    /// Freezes the file system: writers block from now on.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn freeze(&mut self) -> Result<()> {
        run("fsfreeze", &["-f", &text(&self.folder)])?;
        self.frozen = true;
        Ok(())
    }

    /// Unfreezes the file system: writers continue.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn thaw(&mut self) -> Result<()> {
        run("fsfreeze", &["-u", &text(&self.folder)])?;
        self.frozen = false;
        Ok(())
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let folder = text(&self.folder);
        if self.frozen {
            let _ = run("fsfreeze", &["-u", &folder]);
        }
        // Lazy unmount, since a recorder may still be closing its file.
        if let Err(error) = run("umount", &["-l", &folder]) {
            tracing::warn!("{}", with_causes(&error));
        }
        let _ = fs::remove_file(&self.image);
    }
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

fn run(program: &str, args: &[&str]) -> Result<()> {
    let output = Command::new(program)
        .args(args)
        .output()
        .with_context(|| program.to_owned())?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("{program}: {}", said.trim());
    }
    Ok(())
}

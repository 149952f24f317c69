//! File systems that fill up or hang, under the recorder's folder. Making one takes root; without
//! it the faults that need them are skipped, with the reason.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

/// The file system's size; the recorder keeps 64 MB free.
const SIZE_MB: u64 = 1024;

/// A small file system mounted on a folder; gone when dropped.
pub struct SmallDisk {
    folder: PathBuf,
    image: PathBuf,
    frozen: bool,
}

impl SmallDisk {
    /// An ext4 image behind a loop device.
    ///
    /// # Errors
    /// What is missing: most likely the right to mount.
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

    /// Nothing is left.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn fill(&self) -> Result<()> {
        fs::create_dir_all(self.filler())?;
        for shift in (0..10).rev() {
            let size = format!("{}M", 1 << shift);
            let file = self.filler().join(&size);
            // The first that do not fit are not there; what is left in the end is less than a
            // megabyte.
            if run("fallocate", &["-l", &size, &text(&file)]).is_err() {
                fs::remove_file(&file).ok();
            }
        }
        Ok(())
    }

    /// Room again.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn empty(&self) -> Result<()> {
        Ok(fs::remove_dir_all(self.filler())?)
    }

    fn filler(&self) -> PathBuf {
        self.folder.join("somebody_elses")
    }

    /// Writers block from now on.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn freeze(&mut self) -> Result<()> {
        run("fsfreeze", &["-f", &text(&self.folder)])?;
        self.frozen = true;
        Ok(())
    }

    /// They go on.
    ///
    /// # Errors
    /// When the system refuses.
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
        // Lazily: a recorder may just be closing its file.
        if let Err(error) = run("umount", &["-l", &folder]) {
            tracing::warn!("{error:#}");
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

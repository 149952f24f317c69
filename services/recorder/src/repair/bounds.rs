//! Limits of disk space and time for a repair.

use std::path::Path;

use tangent_runtime::Stop;

use crate::RecorderError;

/// Limits of a repair.
pub(crate) struct Bounds<'a> {
    /// Space that must stay free on the disk, bytes.
    pub free_min_bytes: u64,
    /// Number of bytes free in a folder; `None` if unknown.
    pub free: &'a dyn Fn(&Path) -> Option<u64>,
    /// Ends the repair. What it has written is then removed.
    pub stop: &'a Stop,
    /// Whether to pause for half of the time, so that the recording has the disk.
    pub gently: bool,
}

impl Bounds<'_> {
    /// Checks that there is room for `bytes` more.
    pub fn check_room(&self, path: &Path, bytes: u64) -> Result<(), RecorderError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        match (self.free)(folder) {
            Some(free) if free < self.free_min_bytes.saturating_add(bytes) => {
                Err(RecorderError::NoRoom {
                    path: path.to_owned(),
                    free_mb: free >> 20,
                    needed_mb: bytes.div_ceil(1 << 20),
                    kept_mb: self.free_min_bytes >> 20,
                })
            }
            _ => Ok(()),
        }
    }
}

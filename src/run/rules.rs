//! The access rules of a running router. The file is checked periodically, so that revoking an
//! identity does not need a restart.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use tangent_runtime::{Bus, BusError, CellConfig, Role, Stop};

/// Interval between two checks of the file.
const LOOK: Duration = Duration::from_secs(1);
/// Longest time until the port of a closed session is free.
const PORT_PATIENCE: Duration = Duration::from_secs(10);
const PORT_RETRY: Duration = Duration::from_millis(100);

/// The file, and its content at the last check.
pub struct Rules {
    file: Option<PathBuf>,
    seen: Option<Vec<u8>>,
    opened: bool,
}

impl Rules {
    /// Rules of a router with certificates; other processes have none.
    pub fn of(config: &CellConfig, role: Role) -> Self {
        let secured = role == Role::Router && config.zenoh.tls.is_some();
        let file = config.zenoh.access.clone().filter(|_| secured);
        Self {
            seen: file.as_ref().and_then(|file| std::fs::read(file).ok()),
            file,
            opened: false,
        }
    }

    /// Opens the session; the second time, it waits until the port of the first is free.
    pub fn open(&mut self, config: &CellConfig, role: Role, stop: &Stop) -> Result<Bus> {
        let began = Instant::now();
        loop {
            match Bus::open_until(config, role, None, stop) {
                Err(BusError::PortBusy { .. })
                    if self.opened && began.elapsed() < PORT_PATIENCE =>
                {
                    stop.wait(PORT_RETRY);
                }
                opened => {
                    self.opened = true;
                    return Ok(opened?);
                }
            }
        }
    }

    /// Interval between two checks.
    pub fn period(&self) -> Duration {
        match self.file {
            Some(_) => LOOK,
            None => Duration::from_secs(3600),
        }
    }

    /// `None` if the file has not changed; otherwise whether a router would accept it.
    pub fn changed(&mut self, config: &CellConfig) -> Option<Result<(), BusError>> {
        let now = std::fs::read(self.file.as_ref()?).ok()?;
        if self.seen.as_ref() == Some(&now) {
            return None;
        }
        self.seen = Some(now);
        Some(Bus::check_access(&config.zenoh))
    }
}

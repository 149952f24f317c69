//! Ports of a simulated device: those of the real one plus an offset, or any free ones.

use serde::{Deserialize, Serialize};

/// Which ports the servers of a device take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ports {
    /// The ports of the real device plus this offset: 0 for clients with fixed ports.
    Offset(u16),
    /// Any free ports; the handle of the device returns them.
    Ephemeral,
}

/// The offset leads beyond the last port of one of the cell's servers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("port offset {offset} leads past port 65535; at most 16383 is allowed")]
pub struct PastLastPort {
    /// Offset as configured.
    pub offset: u16,
}

impl Default for Ports {
    fn default() -> Self {
        Self::Offset(0)
    }
}

impl Ports {
    /// Port to bind instead of `port`; `None` if the offset leads beyond the last port.
    pub fn of(self, port: u16) -> Option<u16> {
        match self {
            Self::Offset(offset) => port.checked_add(offset),
            Self::Ephemeral => Some(0),
        }
    }

    /// Port to bind instead of `port`, for a device of the UR cell.
    ///
    /// # Errors
    /// The offset leads beyond the last port.
    pub fn in_cell(self, port: u16) -> Result<u16, PastLastPort> {
        self.of(port).ok_or(PastLastPort {
            offset: self.offset(),
        })
    }

    /// The configured offset; 0 for any free ports.
    pub fn offset(self) -> u16 {
        match self {
            Self::Offset(offset) => offset,
            Self::Ephemeral => 0,
        }
    }
}

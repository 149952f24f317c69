//! Settings of the service.

use std::net::SocketAddr;

use tangent_runtime::CellConfig;

/// Settings of the service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Name that viewers show: the cell's.
    pub name: String,
    /// Address to listen at; port 0 is any free one.
    pub address: SocketAddr,
    /// Key patterns that are forwarded.
    pub include: Vec<String>,
    /// Key patterns that are not, even if `include` matches.
    pub exclude: Vec<String>,
    /// Largest number of messages that wait for this service; beyond, the oldest are dropped.
    pub queue: usize,
    /// Largest number of messages that wait for one viewer; beyond, its oldest are dropped.
    pub viewer_queue: usize,
}

impl Config {
    /// From a cell's `[foxglove]` section.
    pub fn from_cell(cell: &CellConfig) -> Self {
        let section = &cell.foxglove;
        Self {
            name: format!("tangent {}", cell.cell.name),
            address: section.address,
            include: section.include.clone(),
            exclude: section.exclude.clone(),
            queue: section.queue_messages,
            viewer_queue: section.viewer_queue_messages,
        }
    }
}

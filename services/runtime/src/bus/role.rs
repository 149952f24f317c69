//! Role of a session on its network.

/// Role of a session on the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Connects to the cell's router.
    Client,
    /// Is the cell's router: listens, and forwards the messages of all sessions.
    Router,
}

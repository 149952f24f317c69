//! Errors of the bus, with what to do about each.

use std::time::Duration;

/// A router that refuses a certificate says so in its own log only.
fn hint(endpoints: &str) -> &'static str {
    if endpoints.contains("quic/") {
        ". If it runs, it may have rejected this process's certificate, or its own certificate does not name the host in \
         the endpoint: its log shows which"
    } else {
        ""
    }
}

/// Errors of the bus.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// Zenoh or this bus does not accept the key.
    #[error("`{key}` is not a valid key: {reason}")]
    Key {
        /// Key as given.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The key is in use with another message type in this process.
    #[error(
        "`{key}` carries {present} in this process, not {asked}: one topic has one message type"
    )]
    Type {
        /// The key.
        key: String,
        /// Type in use.
        present: &'static str,
        /// Type asked for.
        asked: &'static str,
    },
    /// Another process listens on the router's port.
    #[error(
        "{endpoint} is in use: another process listens there, perhaps another `tangent up` or `tangent run router`. \
         Stop it, or give this cell a free port in cell.toml (zenoh.listen and zenoh.connect)"
    )]
    PortBusy {
        /// The endpoint asked for.
        endpoint: String,
    },
    /// A router would listen beyond this host without certificates, which the file does not allow.
    #[error(
        "zenoh.listen = {endpoint}: reachable from other hosts, without certificates. Any client that reaches it can \
         start tasks and impersonate the sensor. Listen on 127.0.0.1; or make certificates with `tangent keys new` \
         (docs/security.md); or, if only this cell uses the network, set `insecure = true` under [zenoh]"
    )]
    Open {
        /// The first such endpoint.
        endpoint: String,
    },
    /// No router answered at any of the endpoints.
    #[error(
        "no router answered at {endpoints} within {} s: start `tangent up` or `tangent run router`, or correct \
         zenoh.connect in cell.toml{}", .patience.as_secs_f64(), hint(.endpoints)
    )]
    NoRouter {
        /// Endpoints that were tried.
        endpoints: String,
        /// Time waited.
        patience: Duration,
    },
    /// Zenoh refused its configuration.
    #[error("Zenoh rejects {key} = {value}: {reason}")]
    Configuration {
        /// Zenoh's configuration key.
        key: String,
        /// Value that was set.
        value: String,
        /// Zenoh's reason.
        reason: String,
    },
    /// The certificates or access rules cannot be used.
    #[error(transparent)]
    Security(#[from] crate::security::SecurityError),
    /// The service is already running.
    #[error(
        "{service} already runs in cell {cell}: {instance} on host {host}. Stop that one first, or give this cell \
         another name (cell.name in cell.toml)"
    )]
    Taken {
        /// Name of the service.
        service: String,
        /// Name of the cell.
        cell: String,
        /// Instance that is running.
        instance: String,
        /// Host on which it runs.
        host: String,
    },
    /// Any other refusal by Zenoh.
    #[error("{action} failed: {reason}")]
    Zenoh {
        /// What was attempted.
        action: String,
        /// Zenoh's reason.
        reason: String,
    },
    /// No service answered a request.
    #[error(
        "no answer on `{key}` within {:.1} s: the outcome is unknown. Check with `tangent task status` before you send \
         the request again; `tangent status` shows whether the service runs", .waited.as_secs_f64()
    )]
    NoAnswer {
        /// Key of the request.
        key: String,
        /// Time waited; less than the timeout if the bus knows of no service that answers on the
        /// key.
        waited: Duration,
    },
    /// The service does not know the outcome of the request.
    #[error("`{key}`: the outcome is unknown: {reason}")]
    Unknown {
        /// Key of the request.
        key: String,
        /// Reason that the service gave.
        reason: String,
    },
    /// An answer that cannot be decoded.
    #[error("the answer on `{key}` cannot be read: {reason}")]
    BadAnswer {
        /// Key of the request.
        key: String,
        /// What is wrong.
        reason: String,
    },
    /// A stop was requested while waiting.
    #[error("stopped while waiting for the network")]
    Stopped,
}

//! Endpoints of a router on the command line.

use anyhow::{Result, ensure};
use tangent_runtime::config::is_endpoint;

/// Reads an endpoint.
pub fn endpoint(text: &str) -> Result<String> {
    ensure!(
        is_endpoint(text),
        "an endpoint is tcp/HOST:PORT or, with certificates, quic/HOST:PORT, for instance tcp/192.168.1.5:7447"
    );
    Ok(text.to_owned())
}

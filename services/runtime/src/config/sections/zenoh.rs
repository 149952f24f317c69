//! `[zenoh]`: the network.

use std::path::PathBuf;

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[zenoh]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// Routers to dial, tried in turn.
    pub connect: Vec<String>,
    /// Where `up` and `run router` listen.
    pub listen: Vec<String>,
    /// A neighbour that is silent this long is gone, ms.
    pub lease_ms: u32,
    /// Keep-alives per lease.
    pub keep_alive: u8,
    /// A Zenoh file (JSON5) to start from, for TLS and access control.
    pub file: Option<PathBuf>,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            connect: vec!["tcp/127.0.0.1:7447".into()],
            listen: vec!["tcp/127.0.0.1:7447".into()],
            lease_ms: 1000,
            keep_alive: 4,
            file: None,
        }
    }
}

impl ZenohConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, endpoints) in [
            ("zenoh.connect", &self.connect),
            ("zenoh.listen", &self.listen),
        ] {
            let bad = endpoints.iter().find(|endpoint| !is_endpoint(endpoint));
            checker.require(
                bad.is_none() && !endpoints.is_empty(),
                key,
                format!("{endpoints:?}"),
                "a list of endpoints such as \"tcp/127.0.0.1:7447\"",
            )?;
        }
        checker.range(
            "zenoh.lease_ms",
            f64::from(self.lease_ms),
            400.0..=60_000.0,
            "ms (shorter leases expire falsely under load)",
        )?;
        checker.range(
            "zenoh.keep_alive",
            f64::from(self.keep_alive),
            2.0..=10.0,
            "",
        )
    }
}

/// `PROTOCOL/ADDRESS:PORT`, options behind it allowed.
fn is_endpoint(endpoint: &str) -> bool {
    let Some((protocol, address)) = endpoint.split_once('/') else {
        return false;
    };
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let port = address
        .rsplit_once(':')
        .map(|(_, port)| port.parse::<u16>());
    match protocol {
        "tcp" | "tls" => matches!(port, Some(Ok(_))),
        _ => false,
    }
}

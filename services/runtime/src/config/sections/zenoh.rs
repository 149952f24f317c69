//! `[zenoh]`: the network.

use std::path::PathBuf;
use std::time::Duration;

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
    /// A Zenoh file (JSON5) to start from, for what has no key here.
    pub file: Option<PathBuf>,
    /// The router's access rules, as `tangent keys new` writes them.
    pub access: Option<PathBuf>,
    /// Certificates; without them everything travels in the clear and everybody may say anything.
    pub tls: Option<TlsConfig>,
}

/// `[zenoh.tls]`. `{identity}` in a path stands for who the process is, for instance `controller.cell1` or `operator`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// Certificate of the authority that made all others.
    pub ca: PathBuf,
    /// This process's certificate.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// Who this process is; set by the program, not in the file.
    #[serde(skip)]
    pub identity: Option<String>,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            connect: vec!["tcp/127.0.0.1:7447".into()],
            listen: vec!["tcp/127.0.0.1:7447".into()],
            lease_ms: 1000,
            keep_alive: 4,
            file: None,
            access: None,
            tls: None,
        }
    }
}

impl ZenohConfig {
    /// A process that was cut off is known to be gone after this.
    pub fn stale_after(&self) -> Duration {
        Duration::from_millis(u64::from(self.lease_ms) + 500)
    }

    /// Says who this process is, unless that was said before.
    pub fn identify(&mut self, identity: &str) {
        if let Some(tls) = &mut self.tls {
            tls.identity.get_or_insert_with(|| identity.to_owned());
        }
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, endpoints) in [
            ("zenoh.connect", &self.connect),
            ("zenoh.listen", &self.listen),
        ] {
            // Zenoh 1.10 reads and writes one TLS connection from two threads at once (its issue 2557): processes die of it.
            let unsound = endpoints.iter().find(|e| e.starts_with("tls/"));
            checker.require(
                unsound.is_none(),
                key,
                format!("{endpoints:?}"),
                "\"quic/HOST:PORT\" in place of tls/: the same certificates and TLS 1.3, over UDP",
            )?;
            let bad = endpoints.iter().find(|endpoint| !is_endpoint(endpoint));
            checker.require(
                bad.is_none() && !endpoints.is_empty(),
                key,
                format!("{endpoints:?}"),
                "a list of endpoints such as \"tcp/127.0.0.1:7447\"",
            )?;
            // A link in the clear beside those with certificates would let anybody in.
            let clear = endpoints.iter().find(|e| !e.starts_with("quic/"));
            checker.require(
                self.tls.is_none() || clear.is_none(),
                key,
                format!("{endpoints:?}"),
                "with [zenoh.tls] every endpoint is one such as \"quic/router.local:7447\"",
            )?;
            let certified = endpoints.iter().find(|e| e.starts_with("quic/"));
            checker.require(
                certified.is_none() || self.tls.is_some() || self.file.is_some(),
                key,
                format!("{endpoints:?}"),
                "quic/ needs certificates: give [zenoh.tls] ca, certificate and key (`tangent keys new` makes them)",
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
        "tcp" | "quic" => matches!(port, Some(Ok(_))),
        _ => false,
    }
}

//! `[zenoh]`: the network.

use std::net::IpAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[zenoh]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// Endpoints of routers to connect to, tried in turn.
    pub connect: Vec<String>,
    /// Endpoints on which `up` and `run router` listen.
    pub listen: Vec<String>,
    /// Time without messages after which a peer counts as gone, ms.
    pub lease_ms: u32,
    /// Number of keep-alive messages per lease.
    pub keep_alive: u8,
    /// Largest message that any process of the cell accepts, MB.
    pub message_max_mb: f64,
    /// Largest number of sessions that the router accepts at a time.
    pub sessions_max: u16,
    /// Zenoh configuration file (JSON5) to start from, for settings that have no key here.
    pub file: Option<PathBuf>,
    /// Access rules of the router, as `tangent keys new` writes them.
    pub access: Option<PathBuf>,
    /// Whether a router may listen beyond this host without certificates. Anybody who reaches it
    /// may then send anything.
    pub insecure: bool,
    /// Certificates. Without them, messages are not encrypted, and any client may send any message.
    pub tls: Option<TlsConfig>,
}

/// `[zenoh.tls]`. `{identity}` in a path stands for the identity of the process, such as
/// `controller.cell1` or `operator`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// Certificate of the authority that has signed all others.
    pub ca: PathBuf,
    /// This process's certificate.
    pub certificate: PathBuf,
    /// Private key of this process.
    pub key: PathBuf,
    /// Identity of this process; set by the program, not in the file.
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
            message_max_mb: 8.0,
            sessions_max: 128,
            file: None,
            access: None,
            insecure: false,
            tls: None,
        }
    }
}

impl ZenohConfig {
    /// Time after which a process that was cut off is known to be gone.
    pub fn stale_after(&self) -> Duration {
        Duration::from_millis(u64::from(self.lease_ms) + 500)
    }

    /// Sets the identity of this process, unless it is already set.
    pub fn identify(&mut self, identity: &str) {
        if let Some(tls) = &mut self.tls {
            tls.identity.get_or_insert_with(|| identity.to_owned());
        }
    }

    /// The first endpoint on which a router of this file listens beyond this host without
    /// certificates; `None` if there is none.
    pub fn open_to_anybody(&self) -> Option<&str> {
        if self.tls.is_some() {
            return None;
        }
        let beyond = self.listen.iter().find(|endpoint| !is_loopback(endpoint));
        beyond.map(String::as_str)
    }

    /// Largest message that any process of the cell accepts, bytes.
    pub fn message_max_bytes(&self) -> usize {
        (self.message_max_mb * 1e6) as usize
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, endpoints) in [
            ("zenoh.connect", &self.connect),
            ("zenoh.listen", &self.listen),
        ] {
            // Zenoh 1.10 reads and writes one TLS connection from two threads at once (its issue
            // 2557), which crashes processes.
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
            // An unencrypted endpoint beside those with certificates would admit anybody.
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
        )?;
        checker.range(
            "zenoh.message_max_mb",
            self.message_max_mb,
            0.1..=1000.0,
            "MB (a depth image of 848 x 480 in 32FC1 has 1.6)",
        )?;
        checker.range(
            "zenoh.sessions_max",
            f64::from(self.sessions_max),
            8.0..=10_000.0,
            "",
        )
    }
}

/// Whether only processes of this host reach the endpoint. A name other than `localhost` may stand
/// for any address.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, rest)| rest);
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost"
        || host
            .parse::<IpAddr>()
            .is_ok_and(|ip| ip.to_canonical().is_loopback())
}

/// Whether the text is `PROTOCOL/ADDRESS:PORT`, which options may follow, with a protocol that
/// `zenoh.connect` and `zenoh.listen` allow.
pub fn is_endpoint(endpoint: &str) -> bool {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_this_host_is_whatever_is_not_loopback() {
        let listening = |endpoint: &str| ZenohConfig {
            listen: vec!["tcp/127.0.0.1:7447".into(), endpoint.to_owned()],
            ..ZenohConfig::default()
        };
        for near in [
            "tcp/127.0.0.1:7447",
            "tcp/127.8.9.1:7447",
            "tcp/[::1]:7447",
            "tcp/[::ffff:127.0.0.1]:7447",
            "tcp/localhost:7447#so_sndbuf=65000",
        ] {
            assert_eq!(listening(near).open_to_anybody(), None, "{near}");
        }
        for far in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "tcp/192.168.1.5:7447",
            "tcp/cell-pc:7447",
            "tcp/127.0.0.1.example.org:7447",
        ] {
            assert_eq!(listening(far).open_to_anybody(), Some(far));
        }
    }
}

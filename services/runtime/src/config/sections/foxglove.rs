//! `[foxglove]`: the server for live viewers.

use std::net::{Ipv4Addr, SocketAddr};

use serde::Deserialize;

use super::services::RecorderConfig;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[foxglove]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FoxgloveConfig {
    /// Address and port at which viewers connect; port 0 is any free one.
    pub address: SocketAddr,
    /// Listen beyond this host. Anyone who reaches the address may then read the cell's topics.
    pub insecure: bool,
    /// Key patterns to forward.
    pub include: Vec<String>,
    /// Key patterns not to forward, even if `include` matches.
    pub exclude: Vec<String>,
    /// Number of messages that may wait for the service before the oldest is dropped and counted.
    pub queue_messages: usize,
    /// Number of messages that may wait for one viewer before its oldest is dropped.
    pub viewer_queue_messages: usize,
}

impl Default for FoxgloveConfig {
    fn default() -> Self {
        // What is recorded is shown.
        let RecorderConfig {
            include, exclude, ..
        } = RecorderConfig::default();
        Self {
            address: (Ipv4Addr::LOCALHOST, 8765).into(),
            insecure: false,
            include,
            exclude,
            queue_messages: 8192,
            viewer_queue_messages: 1024,
        }
    }
}

impl FoxgloveConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.require(
            self.address.ip().is_loopback() || self.insecure,
            "foxglove.address",
            self.address,
            "an address of this host alone, such as 127.0.0.1:8765: the server has no certificates. With \
             foxglove.insecure = true it listens for anyone",
        )?;
        checker.require(
            !self.include.is_empty(),
            "foxglove.include",
            "[]",
            "at least one key pattern; [\"**\"] forwards all topics",
        )?;
        for (key, value) in [
            ("foxglove.queue_messages", self.queue_messages),
            ("foxglove.viewer_queue_messages", self.viewer_queue_messages),
        ] {
            checker.range(key, value as f64, 16.0..=1e6, "messages")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CellConfig;

    fn cell(section: &str) -> Result<FoxgloveConfig, ConfigError> {
        let changed = CellConfig::default_cell().changed("the test's cell", |table| {
            let section: toml::Table = section.parse().unwrap();
            table.insert("foxglove".to_owned(), section.into());
        });
        Ok(changed?.foxglove)
    }

    #[test]
    fn viewers_on_other_hosts_need_a_word_from_the_user() {
        assert_eq!(cell("").unwrap(), FoxgloveConfig::default());
        assert!(FoxgloveConfig::default().address.ip().is_loopback());
        let open = "address = '0.0.0.0:8765'";
        let said = cell(open).unwrap_err().to_string();
        for word in ["foxglove.address", "0.0.0.0:8765", "insecure = true"] {
            assert!(said.contains(word), "{said}");
        }
        assert!(cell(&format!("{open}\ninsecure = true")).is_ok());
        assert!(cell("address = '[::1]:9000'").is_ok());
    }

    #[test]
    fn what_is_refused_is_named() {
        for (section, word) in [
            ("include = []", "foxglove.include"),
            ("queue_messages = 3", "foxglove.queue_messages"),
            (
                "viewer_queue_messages = 10000000",
                "foxglove.viewer_queue_messages",
            ),
            ("adress = '127.0.0.1:1'", "address"),
            ("address = 'nowhere'", "address"),
        ] {
            let said = cell(section).unwrap_err().to_string();
            assert!(said.contains(word), "{section}: {said}");
        }
    }
}

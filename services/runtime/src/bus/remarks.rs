//! Remarks about a session: logged at its start, and part of its services' health as long as they
//! apply.

use super::error::BusError;
use super::role::Role;
use crate::clock;
use crate::config::ZenohConfig;
use crate::security::Expiry;

/// Reasons for remarks.
#[derive(Debug, Default)]
pub(crate) struct Remarks {
    /// A router that listens beyond this host without certificates.
    open: Option<String>,
    /// Expiry of the certificates.
    expiry: Option<Expiry>,
}

/// The first endpoint on which a router would listen beyond this host without certificates, where
/// the file allows it.
///
/// # Errors
/// [`BusError::Open`]: the file does not allow it.
pub(super) fn open_listener(config: &ZenohConfig) -> Result<Option<&str>, BusError> {
    match config.open_to_anybody() {
        Some(endpoint) if !config.insecure => Err(BusError::Open {
            endpoint: endpoint.to_owned(),
        }),
        open => Ok(open),
    }
}

impl Remarks {
    /// Remarks on a session that is about to be opened.
    ///
    /// # Errors
    /// A router would listen beyond this host without encryption, and the file does not allow it;
    /// or a certificate cannot be read.
    pub(crate) fn on(config: &ZenohConfig, role: Role) -> Result<Self, BusError> {
        let endpoint = match role {
            Role::Router => open_listener(config)?,
            Role::Client => None,
        };
        let open = endpoint.map(|endpoint| {
            format!(
                "insecure: the router listens on {endpoint} without certificates; any client that reaches it can start \
                 tasks and impersonate the sensor (zenoh.insecure = true)"
            )
        });
        let expiry = match &config.tls {
            Some(tls) => Some(Expiry::of(tls)?),
            None => None,
        };
        Ok(Self { open, expiry })
    }

    /// Logs the remarks at the start.
    pub(crate) fn log(&self) {
        for words in self.now() {
            tracing::warn!("{words}");
        }
    }

    /// The remarks that apply now.
    pub(crate) fn now(&self) -> Vec<String> {
        let now_s = clock::now_ns() / 1_000_000_000;
        let expiry = self.expiry.as_ref().and_then(|e| e.remark(now_s));
        self.open.iter().cloned().chain(expiry).collect()
    }
}

//! What is said of a session at its start and in the health of its services for as long as it
//! holds.

use super::Role;
use super::error::BusError;
use crate::clock;
use crate::config::ZenohConfig;
use crate::security::Expiry;

/// What there is to say.
#[derive(Debug, Default)]
pub(crate) struct Remarks {
    /// A router that listens beyond this host without certificates.
    open: Option<String>,
    /// When the certificates end.
    expiry: Option<Expiry>,
}

impl Remarks {
    /// On a session that is about to be opened.
    ///
    /// # Errors
    /// A router that would listen beyond this host in the clear, where the file does not say that
    /// it may; a certificate that cannot be read.
    pub(crate) fn on(config: &ZenohConfig, role: Role) -> Result<Self, BusError> {
        let endpoint = match role {
            Role::Router => config.open_to_anybody(),
            Role::Client => None,
        };
        let open = match endpoint {
            Some(endpoint) if !config.insecure => {
                return Err(BusError::Open {
                    endpoint: endpoint.to_owned(),
                });
            }
            Some(endpoint) => Some(format!(
                "insecure: the router listens on {endpoint} without certificates; whoever reaches it may start tasks and \
                 speak as the sensor (zenoh.insecure = true)"
            )),
            None => None,
        };
        let expiry = match &config.tls {
            Some(tls) => Some(Expiry::of(tls)?),
            None => None,
        };
        Ok(Self { open, expiry })
    }

    /// At the start.
    pub(crate) fn log(&self) {
        for words in self.now() {
            tracing::warn!("{words}");
        }
    }

    /// As it stands now.
    pub(crate) fn now(&self) -> Vec<String> {
        let now_s = clock::now_ns() / 1_000_000_000;
        let expiry = self.expiry.as_ref().and_then(|e| e.remark(now_s));
        self.open.iter().cloned().chain(expiry).collect()
    }
}

//! `[ui]`: the operator's page.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use serde::Deserialize;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Reaction to the loss of every page that may command the cell, while a task runs that was started
/// or resumed from a page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OnLostPage {
    /// The task continues.
    #[default]
    Nothing,
    /// The task is paused: the arm then moves only to keep the force.
    Pause,
    /// The task is stopped: the tool retracts.
    Stop,
}

/// `[ui]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UiConfig {
    /// Address and port at which browsers connect; port 0 is any free one.
    pub address: SocketAddr,
    /// Listen beyond this host. The page is not encrypted, and neither are its tokens.
    pub insecure: bool,
    /// Names of this host that a browser may use, besides IP addresses and `localhost`.
    pub hosts: Vec<String>,
    /// File with the tokens of the people who may command the cell; relative to this file's folder.
    pub tokens: Option<PathBuf>,
    /// Folder with the task files that are offered; relative to this file's folder.
    pub tasks: PathBuf,
    /// Reaction to the loss of the page.
    pub on_lost_page: OnLostPage,
    /// Time without a sign of life after which a page counts as lost, s.
    pub lost_page_after_s: f64,
    /// Wanted pressure dose on the surface, least and most, N*s/cm²; `None`: half and twice the
    /// median of the present task.
    pub dose_band_n_s_per_cm2: Option<[f64; 2]>,
}

impl Default for UiConfig {
    fn default() -> Self {
        Self {
            address: (Ipv4Addr::LOCALHOST, 8780).into(),
            insecure: false,
            hosts: Vec::new(),
            tokens: None,
            tasks: "tasks".into(),
            on_lost_page: OnLostPage::Nothing,
            lost_page_after_s: 3.0,
            dose_band_n_s_per_cm2: None,
        }
    }
}

impl UiConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        self.check_address(checker)?;
        let bad = self.hosts.iter().find(|name| {
            name.is_empty()
                || !name
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '.'))
        });
        checker.require(
            bad.is_none(),
            "ui.hosts",
            format!("{:?}", self.hosts),
            "names of this host without scheme and port, such as \"robot.local\"",
        )?;
        checker.range(
            "ui.lost_page_after_s",
            self.lost_page_after_s,
            1.5..=600.0,
            "s",
        )?;
        if let Some([least, most]) = self.dose_band_n_s_per_cm2 {
            checker.require(
                least > 0.0 && least < most && most <= 1e6,
                "ui.dose_band_n_s_per_cm2",
                format!("[{least}, {most}]"),
                "[LEAST, MOST] with 0 < LEAST < MOST, at most 1e6 N*s/cm²",
            )?;
        }
        Ok(())
    }

    /// Whether the page may be served at its address: also for an address of the command line.
    ///
    /// # Errors
    /// What is missing, in words that complete "is not allowed: ".
    pub fn may_listen(&self) -> Result<(), &'static str> {
        if self.address.ip().is_loopback() {
            Ok(())
        } else if self.tokens.is_none() {
            Err(
                "an address of this host alone, such as 127.0.0.1:8780: there are no tokens, so anyone who reaches the page \
                 could command the arm. Make one with `tangent ui --new-token NAME`, and name its file as ui.tokens",
            )
        } else if !self.insecure {
            Err(
                "an address of this host alone, such as 127.0.0.1:8780: the page is not encrypted, so its tokens can be read \
                 on the way. Use a tunnel; or, if only this cell uses the network, set ui.insecure = true",
            )
        } else {
            Ok(())
        }
    }

    fn check_address(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        self.may_listen()
            .map_err(|allowed| checker.refuse("ui.address", self.address, allowed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::testing::cell;

    #[test]
    fn the_page_is_for_this_host_unless_there_are_tokens_and_a_word_from_the_user() {
        assert_eq!(cell("").unwrap().ui, UiConfig::default());
        assert!(UiConfig::default().address.ip().is_loopback());
        let open = "[ui]\naddress = '0.0.0.0:8780'";
        let said = cell(open).unwrap_err();
        for word in ["ui.address", "0.0.0.0:8780", "--new-token", "ui.tokens"] {
            assert!(said.contains(word), "{said}");
        }
        let said = cell(&format!("{open}\ntokens = 'tokens.toml'")).unwrap_err();
        assert!(said.contains("ui.insecure = true"), "{said}");
        let said = cell(&format!("{open}\ninsecure = true")).unwrap_err();
        assert!(said.contains("ui.tokens"), "{said}");
        cell(&format!("{open}\ninsecure = true\ntokens = 'tokens.toml'")).unwrap();
        cell("[ui]\naddress = '[::1]:9000'\non_lost_page = 'pause'").unwrap();
    }

    #[test]
    fn what_is_refused_is_named() {
        for (section, word) in [
            ("hosts = ['http://robot']", "ui.hosts"),
            ("on_lost_page = 'panic'", "on_lost_page"),
            ("lost_page_after_s = 0.1", "ui.lost_page_after_s"),
            (
                "dose_band_n_s_per_cm2 = [2.0, 1.0]",
                "ui.dose_band_n_s_per_cm2",
            ),
            (
                "dose_band_n_s_per_cm2 = [nan, 1.0]",
                "ui.dose_band_n_s_per_cm2",
            ),
            ("port = 80", "port"),
        ] {
            let said = cell(&format!("[ui]\n{section}")).unwrap_err();
            assert!(said.contains(word), "{section}: {said}");
        }
    }
}

//! `[estimators]`, `[controller]`, `[recorder]` and `[simulator]`: the settings of single services.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use serde::Deserialize;

use super::cell::is_cell_name;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Selects the wrench that the normal estimators use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WrenchSource {
    /// The measured one, `wrench/tool`.
    #[default]
    Measured,
    /// The one in `control/state`, from which the law has removed joint friction and zero. For arms
    /// that only estimate the wrench.
    Law,
}

/// `[estimators]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorsConfig {
    /// Estimators that this cell's estimator service runs, each on its own topic.
    pub run: Vec<String>,
    /// The estimator that the controller uses first.
    pub active: String,
    /// The wrench that the normal estimators use.
    pub wrench: WrenchSource,
    /// Settings of each estimator; see that estimator's documentation for the keys.
    pub settings: BTreeMap<String, toml::Table>,
}

impl Default for EstimatorsConfig {
    fn default() -> Self {
        Self {
            run: vec!["blend".into()],
            active: "blend".into(),
            wrench: WrenchSource::default(),
            settings: BTreeMap::new(),
        }
    }
}

impl EstimatorsConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        for name in self.run.iter().chain([&self.active]) {
            checker.require(
                (1..=64).contains(&name.len()) && name.chars().all(good),
                "estimators.run",
                name,
                "names of lower-case letters, digits and `_`",
            )?;
        }
        Ok(())
    }
}

/// Which control law runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// Commands joint velocities; uses estimated normals.
    #[default]
    HybridAdmittance,
    /// Commands joint torques; uses the estimated pose of an object of known shape.
    HybridDynamics,
    /// Commands joint torques of a seven-joint arm; uses estimated normals, and is passive by
    /// energy tanks.
    UnifiedForceImpedance,
}

impl std::fmt::Display for Law {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::HybridAdmittance => "hybrid_admittance",
            Self::HybridDynamics => "hybrid_dynamics",
            Self::UnifiedForceImpedance => "unified_force_impedance",
        })
    }
}

/// `[controller]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// The law: `hybrid_admittance` for arms that accept velocities, the two others for arms that
    /// accept torques.
    pub law: Law,
    /// Set of gains: `default` or `paper`.
    pub preset: String,
    /// Gains that differ from the preset, as the controller documents them.
    pub settings: toml::Table,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            law: Law::default(),
            preset: "default".into(),
            settings: toml::Table::new(),
        }
    }
}

/// `[recorder]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecorderConfig {
    /// Folder of the recordings, created if missing; relative to the working directory.
    pub folder: PathBuf,
    /// Key patterns to record.
    pub include: Vec<String>,
    /// Key patterns not to record, even if `include` matches. The camera's raw images take much
    /// space; the results of their detection do not.
    pub exclude: Vec<String>,
    /// Cells to record through one router; empty: this cell.
    pub cells: Vec<String>,
    /// Size at which a new file begins, MB.
    pub rotate_mb: f64,
    /// Time after which a new file begins, s.
    pub rotate_s: f64,
    /// Limit on the total size of all recordings in the folder, with copies of damaged files,
    /// bytes. Beyond it, the oldest are deleted; 0: no limit.
    pub keep_bytes: u64,
    /// Age since the last write at which a recording is deleted, days; 0: never.
    pub keep_days: f64,
    /// Whether to compress chunks with zstd.
    pub compress: bool,
    /// Whether to pack wrenches on `wrench/raw` into arrays, with hundreds in one message.
    pub pack: bool,
    /// Number of messages that may wait for the disk before the oldest is dropped and counted.
    pub queue_messages: usize,
}

impl Default for RecorderConfig {
    fn default() -> Self {
        Self {
            folder: "recordings".into(),
            include: vec!["**".into()],
            exclude: vec!["simulator/image".into(), "camera/depth".into()],
            cells: Vec::new(),
            rotate_mb: 1024.0,
            rotate_s: 3600.0,
            keep_bytes: 0,
            keep_days: 0.0,
            compress: true,
            pack: true,
            queue_messages: 65_536,
        }
    }
}

impl RecorderConfig {
    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.range("recorder.rotate_mb", self.rotate_mb, 0.1..=1e6, "MB")?;
        checker.range("recorder.rotate_s", self.rotate_s, 1.0..=1e6, "s")?;
        // The file being written is never deleted, and may grow to `rotate_mb`.
        checker.require(
            self.keep_bytes == 0 || self.keep_bytes as f64 >= 2e6 * self.rotate_mb,
            "recorder.keep_bytes",
            self.keep_bytes.to_string(),
            "0 (nothing is deleted), or at least twice recorder.rotate_mb in bytes",
        )?;
        checker.range("recorder.keep_days", self.keep_days, 0.0..=1e5, "days")?;
        let bad = self.cells.iter().find(|name| !is_cell_name(name));
        checker.require(
            bad.is_none(),
            "recorder.cells",
            format!("{:?}", self.cells),
            "names of cells, as in their cell.name",
        )?;
        checker.range(
            "recorder.queue_messages",
            self.queue_messages as f64,
            100.0..=1e7,
            "messages",
        )
    }
}

/// `[simulator]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatorConfig {
    /// Address of this host at which the simulated robot and sensor listen; 0.0.0.0: all addresses.
    pub address: IpAddr,
    /// Scenario file: surface, contact, sensor noise. `None`: the built-in pipe.
    pub scenario: Option<PathBuf>,
    /// Seed of all randomness; `None`: the scenario's.
    pub seed: Option<u64>,
}

impl Default for SimulatorConfig {
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            scenario: None,
            seed: None,
        }
    }
}

//! `[estimators]`, `[controller]`, `[recorder]` and `[simulator]`: the settings of single services.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use serde::Deserialize;

use super::cell::is_cell_name;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Which wrench estimators of normals go by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WrenchSource {
    /// `wrench/tool`, as measured.
    #[default]
    Measured,
    /// The one in `control/state`: for arms that only estimate it, a law takes the joints' friction
    /// and the zero out of it.
    Law,
}

/// `[estimators]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorsConfig {
    /// Those that this cell's estimator service runs, each on its own topic.
    pub run: Vec<String>,
    /// The one that the controller starts with.
    pub active: String,
    /// Which wrench estimators of normals go by.
    pub wrench: WrenchSource,
    /// Settings per estimator, as that estimator documents them.
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
    /// Joint velocities, on estimated normals.
    #[default]
    HybridAdmittance,
    /// Joint torques, on the estimated pose of an object of known shape.
    HybridDynamics,
    /// Joint torques of a seven-joint arm, on estimated normals, passive by energy tanks.
    UnifiedForceImpedance,
}

/// `[controller]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// `hybrid_admittance` for arms that take velocities, `hybrid_dynamics` for those that take
    /// torques.
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
    /// Folder of the recordings, made when missing; from the working directory.
    pub folder: PathBuf,
    /// Key patterns to record.
    pub include: Vec<String>,
    /// Key patterns not to record, whatever `include` says: the camera's raw images are many, what
    /// was found in them is not.
    pub exclude: Vec<String>,
    /// Cells to record through one router; none: this cell.
    pub cells: Vec<String>,
    /// A new file after so many megabytes.
    pub rotate_mb: f64,
    /// A new file after so many seconds.
    pub rotate_s: f64,
    /// All recordings of the folder together, torn copies counted, bytes: with more, the oldest are
    /// deleted; 0: never.
    pub keep_bytes: u64,
    /// Recordings that were last written so many days ago are deleted; 0: never.
    pub keep_days: f64,
    /// Chunks are compressed with zstd.
    pub compress: bool,
    /// Wrenches on `wrench/raw` are kept in arrays, hundreds in a message.
    pub pack: bool,
    /// Messages that wait for the disk before the oldest is dropped and counted.
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
        // The file being written is never deleted, and it may grow to rotate_mb.
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
    /// Where the simulated robot and sensor listen: an address of this host; 0.0.0.0 for all of
    /// them.
    pub address: IpAddr,
    /// Scenario file: surface, contact, sensor noise. Without one: the built-in pipe.
    pub scenario: Option<PathBuf>,
    /// Seed of all randomness; without one the scenario's.
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

//! `cell.toml`: everything about one cell that is not the task. Every key is checked when it is
//! loaded, and an error names file, key, value and what is allowed.

mod check;
mod load;
mod sections;
#[cfg(test)]
mod testing;

use std::path::{Path, PathBuf};

use serde::Deserialize;
use tangent_sensing::BaseConfig;

pub use check::Checker;
pub use load::{ConfigError, read_toml, toml_from_str};
pub use sections::{
    Calibration, CameraConfig, CameraKind, CellSection, ControllerConfig, EstimatorsConfig,
    FRANKA_TORQUE_RATE_SHARE, Focal, FoxgloveConfig, FrankaConfig, JointCountError, Law,
    LimitsConfig, OnLostPage, PoseConfig, RealtimeConfig, RecorderConfig, RobotConfig, RobotDriver,
    RobotModelError, Ros2Command, Ros2Config, Ros2Inputs, SensorConfig, SensorDriver, SensorMode,
    SimulatorConfig, TipConfig, TipKind, TlsConfig, ToolConfig, TopicSensorConfig, UiConfig,
    UrReading, UrSensorConfig, WrenchSource, ZenohConfig, is_endpoint, is_ros_name,
};

/// The cell file supplied with the program: a simulated UR5 with a Gamma sensor on loopback.
pub const DEFAULT_CELL: &str = include_str!("../../../../deploy/cell.toml");

/// Configuration of one cell.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellConfig {
    /// Name and state folder.
    pub cell: CellSection,
    /// The arm and its address.
    pub robot: RobotConfig,
    /// The force/torque sensor.
    pub sensor: SensorConfig,
    /// The tool, mounted behind the sensor.
    pub tool: ToolConfig,
    /// The camera on the wrist, if there is one.
    #[serde(default)]
    pub camera: Option<CameraConfig>,
    /// Checks on the pose of a moving base. Whether the base moves follows from `base/pose`.
    #[serde(default)]
    pub base: BaseConfig,
    /// Limits that the arm must never exceed.
    #[serde(default)]
    pub limits: LimitsConfig,
    /// The network.
    #[serde(default)]
    pub zenoh: ZenohConfig,
    /// The normal estimators that run, and the one that is used first.
    #[serde(default)]
    pub estimators: EstimatorsConfig,
    /// The control law, its preset and its gains.
    #[serde(default)]
    pub controller: ControllerConfig,
    /// Recordings.
    #[serde(default)]
    pub recorder: RecorderConfig,
    /// What ROS 2 sees of the cell, and what it may send.
    #[serde(default)]
    pub ros2: Ros2Config,
    /// The server for live viewers.
    #[serde(default)]
    pub foxglove: FoxgloveConfig,
    /// The operator's page.
    #[serde(default)]
    pub ui: UiConfig,
    /// The simulated cell.
    #[serde(default)]
    pub simulator: SimulatorConfig,
    /// Scheduling.
    #[serde(default)]
    pub realtime: RealtimeConfig,
    /// Text that the configuration was read from.
    #[serde(skip)]
    text: String,
    /// Folder that relative paths start from.
    #[serde(skip)]
    folder: PathBuf,
}

impl CellConfig {
    /// Reads and checks a file. Relative paths in it are taken from the file's folder.
    ///
    /// # Errors
    /// [`ConfigError`], naming file, key, value and what is allowed.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Read {
            file: path.display().to_string(),
            reason: error.to_string(),
        })?;
        let mut config = Self::parse(&path.display().to_string(), &text)?;
        config.folder = path.parent().unwrap_or(Path::new("")).to_owned();
        config.resolve_paths();
        if config.cell.state_folder.is_none() {
            let state = std::env::var_os("STATE_DIRECTORY")
                .map_or_else(|| config.folder.join("state"), PathBuf::from);
            config.cell.state_folder = Some(state.join(&config.cell.name));
        }
        Ok(config)
    }

    /// Reads and checks a text; errors refer to it as `file`.
    ///
    /// # Errors
    /// [`ConfigError`], naming file, key, value and what is allowed.
    pub fn parse(file: &str, text: &str) -> Result<Self, ConfigError> {
        let mut config: Self = toml_from_str(file, text)?;
        let checker = Checker::new(file, text);
        config.check(&checker)?;
        config.text = text.to_owned();
        Ok(config)
    }

    /// Text that the cell was read from, for recordings. Later changes are not in it.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The cell supplied with the program ([`DEFAULT_CELL`]). Its relative paths stay relative to
    /// the working directory.
    pub fn default_cell() -> Self {
        Self::parse("the built-in cell.toml", DEFAULT_CELL)
            .expect("the cell file that ships is loaded by a test")
    }

    /// This cell with other values in its file, checked like a file. [`CellConfig::text`] is then
    /// the changed text, so that a recording holds the cell that ran. `title` becomes the first
    /// line of the text, and errors refer to the text by it.
    ///
    /// # Errors
    /// [`ConfigError`], naming key, value and what is allowed.
    pub fn changed(
        &self,
        title: &str,
        change: impl FnOnce(&mut toml::Table),
    ) -> Result<Self, ConfigError> {
        let mut table: toml::Table = toml_from_str(title, &self.text)?;
        change(&mut table);
        let mut config = Self::parse(title, &format!("# {title}\n{table}"))?;
        config.folder.clone_from(&self.folder);
        config.resolve_paths();
        let identity = self
            .zenoh
            .tls
            .as_ref()
            .and_then(|tls| tls.identity.as_ref());
        if let Some(identity) = identity {
            config.zenoh.identify(identity);
        }
        Ok(config)
    }

    fn resolve_paths(&mut self) {
        let folder = self.folder.clone();
        let resolve = |path: &mut PathBuf| {
            if path.is_relative() {
                *path = folder.join(&*path);
            }
        };
        self.cell.state_folder.iter_mut().for_each(resolve);
        self.robot.model_file.iter_mut().for_each(resolve);
        self.robot.calibration_file.iter_mut().for_each(resolve);
        self.zenoh.file.iter_mut().for_each(resolve);
        self.zenoh.access.iter_mut().for_each(resolve);
        if let Some(tls) = &mut self.zenoh.tls {
            [&mut tls.ca, &mut tls.certificate, &mut tls.key]
                .into_iter()
                .for_each(resolve);
        }
        self.simulator.scenario.iter_mut().for_each(resolve);
        self.ui.tokens.iter_mut().for_each(resolve);
        resolve(&mut self.ui.tasks);
        if let Some(camera) = &mut self.camera {
            camera.recording.iter_mut().for_each(resolve);
        }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        self.cell.check(checker)?;
        self.robot.check(checker)?;
        self.sensor.check(checker, &self.robot)?;
        self.tool.check(checker)?;
        if let Some(camera) = &self.camera {
            camera.check(checker)?;
        }
        self.base
            .check()
            .map_err(|wrong| checker.refuse(wrong.key, wrong.value, wrong.allowed.clone()))?;
        self.limits.check(checker)?;
        self.zenoh.check(checker)?;
        self.estimators.check(checker)?;
        self.recorder.check(checker)?;
        self.ros2.check(checker, self)?;
        self.foxglove.check(checker)?;
        self.ui.check(checker)?;
        self.realtime.check(checker)
    }
}

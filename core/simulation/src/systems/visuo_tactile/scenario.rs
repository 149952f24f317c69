//! A scenario of the `visuo_tactile` system: a torque-controlled arm that estimates contact from
//! its joint torques, and a camera. Its files are of kind `visuo_tactile`.

use serde::{Deserialize, Serialize};
use tangent_control::{Limits, Presets, Task, UnifiedForceImpedance, UnifiedForceImpedanceConfig};
use tangent_estimation::{EstimatorConfig, NormalEstimator, build};
use toml::Table;

use super::plant_config::VisuoTactilePlantConfig;
use crate::scenario_file::{ScenarioError, VISUO_TACTILE, read_with_overrides};

/// The scenario. Unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisuoTactileScenario {
    /// Name in `tangent evaluate` and in reports.
    pub name: String,
    /// One sentence on what the scenario shows.
    #[serde(default)]
    pub title: String,
    /// Seed of all random numbers: start pose, noise, the camera's mounting.
    pub seed: u64,
    /// Longest duration of a run, s; the run ends earlier if the task does.
    pub duration_s: f64,
    /// Preset of the law, `default` or `paper`.
    pub controller: String,
    /// Parameters of the law that differ from the preset.
    #[serde(default)]
    pub control: Table,
    /// Limits of the cell.
    #[serde(default)]
    pub limits: Limits,
    /// Settings of the estimator of the normal from contact.
    #[serde(default)]
    pub estimation: EstimatorConfig,
    /// The simulated cell.
    pub plant: VisuoTactilePlantConfig,
    /// Task to run. Its first estimator estimates the normal from contact.
    pub task: Task,
}

impl VisuoTactileScenario {
    /// Reads a scenario. `file` is its name for messages; `overrides` are `key=value` with dotted
    /// keys.
    ///
    /// # Errors
    /// The error names the file or override, the key, the value and what is allowed.
    pub fn parse(file: &str, text: &str, overrides: &[String]) -> Result<Self, ScenarioError> {
        let scenario: Self = read_with_overrides(file, VISUO_TACTILE, text, overrides)?;
        ScenarioError::unless_duration(file, scenario.duration_s)?;
        scenario.task.check()?;
        scenario.limits.check()?;
        scenario.law()?;
        scenario.touch()?;
        Ok(scenario)
    }

    /// The preset with the scenario's own parameters applied.
    ///
    /// # Errors
    /// An unknown preset or parameter, or a value out of range.
    pub fn law(&self) -> Result<UnifiedForceImpedanceConfig, ScenarioError> {
        UnifiedForceImpedanceConfig::preset_with(&self.controller, &self.control)
            .map_err(|error| ScenarioError::of_settings(&self.name, error))
    }

    /// The law for the cell as its file states it.
    ///
    /// # Errors
    /// A parameter, limit or task is out of its range.
    pub fn controller<const N: usize>(&self) -> Result<UnifiedForceImpedance<N>, ScenarioError> {
        let stated = self.plant.stated::<N>()?;
        Ok(UnifiedForceImpedance::new(
            stated.arm,
            stated.flange_from_tool,
            self.limits,
            &self.law()?,
            &self.task,
            stated.interface,
        )?)
    }

    /// Estimator of the normal from contact.
    ///
    /// # Errors
    /// The estimator is unknown, or a setting is out of its range.
    pub fn touch(&self) -> Result<Box<dyn NormalEstimator>, ScenarioError> {
        let name = self
            .task
            .estimators
            .first()
            .map_or("reactive", String::as_str);
        Ok(build(name, &self.estimation)?)
    }
}

//! A scenario of the `karacan` system: a torque-controlled arm that feels through its joints, and a
//! camera. Files of kind `visuo_tactile`.

use serde::{Deserialize, Serialize};
use tangent_control::{
    Limits, Task, TorqueInterface, UnifiedForceImpedance, UnifiedForceImpedanceConfig,
};
use tangent_estimation::{EstimatorConfig, NormalEstimator, build};
use toml::Table;

use crate::scenario::{ScenarioError, check_duration, is_of_kind, read_with_overrides};
use crate::tactile_plant::TactilePlant;
use crate::tactile_plant_config::TactilePlantConfig;

/// Marks the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TactileKind {
    /// An unknown surface, explored by eye and touch.
    VisuoTactile,
}

/// What is evaluated. Unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TactileScenario {
    /// `visuo_tactile`.
    pub kind: TactileKind,
    /// As `tangent evaluate` and reports call it.
    pub name: String,
    /// One sentence on what it shows.
    #[serde(default)]
    pub title: String,
    /// Seed of everything random: start, noise, the camera's mounting.
    pub seed: u64,
    /// Longest run, s; it ends earlier when the task does.
    pub duration_s: f64,
    /// Preset of the law, `default` or `paper`.
    pub controller: String,
    /// Single parameters of the law that differ from the preset.
    #[serde(default)]
    pub control: Table,
    /// Limits of the cell.
    #[serde(default)]
    pub limits: Limits,
    /// Settings of the estimator that turns touch into a normal.
    #[serde(default)]
    pub estimation: EstimatorConfig,
    /// The simulated cell.
    pub plant: TactilePlantConfig,
    /// The job. Its first estimator is what turns touch into a normal.
    pub task: Task,
}

impl TactileScenario {
    /// Whether a text is a scenario of this kind.
    pub fn is_one(text: &str) -> bool {
        is_of_kind(text, "visuo_tactile")
    }

    /// Reads a scenario. `file` is its name for messages; `overrides` are `key=value` with dotted
    /// keys.
    ///
    /// # Errors
    /// Names the file or override, the key, the value and what is allowed.
    pub fn parse(file: &str, text: &str, overrides: &[String]) -> Result<Self, ScenarioError> {
        let scenario: Self = read_with_overrides(file, text, overrides)?;
        check_duration(file, scenario.duration_s)?;
        scenario.task.check()?;
        scenario.limits.check()?;
        scenario.law()?;
        scenario.touch()?;
        Ok(scenario)
    }

    /// The preset with the scenario's own parameters in it.
    ///
    /// # Errors
    /// An unknown preset or parameter, or a value out of range.
    pub fn law(&self) -> Result<UnifiedForceImpedanceConfig, ScenarioError> {
        Ok(UnifiedForceImpedanceConfig::preset_with(
            &self.controller,
            &self.control,
        )?)
    }

    /// The law for the plant's arm as the cell file states it.
    ///
    /// # Errors
    /// A parameter, limit or task out of its range.
    pub fn controller(&self, plant: &TactilePlant) -> Result<UnifiedForceImpedance, ScenarioError> {
        Ok(UnifiedForceImpedance::new(
            plant.stated_model()?,
            plant.flange_from_tool(),
            self.limits,
            &self.law()?,
            &self.task,
            TorqueInterface {
                delay_periods: self.plant.arm.delay_periods,
                ..TorqueInterface::default()
            },
        )?)
    }

    /// What turns touch into a normal.
    ///
    /// # Errors
    /// An unknown estimator, or a setting out of its range.
    pub fn touch(&self) -> Result<Box<dyn NormalEstimator>, ScenarioError> {
        let name = self
            .task
            .estimators
            .first()
            .map_or("reactive", String::as_str);
        Ok(build(name, &self.estimation)?)
    }
}

//! A scenario of the `admittance` system: a velocity-controlled arm with a force sensor, on a
//! surface of unknown shape. Its files have no `kind`.

use serde::{Deserialize, Serialize};
use tangent_control::{ControllerConfig, Limits, Presets, Task};
use tangent_estimation::EstimatorConfig;
use tangent_sensing::{BaseConfig, ConditioningConfig};
use toml::Table;

use super::plant_config::AdmittancePlantConfig;
use crate::scenario_file::{ADMITTANCE, ReadFile, ScenarioError, read_with_overrides};
use crate::surfaces::ShapeConfig;

/// The scenario. Unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdmittanceScenario {
    /// Name in `tangent evaluate` and in reports.
    pub name: String,
    /// One sentence on what the scenario shows.
    #[serde(default)]
    pub title: String,
    /// Seed of all random numbers.
    #[serde(default = "one")]
    pub seed: u64,
    /// Longest duration of a run, s; the run ends earlier if the task does.
    pub duration_s: f64,
    /// Preset of the control law, unless the task names one.
    #[serde(default = "default_preset")]
    pub controller: String,
    /// Parameters of the law that differ from the preset.
    #[serde(default)]
    pub control: Table,
    /// Limits of the cell.
    #[serde(default)]
    pub limits: Limits,
    /// Settings of the estimators.
    #[serde(default)]
    pub estimation: EstimatorConfig,
    /// Wrench conditioning.
    #[serde(default)]
    pub sensing: ConditioningConfig,
    /// Checks of the pose of a moving base.
    #[serde(default)]
    pub base: BaseConfig,
    /// Delays of the pipeline between plant and controller.
    #[serde(default)]
    pub pipeline: PipelineConfig,
    /// The simulated cell.
    pub plant: AdmittancePlantConfig,
    /// Task to run.
    pub task: Task,
}

/// Delays of the live pipeline, in arm periods.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// Periods from the arm's packet to the start of the period in which the command takes effect:
    /// the robot program reads its registers once per period.
    pub exchange_cycles: usize,
    /// Age of an estimate when the controller uses it, in periods: an estimator in another process
    /// delivers it in the next cycle.
    pub estimate_cycles: usize,
}

impl Default for PipelineConfig {
    fn default() -> Self {
        Self {
            exchange_cycles: 1,
            estimate_cycles: 1,
        }
    }
}

/// Longest pipeline delay, cycles.
pub const PIPELINE_CYCLES_MAX: usize = 16;

fn one() -> u64 {
    1
}

fn default_preset() -> String {
    "default".to_owned()
}

impl AdmittanceScenario {
    /// Reads a scenario. `file` is its name for messages; `overrides` are `key=value` with dotted
    /// keys; `read` returns the text of a file that the scenario names.
    ///
    /// # Errors
    /// The error names the file or override, the key, the value and what is allowed.
    pub fn parse(
        file: &str,
        text: &str,
        overrides: &[String],
        read: ReadFile<'_>,
    ) -> Result<Self, ScenarioError> {
        let mut scenario: Self = read_with_overrides(file, ADMITTANCE, text, overrides)?;
        if let ShapeConfig::HeightField {
            csv: csv @ None,
            csv_file: Some(name),
        } = &mut scenario.plant.surface.shape
        {
            *csv = Some(read(name).map_err(|source| ScenarioError::File {
                file: file.to_owned(),
                name: name.clone(),
                source,
            })?);
        }
        scenario.check(file)?;
        Ok(scenario)
    }

    fn check(&self, file: &str) -> Result<(), ScenarioError> {
        ScenarioError::unless_duration(file, self.duration_s)?;
        for (key, cycles) in [
            ("pipeline.exchange_cycles", self.pipeline.exchange_cycles),
            ("pipeline.estimate_cycles", self.pipeline.estimate_cycles),
        ] {
            let ok = cycles <= PIPELINE_CYCLES_MAX;
            ScenarioError::unless(file, key, cycles as f64, "0 to 16", ok)?;
        }
        self.base.check()?;
        self.task.check()?;
        self.controller_config()?;
        Ok(())
    }

    /// Preset in use: the task's, or the scenario's if the task names none.
    pub fn preset(&self) -> &str {
        self.task.controller.as_ref().unwrap_or(&self.controller)
    }

    /// The preset with the scenario's own parameters applied.
    ///
    /// # Errors
    /// An unknown preset or parameter, or a value out of range.
    pub fn controller_config(&self) -> Result<ControllerConfig, ScenarioError> {
        ControllerConfig::preset_with(self.preset(), &self.control)
            .map_err(|error| ScenarioError::of_settings(&self.name, error))
    }
}

//! A scenario: a cell, a task, a seed. The TOML files under `scenarios/`.

use serde::{Deserialize, Serialize};
use tangent_control::{ControlError, ControllerConfig, Limits, Task};
use tangent_estimation::{EstimationError, EstimatorConfig};
use tangent_sensing::{BaseConfig, ConditioningConfig, SensingError};
use toml::{Table, Value};

use crate::overrides::{self, OverrideError};
use crate::plant_config::PlantConfig;
use crate::plant_error::PlantError;
use crate::surfaces::ShapeConfig;

/// What is evaluated. Unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// As `tangent evaluate` and reports call it.
    pub name: String,
    /// One sentence on what it shows.
    #[serde(default)]
    pub title: String,
    /// Seed of everything random.
    #[serde(default = "one")]
    pub seed: u64,
    /// Longest run, s; it ends earlier when the task does.
    pub duration_s: f64,
    /// Preset of the control law, unless the task names one.
    #[serde(default = "default_preset")]
    pub controller: String,
    /// Single parameters of the law that differ from the preset.
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
    /// How the pose of a moving base is judged.
    #[serde(default)]
    pub base: BaseConfig,
    /// Delays of the pipeline between plant and controller.
    #[serde(default)]
    pub pipeline: PipelineConfig,
    /// The simulated cell.
    pub plant: PlantConfig,
    /// The job.
    pub task: Task,
}

/// Delays of the live pipeline, in arm periods.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PipelineConfig {
    /// From the arm's packet to the start of the period in which its answer acts: the robot program
    /// reads its registers once per period.
    pub exchange_cycles: usize,
    /// Age of an estimate when the controller uses it: an estimator in another process answers to
    /// the next cycle.
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

/// Why a scenario cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// Not TOML, an unknown key, a wrong type.
    #[error("scenario {file}: {message}")]
    Text {
        /// Name of the file or scenario.
        file: String,
        /// What the reader says: key, line, what is allowed.
        message: String,
    },
    /// A `--set` that cannot be applied.
    #[error(transparent)]
    Override(#[from] OverrideError),
    /// A `--set` that makes the scenario unreadable.
    #[error("--set {text}: {message}")]
    OverrideValue {
        /// As given.
        text: String,
        /// What the reader says.
        message: String,
    },
    /// A file that the scenario names cannot be read.
    #[error("scenario {file}: csv_file \"{name}\": {message}")]
    File {
        /// Name of the file or scenario.
        file: String,
        /// The file it names.
        name: String,
        /// Why not.
        message: String,
    },
    /// A number out of its range.
    #[error("scenario {file}: `{key}` is {value}, but must be {allowed}")]
    Value {
        /// Name of the file or scenario.
        file: String,
        /// Key in question.
        key: &'static str,
        /// What was given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The cell cannot be built.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The law or the task is bad.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// Wrench conditioning is badly set.
    #[error(transparent)]
    Sensing(#[from] SensingError),
    /// An estimator is unknown or badly set.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
}

impl Scenario {
    /// Reads a scenario. `file` is its name for messages; `overrides` are `key=value` with dotted
    /// keys; `read` gives the text of a file that the scenario names, or why not.
    ///
    /// # Errors
    /// Names the file or override, the key, the value and what is allowed.
    pub fn parse(
        file: &str,
        text: &str,
        overrides: &[String],
        read: &dyn Fn(&str) -> Result<String, String>,
    ) -> Result<Self, ScenarioError> {
        let mut scenario: Self = read_with_overrides(file, text, overrides)?;
        if let ShapeConfig::HeightField {
            csv: csv @ None,
            csv_file: Some(name),
        } = &mut scenario.plant.surface.shape
        {
            *csv = Some(read(name).map_err(|message| ScenarioError::File {
                file: file.to_owned(),
                name: name.clone(),
                message,
            })?);
        }
        scenario.check(file)?;
        Ok(scenario)
    }

    fn check(&self, file: &str) -> Result<(), ScenarioError> {
        let value = |key, value: f64, allowed, ok| {
            if ok {
                Ok(())
            } else {
                Err(ScenarioError::Value {
                    file: file.to_owned(),
                    key,
                    value,
                    allowed,
                })
            }
        };
        check_duration(file, self.duration_s)?;
        for (key, cycles) in [
            ("pipeline.exchange_cycles", self.pipeline.exchange_cycles),
            ("pipeline.estimate_cycles", self.pipeline.estimate_cycles),
        ] {
            value(key, cycles as f64, "0 to 16", cycles <= PIPELINE_CYCLES_MAX)?;
        }
        self.base.check()?;
        self.task.check()?;
        self.controller_config()?;
        Ok(())
    }

    /// The preset with the scenario's own parameters in it.
    ///
    /// # Errors
    /// An unknown preset or parameter, or a value out of range.
    pub fn controller_config(&self) -> Result<ControllerConfig, ScenarioError> {
        let name = self.task.controller.as_ref().unwrap_or(&self.controller);
        let preset = ControllerConfig::preset(name)?;
        let text = |message: String| ScenarioError::Text {
            file: self.name.clone(),
            message,
        };
        let mut table = Table::try_from(preset).map_err(|e| text(e.to_string()))?;
        merge(&mut table, &self.control);
        let config = ControllerConfig::deserialize(Value::Table(table))
            .map_err(|e| text(format!("control: {}", e.message())))?;
        config.check()?;
        Ok(config)
    }
}

/// Whether a text is a scenario with this `kind`.
pub(crate) fn is_of_kind(text: &str, kind: &str) -> bool {
    toml::from_str::<Table>(text).is_ok_and(|t| t.get("kind").and_then(Value::as_str) == Some(kind))
}

/// Whether a run may last so long.
pub(crate) fn check_duration(file: &str, duration_s: f64) -> Result<(), ScenarioError> {
    if (0.1..=86_400.0).contains(&duration_s) {
        return Ok(());
    }
    Err(ScenarioError::Value {
        file: file.to_owned(),
        key: "duration_s",
        value: duration_s,
        allowed: "0.1 to 86400 s",
    })
}

/// Reads a scenario of any kind and changes single values of it.
pub(crate) fn read_with_overrides<T: serde::de::DeserializeOwned>(
    file: &str,
    text: &str,
    overrides: &[String],
) -> Result<T, ScenarioError> {
    let bad = |e: toml::de::Error| ScenarioError::Text {
        file: file.to_owned(),
        message: e.to_string(),
    };
    // Read as it stands first: then an error is the file's, with its line.
    toml::from_str::<T>(text).map_err(bad)?;
    let mut table: Table = toml::from_str(text).map_err(bad)?;
    for text in overrides {
        overrides::apply(&mut table, text)?;
        let checked = T::deserialize(Value::Table(table.clone()));
        checked.map_err(|e| ScenarioError::OverrideValue {
            text: text.clone(),
            message: e.message().to_owned(),
        })?;
    }
    T::deserialize(Value::Table(table)).map_err(bad)
}

/// Puts `change` over `base`, table by table.
pub(crate) fn merge(base: &mut Table, change: &Table) {
    for (key, value) in change {
        match (base.get_mut(key), value) {
            (Some(Value::Table(inner)), Value::Table(changes)) => merge(inner, changes),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

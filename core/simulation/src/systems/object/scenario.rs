//! A scenario of the `object` system: a torque-controlled arm, an object of known shape, a
//! camera. Files of kind `object_pose`.

use serde::{Deserialize, Serialize};
use tangent_control::{HybridDynamicsConfig, Limits, Presets, Task};
use tangent_estimation::ObjectPoseConfig;
use tangent_estimation::build_object_estimator;
use tangent_estimation::object_pose::{OBJECT_ESTIMATORS, ObjectShape};
use tangent_sensing::ConditioningConfig;
use toml::Table;

use super::plant_config::ObjectPlantConfig;
use crate::scenario_file::{OBJECT_POSE, ScenarioError, read_with_overrides};
use crate::surfaces::ShapeConfig;

/// The scenario. Unknown keys are errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectScenario {
    /// Name in `tangent evaluate` and in reports.
    pub name: String,
    /// One sentence on what the scenario shows.
    #[serde(default)]
    pub title: String,
    /// Seed of all random numbers: the camera's calibration error, noise.
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
    /// Settings of the estimator; its target's surface is that of the plant unless given.
    #[serde(default)]
    pub estimation: ObjectPoseConfig,
    /// Wrench conditioning.
    #[serde(default)]
    pub sensing: ConditioningConfig,
    /// The simulated cell.
    pub plant: ObjectPlantConfig,
    /// Task to run. Its first estimator is used.
    pub task: Task,
}

impl ObjectScenario {
    /// Reads a scenario. `file` is its name for messages; `overrides` are `key=value` with dotted
    /// keys.
    ///
    /// # Errors
    /// The error names the file or override, the key, the value and what is allowed.
    pub fn parse(file: &str, text: &str, overrides: &[String]) -> Result<Self, ScenarioError> {
        let scenario: Self = read_with_overrides(file, OBJECT_POSE, text, overrides)?;
        ScenarioError::unless_duration(file, scenario.duration_s)?;
        scenario.task.check()?;
        scenario.limits.check()?;
        scenario.law()?;
        scenario.object_surface()?;
        let camera = scenario.plant.camera.model();
        build_object_estimator(scenario.estimator(), &scenario.estimation, &camera)?;
        Ok(scenario)
    }

    /// Name of the estimator in use.
    pub fn estimator(&self) -> &str {
        self.task
            .estimators
            .first()
            .map_or(OBJECT_ESTIMATORS[0], String::as_str)
    }

    /// The preset with the scenario's own parameters applied.
    ///
    /// # Errors
    /// An unknown preset or parameter, or a value out of range.
    pub fn law(&self) -> Result<HybridDynamicsConfig, ScenarioError> {
        HybridDynamicsConfig::preset_with(&self.controller, &self.control)
            .map_err(|error| ScenarioError::of_settings(&self.name, error))
    }

    /// Surface that the estimator assumes. It must be the plant's, as the object's geometry is
    /// known.
    ///
    /// # Errors
    /// The surface has no φ, or differs from the one in the estimator's settings.
    pub fn object_surface(&self) -> Result<ObjectShape, ScenarioError> {
        let text = |message: &str| ScenarioError::Text {
            file: self.name.clone(),
            message: message.to_owned(),
        };
        let plant = match self.plant.surface.shape {
            ShapeConfig::Plane {} => ObjectShape::Plane {},
            ShapeConfig::Cylinder { radius_m } => ObjectShape::Cylinder { radius_m },
            ShapeConfig::Sphere { radius_m } => ObjectShape::Sphere { radius_m },
            _ => {
                return Err(text(
                    "plant.surface.shape: an object is a plane, a cylinder or a sphere",
                ));
            }
        };
        if plant == self.estimation.target.surface {
            Ok(plant)
        } else {
            Err(text(
                "estimation.target.surface is another shape than plant.surface: the object's geometry is known",
            ))
        }
    }
}

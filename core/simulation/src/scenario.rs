//! A scenario of any system: a cell, a task and a seed, as in the TOML files under `scenarios/`.

use serde::Serialize;
use tangent_control::Task;

use crate::arms::loaded_arm::joints_of;
use crate::evaluation::Evaluation;
use crate::plant_error::PlantError;
use crate::scenario_file::{
    ADMITTANCE, OBJECT_POSE, ReadFile, ScenarioError, VISUO_TACTILE, kind_of,
};
use crate::systems::admittance::{AdmittancePlant, AdmittanceScenario, evaluate_admittance};
use crate::systems::object::{ObjectPlant, ObjectScenario, evaluate_object};
use crate::systems::visuo_tactile::{
    VisuoTactilePlant, VisuoTactileScenario, evaluate_visuo_tactile,
};
use crate::tool::ToolConfig;

/// A scenario of one of the systems. The file states the system as `kind`; a file without `kind`
/// belongs to the `admittance` system.
///
/// ```
/// use tangent_simulation::{Scenario, no_files};
///
/// let text = r#"
///     name = "pipe"
///     title = "A pipe of 0.5 m"
///     seed = 1
///     duration_s = 60.0
///     controller = "default"
///     [plant]
///     robot = "ur5"
///     [plant.surface]
///     shape = "cylinder"
///     radius_m = 0.25
///     position_m = [0.45, 0.0, 0.0]
///     roll_pitch_yaw_rad = [1.5707963267948966, 0.0, 0.0]
///     [plant.start]
///     near_m = [0.40, -0.1, 0.3]
///     seed_rad = [3.14, -1.57, 1.57, -1.57, -1.57, 0.0]
///     [task]
///     name = "wipe a pipe"
///     force.reference_n = 3.0
///     path = { kind = "line", to_m = [0.1, 0.0], speed_m_per_s = 0.02 }
/// "#;
/// let half_a_second = ["duration_s=0.5".to_owned()];
/// let scenario = Scenario::parse("pipe.toml", text, &half_a_second, &no_files)?;
/// let evaluation = scenario.evaluate()?;
/// // Periods of 8 ms, up to the end of the time.
/// assert_eq!(evaluation.steps, 63);
/// assert_eq!(evaluation.fault, None);
/// // Equal configuration and seed give equal bits.
/// assert_eq!(evaluation.state_digest, scenario.evaluate()?.state_digest);
///
/// // An override that names no setting is an error.
/// let unknown = ["plant.surface.radius_mm=250".to_owned()];
/// let error = Scenario::parse("pipe.toml", text, &unknown, &no_files).unwrap_err();
/// assert!(error.to_string().contains("radius_mm"));
/// # Ok::<(), tangent_simulation::ScenarioError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Scenario {
    /// An arm that takes torques, an object of known shape, a camera.
    ObjectPose(Box<ObjectScenario>),
    /// An arm that takes torques and has no force sensor, a surface of unknown shape, a camera.
    VisuoTactile(Box<VisuoTactileScenario>),
    /// An arm that takes velocities, a force sensor, a surface of unknown shape.
    #[serde(untagged)]
    Admittance(Box<AdmittanceScenario>),
}

impl Scenario {
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
        let kind = kind_of(text);
        match kind.as_deref().unwrap_or(ADMITTANCE) {
            ADMITTANCE => AdmittanceScenario::parse(file, text, overrides, read).map(Self::from),
            OBJECT_POSE => ObjectScenario::parse(file, text, overrides).map(Self::from),
            VISUO_TACTILE => VisuoTactileScenario::parse(file, text, overrides).map(Self::from),
            _ => Err(ScenarioError::Kind {
                file: file.to_owned(),
                kind,
                allowed: "object_pose or visuo_tactile, or absent",
            }),
        }
    }

    /// Name of the scenario in `tangent evaluate` and in reports.
    pub fn name(&self) -> &str {
        match self {
            Self::Admittance(s) => &s.name,
            Self::ObjectPose(s) => &s.name,
            Self::VisuoTactile(s) => &s.name,
        }
    }

    /// One sentence on what the scenario shows.
    pub fn title(&self) -> &str {
        match self {
            Self::Admittance(s) => &s.title,
            Self::ObjectPose(s) => &s.title,
            Self::VisuoTactile(s) => &s.title,
        }
    }

    /// Task of the scenario.
    pub fn task(&self) -> &Task {
        match self {
            Self::Admittance(s) => &s.task,
            Self::ObjectPose(s) => &s.task,
            Self::VisuoTactile(s) => &s.task,
        }
    }

    /// Tool on the flange.
    pub fn tool_mut(&mut self) -> &mut ToolConfig {
        match self {
            Self::Admittance(s) => &mut s.plant.tool,
            Self::ObjectPose(s) => &mut s.plant.tool,
            Self::VisuoTactile(s) => &mut s.plant.tool,
        }
    }

    /// Joint positions at the start, base to flange, rad.
    ///
    /// # Errors
    /// The plant cannot be built, for instance because its start pose is out of the arm's reach.
    pub fn start_joints(&self) -> Result<Vec<f64>, PlantError> {
        Ok(match self {
            Self::Admittance(s) => {
                let plant = AdmittancePlant::new(&s.plant, s.seed)?;
                plant.joints().as_slice().to_vec()
            }
            Self::ObjectPose(s) => {
                let corners = s.estimation.target.corners();
                match joints_of(&s.plant.robot)? {
                    7 => {
                        let plant = ObjectPlant::<7>::new(&s.plant, corners, s.seed)?;
                        plant.arm().q.as_slice().to_vec()
                    }
                    _ => {
                        let plant = ObjectPlant::<6>::new(&s.plant, corners, s.seed)?;
                        plant.arm().q.as_slice().to_vec()
                    }
                }
            }
            Self::VisuoTactile(s) => match joints_of(&s.plant.robot)? {
                6 => {
                    let plant = VisuoTactilePlant::<6>::new(&s.plant, s.seed)?;
                    plant.measured().q.as_slice().to_vec()
                }
                _ => {
                    let plant = VisuoTactilePlant::<7>::new(&s.plant, s.seed)?;
                    plant.measured().q.as_slice().to_vec()
                }
            },
        })
    }

    /// Runs the scenario to its end.
    ///
    /// # Errors
    /// The cell cannot be built, or the task, law or estimator is not usable.
    pub fn evaluate(&self) -> Result<Evaluation, ScenarioError> {
        match self {
            Self::Admittance(s) => evaluate_admittance(s),
            Self::ObjectPose(s) => evaluate_object(s),
            Self::VisuoTactile(s) => evaluate_visuo_tactile(s),
        }
    }

    /// The scenario, if it belongs to the `admittance` system.
    pub fn into_admittance(self) -> Option<AdmittanceScenario> {
        match self {
            Self::Admittance(scenario) => Some(*scenario),
            _ => None,
        }
    }

    /// The scenario, if it belongs to the `object` system.
    pub fn into_object(self) -> Option<ObjectScenario> {
        match self {
            Self::ObjectPose(scenario) => Some(*scenario),
            _ => None,
        }
    }

    /// The scenario, if it belongs to the `visuo_tactile` system.
    pub fn into_visuo_tactile(self) -> Option<VisuoTactileScenario> {
        match self {
            Self::VisuoTactile(scenario) => Some(*scenario),
            _ => None,
        }
    }
}

impl From<AdmittanceScenario> for Scenario {
    fn from(scenario: AdmittanceScenario) -> Self {
        Self::Admittance(Box::new(scenario))
    }
}

impl From<ObjectScenario> for Scenario {
    fn from(scenario: ObjectScenario) -> Self {
        Self::ObjectPose(Box::new(scenario))
    }
}

impl From<VisuoTactileScenario> for Scenario {
    fn from(scenario: VisuoTactileScenario) -> Self {
        Self::VisuoTactile(Box::new(scenario))
    }
}

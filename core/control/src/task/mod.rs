//! A task as a person writes it: the pressing force, the path, and the phases before and after it.
//!
//! Read from TOML by the `controller` service and by the scenarios of `evaluate`.

pub(crate) mod expected_surface;
pub mod path;
pub mod preflight;
pub mod profile;
pub mod program;
pub mod region;
mod start;
mod tolerances;

use std::str::FromStr;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_mechanics::Tip;

use crate::coverage::spec::CoverageSpec;
use crate::error::{ControlError, check_range};
use crate::inputs::MAX_ESTIMATORS;
use crate::laws::hybrid_admittance::ControllerConfig;
use crate::learning::LearningSpec;
use crate::parameters::presets::Presets;
use crate::phase_machine::Phase;
use crate::task::path::{FORCE_N, PathSpec, Stay, check_force_profile};

pub use expected_surface::ExpectedSurface;
pub(crate) use expected_surface::normal_of;
pub use start::StartSpec;
pub use tolerances::Tolerances;

/// A task: keys as in `docs/tasks.md`. Unknown keys are errors.
///
/// ```
/// use tangent_control::Task;
///
/// let text = r#"
///     name = "wipe"
///     force.reference_n = 3.0
///     [path]
///     kind = "line"
///     to_m = [0.04, 0.0]
///     speed_m_per_s = 0.02
/// "#;
/// let task: Task = text.parse()?;
/// assert_eq!(task.estimators, ["blend", "reactive"]);
/// assert_eq!(task.approach.speed_m_per_s, 0.005);
///
/// let error = text.replace("3.0", "-3.0").parse::<Task>().unwrap_err();
/// assert!(error.to_string().contains("force.reference_n"));
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Name for messages and recordings.
    pub name: String,
    /// Preset of the law: `default` or `paper`; `None` keeps the controller's own.
    #[serde(default)]
    pub controller: Option<String>,
    /// Estimators by order of preference: the first is used, the others are fallbacks.
    #[serde(default = "default_estimators")]
    pub estimators: Vec<String>,
    /// Rules for switches between estimators.
    #[serde(default)]
    pub switching: SwitchingSpec,
    /// Whether the sensor's bias is averaged at rest before contact.
    #[serde(default = "yes")]
    pub tare: bool,
    /// Limit on the age of the sensor's zero.
    #[serde(default)]
    pub zero: ZeroSpec,
    /// Pressing force.
    pub force: ForceSpec,
    /// Approach to the surface.
    #[serde(default)]
    pub approach: ApproachSpec,
    /// Path on the surface.
    pub path: PathSpec,
    /// Orientation of the path's plane.
    #[serde(default)]
    pub plane: PlaneSpec,
    /// End of the task.
    #[serde(default)]
    pub end: EndSpec,
    /// Timeouts of the task.
    #[serde(default)]
    pub timeouts: TimeoutSpec,
    /// What the result must keep for the part to be accepted, judged by the report.
    #[serde(default, skip_serializing_if = "Tolerances::is_empty")]
    pub tolerances: Tolerances,
    /// Dose or passes that a region must get; `None`: the path is run once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coverage: Option<CoverageSpec>,
    /// Learning over repeated passes over the same part; `None`: nothing is learnt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learning: Option<LearningSpec>,
    /// Joint positions to which the arm travels before anything else; `None`: the task starts where
    /// the arm stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<StartSpec>,
    /// Joint positions to which the arm travels after a task that ended well in free space.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub home: Option<StartSpec>,
    /// Whether the task only moves a tool off a surface that it may touch. For a stop after a
    /// restart; not in files.
    #[serde(skip)]
    pub only_leaves: bool,
}

impl Task {
    /// Task that moves a tool off the surface, along the last known normal; the tool may press with
    /// up to `force_max_n`, N.
    pub fn leave(force_max_n: f64) -> Self {
        Self {
            name: "leave".into(),
            controller: None,
            estimators: default_estimators(),
            switching: SwitchingSpec::default(),
            tare: false,
            zero: ZeroSpec::default(),
            force: ForceSpec::constant(0.5 * force_max_n),
            approach: ApproachSpec::default(),
            path: PathSpec::Stay(Stay { duration_s: 1.0 }),
            plane: PlaneSpec::default(),
            end: EndSpec::default(),
            timeouts: TimeoutSpec::default(),
            tolerances: Tolerances::default(),
            coverage: None,
            learning: None,
            start: None,
            home: None,
            only_leaves: true,
        }
    }

    /// Fills in what the tool says: `coverage.radius_m`, if it is not given, is the radius of a
    /// flat, ring or soft tip. The patch of a round tip is not known.
    pub fn complete(&mut self, tip: &Tip) {
        if let (
            Some(coverage),
            Tip::Flat { radius_m } | Tip::Ring { radius_m } | Tip::Soft { radius_m },
        ) = (&mut self.coverage, tip)
        {
            coverage.radius_m.get_or_insert(*radius_m);
        }
    }

    /// Phase in which the task continues once the tool is free.
    pub(crate) fn phase_when_free(&self) -> Phase {
        match self.phase_at_rest() {
            Phase::Tare if !self.tare => Phase::Approach,
            phase => phase,
        }
    }

    /// Like [`Task::phase_when_free`], for a law that waits in `tare` for a valid wrench, with or
    /// without a new zero.
    pub(crate) fn phase_at_rest(&self) -> Phase {
        if self.only_leaves {
            Phase::Done
        } else {
            Phase::Tare
        }
    }
}

/// Pressing force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSpec {
    /// Pressing force along the normal, N, positive.
    pub reference_n: f64,
    /// Force along the whole path instead: `[way in m, force in N]` each, linear between them,
    /// constant beyond. Ways above the surface do not count.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub profile: Vec<[f64; 2]>,
}

impl ForceSpec {
    /// One pressing force on the whole path, N.
    pub fn constant(reference_n: f64) -> Self {
        Self {
            reference_n,
            profile: Vec::new(),
        }
    }
}

/// A direction: an axis of the tool where the task starts, or a vector in base axes.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_control::{Direction, ToolAxis};
/// use tangent_mechanics::{Base, Pose, Tool};
///
/// // A tool that points down.
/// let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
/// let base_from_tool = Pose::<Base, Tool>::new(Vector3::zeros(), down);
/// let along_tool = Direction::Axis(ToolAxis::ToolZ).in_base(&base_from_tool);
/// let in_base = Direction::Vector([0.0, 0.0, -2.0]).in_base(&base_from_tool);
/// assert!((along_tool - in_base).norm() < 1e-12);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Direction {
    /// `tool_x`, `tool_y` or `tool_z`.
    Axis(ToolAxis),
    /// Vector in base axes, of any length but zero.
    Vector([f64; 3]),
}

/// An axis of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum ToolAxis {
    ToolX,
    ToolY,
    ToolZ,
}

impl Direction {
    /// Unit vector in base axes.
    pub fn in_base<A, B>(&self, base_from_tool: &tangent_mechanics::Pose<A, B>) -> Vector3<f64> {
        match self {
            Self::Axis(ToolAxis::ToolX) => base_from_tool.rotate(&Vector3::x()),
            Self::Axis(ToolAxis::ToolY) => base_from_tool.rotate(&Vector3::y()),
            Self::Axis(ToolAxis::ToolZ) => base_from_tool.rotate(&Vector3::z()),
            Self::Vector(v) => Vector3::from(*v).normalize(),
        }
    }

    fn check(&self, key: &str) -> Result<(), ControlError> {
        match self {
            Self::Axis(_) => Ok(()),
            Self::Vector(v) => {
                let norm = Vector3::from(*v).norm();
                if norm.is_finite() && norm > 1e-9 {
                    return Ok(());
                }
                Err(ControlError::range(
                    key,
                    format!("{v:?}"),
                    "`tool_x`, `tool_y`, `tool_z` or a vector that is not zero",
                ))
            }
        }
    }
}

/// Approach to the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ApproachSpec {
    /// Direction towards the surface.
    pub direction: Direction,
    /// Speed of the approach, m/s; reduced further if the expected stiffness requires it.
    pub speed_m_per_s: f64,
    /// Distance without contact after which the approach gives up, m.
    pub distance_max_m: f64,
    /// Stiffest contact expected, N/m: bounds the speed so that the first impact stays small.
    /// `None`: the preset's value.
    pub stiffness_expected_n_per_m: Option<f64>,
}

impl Default for ApproachSpec {
    fn default() -> Self {
        Self {
            direction: Direction::Axis(ToolAxis::ToolZ),
            speed_m_per_s: 0.005,
            distance_max_m: 0.08,
            stiffness_expected_n_per_m: None,
        }
    }
}

/// Orientation of the path's plane. Its z axis is against the approach direction; the path is drawn
/// in x and y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneSpec {
    /// Direction of the path's x axis, projected into the plane.
    pub x_axis: Direction,
}

impl Default for PlaneSpec {
    fn default() -> Self {
        Self {
            x_axis: Direction::Axis(ToolAxis::ToolX),
        }
    }
}

/// End of the task.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EndSpec {
    /// Time for which the force is held at the end of the path, s.
    pub hold_s: f64,
    /// Distance of the retraction along the normal, m.
    pub retract_distance_m: f64,
    /// Speed of the retraction, m/s.
    pub retract_speed_m_per_s: f64,
}

impl Default for EndSpec {
    fn default() -> Self {
        Self {
            hold_s: 0.5,
            retract_distance_m: 0.05,
            retract_speed_m_per_s: 0.02,
        }
    }
}

/// Timeouts of a task, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimeoutSpec {
    /// Timeout of the tare before contact, s.
    pub tare_s: f64,
    /// Timeout for the force to settle after touchdown, s.
    pub contact_s: f64,
    /// Timeout of the whole task, s; 0: no limit.
    pub task_s: f64,
}

impl Default for TimeoutSpec {
    fn default() -> Self {
        Self {
            tare_s: 5.0,
            contact_s: 10.0,
            task_s: 0.0,
        }
    }
}

/// Limit on the age of the sensor's zero during a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZeroSpec {
    /// Maximum error implied by the zero's age and the sensor's stated drift, N; `None`: no limit.
    pub error_max_n: Option<f64>,
    /// Reaction when the limit is exceeded.
    pub at_limit: ZeroAtLimit,
}

/// Reaction to a zero that is too old.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ZeroAtLimit {
    /// The task ends with a retraction.
    #[default]
    Stop,
    /// The tool lifts off, the sensor is tared, and the task continues where it was. For
    /// velocity-controlled arms on a base that stands; others stop.
    Retare,
}

/// Rules for switches between estimators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwitchingSpec {
    /// Maximum angle between a candidate's normal and the one in use, rad; `None`: the law's
    /// `normal.switch_gate_rad`.
    pub disagreement_max_rad: Option<f64>,
    /// Time for which the preferred estimator must be usable before it is chosen again after a
    /// fallback, s; `None`: only on request.
    pub return_after_good_s: Option<f64>,
}

fn default_estimators() -> Vec<String> {
    vec!["blend".into(), "reactive".into()]
}

fn yes() -> bool {
    true
}

impl FromStr for Task {
    type Err = ControlError;

    /// Reads and checks a TOML document.
    fn from_str(text: &str) -> Result<Self, ControlError> {
        let task: Self = toml::from_str(text).map_err(|e| ControlError::Syntax(e.to_string()))?;
        task.check()?;
        Ok(task)
    }
}

impl Task {
    /// Checks that every number is in its range and every name is usable.
    pub fn check(&self) -> Result<(), ControlError> {
        if self.name.is_empty() || self.name.len() > 64 {
            return Err(ControlError::range("name", &self.name, "1 to 64 bytes"));
        }
        if self.estimators.is_empty() || self.estimators.len() > MAX_ESTIMATORS {
            return Err(ControlError::range(
                "estimators",
                format!("{:?}", self.estimators),
                "one to eight names, the preferred first",
            ));
        }
        for (i, name) in self.estimators.iter().enumerate() {
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            if name.is_empty() || name.len() > 64 || !name.chars().all(plain) {
                return Err(ControlError::range(
                    "estimators",
                    format!("\"{name}\""),
                    "letters, digits, `_` and `-`",
                ));
            }
            if self.estimators[..i].contains(name) {
                return Err(ControlError::range(
                    "estimators",
                    format!("\"{name}\" twice"),
                    "each name once",
                ));
            }
        }
        if let Some(name) = &self.controller {
            ControllerConfig::preset(name)?;
        }
        let switching = &self.switching;
        if let Some(angle) = switching.disagreement_max_rad {
            check_range("switching.disagreement_max_rad", angle, 0.01, 3.0)?;
        }
        if let Some(time) = switching.return_after_good_s {
            check_range("switching.return_after_good_s", time, 0.05, 3600.0)?;
        }
        if let Some(error_n) = self.zero.error_max_n {
            check_range("zero.error_max_n", error_n, 0.005, 100.0)?;
        }
        let (least_n, most_n) = FORCE_N;
        check_range("force.reference_n", self.force.reference_n, least_n, most_n)?;
        if !self.force.profile.is_empty() {
            check_force_profile("force.profile", &self.force.profile)?;
        }
        let approach = &self.approach;
        approach.direction.check("approach.direction")?;
        check_range(
            "approach.speed_m_per_s",
            approach.speed_m_per_s,
            0.0005,
            0.05,
        )?;
        check_range(
            "approach.distance_max_m",
            approach.distance_max_m,
            0.001,
            1.0,
        )?;
        if let Some(k) = approach.stiffness_expected_n_per_m {
            check_range("approach.stiffness_expected_n_per_m", k, 100.0, 200_000.0)?;
        }
        self.plane.x_axis.check("plane.x_axis")?;
        check_range("end.hold_s", self.end.hold_s, 0.0, 600.0)?;
        check_range(
            "end.retract_distance_m",
            self.end.retract_distance_m,
            0.005,
            0.5,
        )?;
        check_range(
            "end.retract_speed_m_per_s",
            self.end.retract_speed_m_per_s,
            0.001,
            0.1,
        )?;
        check_range("timeouts.tare_s", self.timeouts.tare_s, 0.1, 120.0)?;
        check_range("timeouts.contact_s", self.timeouts.contact_s, 0.5, 120.0)?;
        check_range("timeouts.task_s", self.timeouts.task_s, 0.0, 86_400.0)?;
        self.tolerances.check()?;
        if let Some(learning) = &self.learning {
            learning.check()?;
        }
        if let Some(start) = &self.start {
            start.check("start")?;
        }
        if let Some(home) = &self.home {
            home.check("home")?;
        }
        if let Some(coverage) = &self.coverage {
            coverage.check(&self.path, self.learning.is_some())?;
        }
        self.path.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"
        name = "line"
        force.reference_n = 3.0
        [path]
        kind = "line"
        to_m = [0.1, 0.0]
        speed_m_per_s = 0.02
    "#;

    #[test]
    fn defaults_fill_what_is_not_said() {
        let task: Task = LINE.parse().unwrap();
        assert_eq!(task.estimators, ["blend", "reactive"]);
        assert!(task.tare);
        assert_eq!(task.approach, ApproachSpec::default());
        let again: Task = toml::to_string(&task).unwrap().parse().unwrap();
        assert_eq!(again, task);
    }

    #[test]
    fn errors_name_the_key() {
        for (from, to, key) in [
            ("3.0", "-3.0", "force.reference_n"),
            ("name = \"line\"", "name = \"line\"\nfoo = 1", "foo"),
            (
                "speed_m_per_s = 0.02",
                "speed_m_per_s = 2.0",
                "path.speed_m_per_s",
            ),
            ("speed_m_per_s = 0.02", "speed = 0.02", "speed"),
            (
                "\"line\"\n        to_m",
                "\"spiral\"\n        to_m",
                "spiral",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\nestimators = [\"a\", \"a\"]",
                "estimators",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\napproach.direction = [0.0, 0.0, 0.0]",
                "approach.direction",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\nswitching.disagreement_max_rad = 20.0",
                "switching.disagreement_max_rad",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\nswitching.return_after_good_s = 0.0",
                "switching.return_after_good_s",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\ncontroller = \"magic\"",
                "magic",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\nstart = { joints_rad = [0.0, 0.0] }",
                "start.joints_rad",
            ),
            (
                "name = \"line\"",
                "name = \"line\"\nhome = { joints_rad = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], speed_rad_per_s = 3.0 }",
                "home.speed_rad_per_s",
            ),
        ] {
            let text = LINE.replacen(from, to, 1);
            assert_ne!(text, LINE, "{from}");
            let error = text.parse::<Task>().unwrap_err().to_string();
            assert!(error.contains(key), "{key}: {error}");
        }
    }

    #[test]
    fn a_direction_is_an_axis_or_a_vector() {
        let text = LINE.replacen(
            "name = \"line\"",
            "name = \"line\"\napproach.direction = [0.0, 0.0, -2.0]\nplane.x_axis = \"tool_y\"",
            1,
        );
        let task: Task = text.parse().unwrap();
        let pose: tangent_mechanics::Pose<tangent_mechanics::Base, tangent_mechanics::Tool> =
            tangent_mechanics::Pose::identity();
        assert_eq!(task.approach.direction.in_base(&pose), -Vector3::z());
        assert_eq!(task.plane.x_axis.in_base(&pose), Vector3::y());
    }
}

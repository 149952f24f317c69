//! A task as a person writes it: the pressing force, the path, and the phases before and after it.
//!
//! Read from TOML by the `controller` service and by the scenarios of `evaluate`.

mod approach;
mod direction;
mod end;
pub(crate) mod expected_surface;
mod force;
pub mod path;
pub mod preflight;
pub mod profile;
pub mod program;
pub mod region;
mod start;
mod switching;
mod tolerances;
mod zero;

use std::str::FromStr;

use serde::{Deserialize, Serialize};
use tangent_mechanics::Tip;

use crate::coverage::spec::CoverageSpec;
use crate::error::ControlError;
use crate::inputs::MAX_ESTIMATORS;
use crate::laws::hybrid_admittance::ControllerConfig;
use crate::learning::LearningSpec;
use crate::parameters::presets::Presets;
use crate::phase_machine::Phase;
use crate::task::path::{PathSpec, Stay};

pub use approach::{ApproachSpec, PlaneSpec};
pub use direction::{Direction, ToolAxis};
pub use end::{EndSpec, TimeoutSpec};
pub use expected_surface::ExpectedSurface;
pub(crate) use expected_surface::normal_of;
pub use force::ForceSpec;
pub use start::StartSpec;
pub use switching::SwitchingSpec;
pub use tolerances::Tolerances;
pub use zero::{ZeroAtLimit, ZeroSpec};

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
    /// flat, ring or soft tip. The patch of a round tip is not known. A contact through a soft tip
    /// is soft.
    pub fn complete(&mut self, tip: &Tip) {
        self.approach.soft_tip = matches!(tip, Tip::Soft { .. });
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
        self.switching.check()?;
        self.zero.check()?;
        self.force.check()?;
        self.approach.check()?;
        self.plane.x_axis.check("plane.x_axis")?;
        self.end.check()?;
        self.timeouts.check()?;
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
    use nalgebra::Vector3;

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

//! A task made ready to run: checked, its path timed, its names in fixed capacity. Made outside the
//! loop.

use arrayvec::{ArrayString, ArrayVec};

use crate::coverage::Coverage;
use crate::error::ControlError;
use crate::inputs::MAX_ESTIMATORS;
use crate::laws::hybrid_admittance::ControllerConfig;
use crate::laws::hybrid_admittance::surface_chart::SurfaceChart;
use crate::learning::{Learner, Memory, MemoryError};
use crate::parameters::law_config::LawConfig;
use crate::parameters::presets::Presets;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::path::Path;

/// An estimator's name, as in `estimate/NAME/normal`.
pub type EstimatorName = ArrayString<64>;
/// Estimators by order of preference.
pub type EstimatorNames = ArrayVec<EstimatorName, MAX_ESTIMATORS>;

/// A task made ready to run. Making one allocates; running it does not.
///
/// ```
/// use tangent_control::{ControllerConfig, Program, Task};
///
/// // Moves the tool off the surface; its path is to stay for one second.
/// let task = Task::leave(10.0);
/// let program = Program::new(&task, &ControllerConfig::default())?;
/// assert_eq!(program.path.duration_s(), 1.0);
/// assert_eq!(program.estimators[0].as_str(), "blend");
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Program<C = ControllerConfig> {
    /// Task from which the program was made.
    pub task: Task,
    /// Parameters of the law.
    pub config: C,
    /// The path over time.
    pub path: Path,
    /// Estimators by order of preference.
    pub estimators: EstimatorNames,
    /// What is used and changed while the program runs.
    pub(crate) memory: RunMemory,
}

/// What a program allocates for its run, and the law uses and changes meanwhile.
#[derive(Clone, Debug, Default)]
pub(crate) struct RunMemory {
    /// What earlier passes learnt, and the record of this one; `None` if the task does not learn.
    pub learner: Option<Box<Learner>>,
    /// Room for what the tool feels of the surface; `None` if it never lifts off.
    pub chart: Option<Box<SurfaceChart>>,
    /// Dose over the region and the rounds; `None` without `[coverage]`.
    pub coverage: Option<Box<Coverage>>,
}

impl<C: LawConfig> Program<C> {
    /// Checks the task and the parameters of its law, and times the path.
    ///
    /// # Errors
    /// A number is out of its range.
    pub fn with_config(task: &Task, config: C) -> Result<Self, ControlError> {
        task.check()?;
        config.check()?;
        let (acceleration, jerk) = config.path_bounds();
        let mut path = Path::new(&task.path, acceleration, jerk)?;
        press_along_path(task, &mut path)?;
        let (rate, most) = (
            path.force_rate_max_n_per_s(),
            config.force_rate_max_n_per_s(),
        );
        if rate > most {
            return Err(ControlError::range(
                "force profile",
                format!("a change of {rate:.1} N/s at the speed of the path"),
                &format!(
                    "at most {most} N/s (`force.reference_rate_n_per_s` of the law): a slower path, \
                     or a profile that is less steep"
                ),
            ));
        }
        let mut estimators = EstimatorNames::new();
        for name in &task.estimators {
            estimators.push(
                EstimatorName::from(name)
                    .map_err(|e| ControlError::range("estimators", e, "at most 64 bytes"))?,
            );
        }
        let learner = match &task.learning {
            Some(spec) if C::LEARNS => {
                let memory = Memory::new(&path);
                Some(Box::new(Learner::new(spec.clone(), memory)))
            }
            Some(spec) => {
                return Err(ControlError::range(
                    "learning.part",
                    format!("\"{}\"", spec.part),
                    "no `[learning]` with a torque-controlled arm: its laws do not learn",
                ));
            }
            None => None,
        };
        if task.home.is_some() && !C::TRAVELS {
            return Err(ControlError::range(
                "home",
                "set",
                "no `[home]` with a torque-controlled arm: its laws do not move it in joint space",
            ));
        }
        check_lifts::<C>(task, &path)?;
        let coverage = Coverage::new(task, &mut path, (acceleration, jerk))?.map(Box::new);
        let chart =
            (path.lifts() > 0 || coverage.is_some()).then(|| Box::new(SurfaceChart::new(&path)));
        Ok(Self {
            task: task.clone(),
            config,
            path,
            estimators,
            memory: RunMemory {
                learner,
                chart,
                coverage,
            },
        })
    }

    /// Whether the tool may leave its path by some millimetres to feel the surface: not within a
    /// region, where that adds to a dose or crosses its boundary, and not where a pass is learnt.
    pub(crate) fn explores_on_path(&self) -> bool {
        self.path.lifts() == 0 && self.task.coverage.is_none() && self.task.learning.is_none()
    }

    /// Highest pressing force that is asked for, N.
    pub(crate) fn force_max_n(&self) -> f64 {
        let task_n = self.task.force.reference_n;
        self.path.force_max_n().map_or(task_n, |n| n.max(task_n))
    }

    /// Starts from what earlier passes learnt. No effect on a task that does not learn. Allocates.
    ///
    /// # Errors
    /// The memory is of another path. The program is then unchanged, and learns anew.
    pub fn remember(&mut self, memory: Memory) -> Result<(), MemoryError> {
        if let (Some(spec), Some(learner)) = (&self.task.learning, &mut self.memory.learner) {
            memory.check_path(&self.path)?;
            **learner = Learner::new(spec.clone(), memory);
        }
        Ok(())
    }
}

/// Puts `force.profile` on the path.
fn press_along_path(task: &Task, path: &mut Path) -> Result<(), ControlError> {
    let profile = &task.force.profile;
    if profile.is_empty() {
        return Ok(());
    }
    if path.has_forces() {
        return Err(ControlError::range(
            "force.profile",
            "set beside strokes with `force_n` or `force_profile`",
            "one of them",
        ));
    }
    path.press_along(profile);
    Ok(())
}

/// Refuses strokes that the law cannot do.
fn check_lifts<C: LawConfig>(task: &Task, path: &Path) -> Result<(), ControlError> {
    if C::LIFTS {
        return Ok(());
    }
    if task.coverage.is_some() {
        return Err(ControlError::range(
            "coverage",
            "asked for",
            "no `[coverage]` with a torque-controlled arm: its laws do not lift off between rounds",
        ));
    }
    if path.lifts() > 0 {
        return Err(ControlError::range(
            "path",
            format!("a path for which the tool lifts off {} times", path.lifts()),
            "a path without lifts with a torque-controlled arm: its laws do not lift off between \
             strokes. Use one stroke, or a region without holes whose strokes are connected",
        ));
    }
    if path.has_forces() {
        return Err(ControlError::range(
            "path.strokes",
            "a list with `force_n` or `force_profile`, or a task with `force.profile`",
            "strokes with the task's force with a torque-controlled arm: its laws press with one \
             force",
        ));
    }
    if task.path.expected_surface().is_some() {
        return Err(ControlError::range(
            "path.surface",
            "set",
            "no expected surface with a torque-controlled arm: its laws follow lengths along the \
             surface",
        ));
    }
    Ok(())
}

impl Program {
    /// First phase of a task that starts with a free tool.
    pub(crate) fn first_phase(&self) -> Phase {
        if self.task.start.is_some() && !self.task.only_leaves {
            Phase::Travel
        } else {
            self.task.phase_when_free()
        }
    }

    /// Checks the task and times its path. The task's own preset takes precedence over `config`.
    ///
    /// # Errors
    /// An unknown preset, or a number out of its range.
    pub fn new(task: &Task, config: &ControllerConfig) -> Result<Self, ControlError> {
        task.check()?;
        let config = match &task.controller {
            Some(name) => ControllerConfig::preset(name)?,
            None => *config,
        };
        Self::with_config(task, config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HybridDynamicsConfig;

    #[test]
    fn only_the_law_that_learns_takes_a_task_that_does() {
        let text = "name = \"a\"\nforce.reference_n = 3.0\nlearning.part = \"lid\"\n\
                    path = { kind = \"stay\", duration_s = 1.0 }";
        let task: Task = text.parse().unwrap();
        let program = Program::new(&task, &ControllerConfig::default()).unwrap();
        assert!(program.memory.learner.is_some());
        let error = Program::with_config(&task, HybridDynamicsConfig::default()).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("learning.part") && error.contains("\"lid\""),
            "{error}"
        );
    }

    #[test]
    fn laws_that_do_not_lift_off_refuse_strokes_apart() {
        let text = "name = \"a\"\nforce.reference_n = 3.0\n[path]\nkind = \"strokes\"\n\
                    speed_m_per_s = 0.02\n[[path.strokes]]\npoints_m = [[0.0, 0.0], [0.1, 0.0]]\n";
        let refusal = |more: &str| {
            let task: Task = format!("{text}{more}").parse().unwrap();
            Program::new(&task, &ControllerConfig::default()).unwrap();
            Program::with_config(&task, HybridDynamicsConfig::default())
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(refusal(""), None);
        let apart = refusal("[[path.strokes]]\npoints_m = [[0.1, 0.1], [0.0, 0.1]]").unwrap();
        assert!(
            apart.contains("lifts off 1 times") && apart.contains("torque"),
            "{apart}"
        );
        let forced = refusal("force_n = 4.0").unwrap();
        assert!(
            forced.contains("`force_n`") && forced.contains("torque"),
            "{forced}"
        );
    }
}

//! One cell for each law with a common interface, and its true state in each period.

use nalgebra::Vector3;
use tangent_control::{Clearance, Fault, Law as _, Parameter, Phase, Task, TorqueLaw};
use tangent_simulation::{
    AdmittanceLoop, AdmittanceScenario, ObjectLoop, ObjectScenario, Obstacle, Undisturbed,
    VisuoTactileLoop, VisuoTactileScenario, no_files,
};

/// Control law of the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Hybrid admittance: joint velocities, a force sensor at the wrist.
    Velocity,
    /// `hybrid_dynamics`: torques, a force sensor at the wrist.
    Hybrid,
    /// `unified_force_impedance`: torques, and the robot's own estimate of the wrench.
    Unified,
}

/// True state and measurements in one period.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)] // Not every test asks for everything.
pub struct Seen {
    pub time_s: f64,
    pub phase: Phase,
    pub fault: Option<Fault>,
    pub clearance: Clearance,
    /// True force on the tool, N: along the surface's normal, and its norm.
    pub pressing_n: f64,
    pub force_n: f64,
    /// Force as read by the law, N.
    pub read_n: Option<f64>,
    /// Measured position of the tool's origin, and the normal in use, base axes.
    pub at: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Stiffness of the contact estimated by the law, N/m; 0 if there is no estimate.
    pub stiffness_n_per_m: f64,
}

enum Loop {
    Velocity(Box<AdmittanceLoop>),
    Hybrid(Box<ObjectLoop>),
    Unified(Box<VisuoTactileLoop>),
}

/// A cell, its period and the requests of its task.
pub struct Cell {
    inner: Loop,
    pub period_s: f64,
    pub reference_n: f64,
    pub duration_s: f64,
}

fn text(path: &str) -> String {
    let file = format!("{}/../../scenarios/{path}.toml", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&file).unwrap()
}

/// Builds [`Seen`] from a cycle: the cycles of the three laws are different types with fields of
/// equal names.
macro_rules! seen {
    ($c:ident, $at:expr, $stiffness:expr) => {
        Seen {
            time_s: $c.input.time_s,
            phase: $c.output.phase,
            fault: $c.output.fault,
            clearance: $c.output.clearance,
            pressing_n: $c.truth.wrench.force.dot(&$c.truth.normal),
            force_n: $c.truth.wrench.force.norm(),
            read_n: $c.output.force_n,
            at: $at,
            normal: $c.output.normal,
            stiffness_n_per_m: $stiffness,
        }
    };
}

impl Cell {
    /// Cell of the scenario at `path` (below `scenarios`, without its extension), with single keys
    /// changed.
    pub fn new(law: Law, path: &str, set: &[String]) -> Self {
        let text = text(path);
        match law {
            Law::Velocity => {
                let s = AdmittanceScenario::parse(path, &text, set, &no_files);
                let s = s.unwrap();
                let cell = AdmittanceLoop::new(&s).unwrap();
                let period_s = cell.plant().period_s();
                Self::of(
                    Loop::Velocity(Box::new(cell)),
                    period_s,
                    &s.task,
                    s.duration_s,
                )
            }
            Law::Hybrid => {
                let s = ObjectScenario::parse(path, &text, set).unwrap();
                let cell = ObjectLoop::<6>::new(&s).unwrap();
                let period_s = cell.plant().period_s();
                Self::of(
                    Loop::Hybrid(Box::new(cell)),
                    period_s,
                    &s.task,
                    s.duration_s,
                )
            }
            Law::Unified => {
                let s = VisuoTactileScenario::parse(path, &text, set).unwrap();
                let cell = VisuoTactileLoop::<7>::new(&s).unwrap();
                let period_s = cell.plant().period_s();
                Self::of(
                    Loop::Unified(Box::new(cell)),
                    period_s,
                    &s.task,
                    s.duration_s,
                )
            }
        }
    }

    fn of(inner: Loop, period_s: f64, task: &Task, duration_s: f64) -> Self {
        Self {
            inner,
            period_s,
            reference_n: task.force.reference_n,
            duration_s,
        }
    }

    /// Bound on the true force, N.
    pub fn bound_n(&self) -> f64 {
        (2.0 * self.reference_n).max(10.0)
    }

    /// Runs one period.
    pub fn step(&mut self) -> Seen {
        let mut seen = None;
        match &mut self.inner {
            Loop::Velocity(cell) => {
                let _ = cell.step(&mut |c| {
                    let at = c.input.base_from_tool.translation();
                    seen = Some(seen!(c, at, c.output.stiffness_n_per_m));
                });
            }
            Loop::Hybrid(cell) => {
                let _ = cell.step(&mut Undisturbed, &mut |c| {
                    seen = Some(seen!(c, c.output.base_from_tool.translation(), 0.0));
                });
            }
            Loop::Unified(cell) => {
                let _ = cell.step(&mut Undisturbed, &mut |c| {
                    seen = Some(seen!(c, c.output.base_from_tool.translation(), 0.0));
                });
            }
        }
        seen.unwrap()
    }

    /// Ends the task: the tool leaves the surface.
    #[allow(dead_code)]
    pub fn stop(&mut self) {
        match &mut self.inner {
            Loop::Velocity(cell) => cell.controller().stop(),
            Loop::Hybrid(cell) => cell.controller().stop(),
            Loop::Unified(cell) => cell.controller().stop(),
        }
    }

    /// Changes the reference of the pressing force.
    #[allow(dead_code)]
    pub fn press(&mut self, force_n: f64) {
        match &mut self.inner {
            Loop::Velocity(cell) => cell.controller().set(Parameter::ForceReference, force_n),
            Loop::Hybrid(cell) => cell.controller().set(Parameter::ForceReference, force_n),
            Loop::Unified(cell) => cell.controller().set(Parameter::ForceReference, force_n),
        }
    }

    /// Ends the task with a retraction in a wrong direction.
    #[allow(dead_code)]
    pub fn stop_along(&mut self, away: Vector3<f64>) {
        match &mut self.inner {
            Loop::Velocity(cell) => cell.controller().stop_along(away),
            Loop::Hybrid(cell) => cell.controller().stop_along(away),
            Loop::Unified(cell) => cell.controller().stop_along(away),
        }
    }

    /// Puts an obstacle in the way of the tool as it leaves.
    #[allow(dead_code)]
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        match &mut self.inner {
            Loop::Velocity(cell) => cell.put_in_the_way(obstacle),
            Loop::Hybrid(cell) => cell.put_in_the_way(obstacle),
            Loop::Unified(cell) => cell.put_in_the_way(obstacle),
        }
    }
}

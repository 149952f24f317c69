//! Common parts of the failure tables: a cell that is stepped cycle by cycle, the active faults,
//! and bounds that hold in every cell. Each table has its own cell, faults and rows.

// Each table uses a part of this module.
#![allow(dead_code)]

pub mod arrivals;
pub mod pairs;
pub mod sensor;

use std::fmt::Debug;
use std::ops::RangeInclusive;

use tangent_actuation::lease::Source;
use tangent_control::{Fault as TaskFault, Phase};
use tangent_schemas::Name;
use tangent_sensing::Validity;
use tangent_simulation::Truth;

/// Declares the faults of a table, and the list of all of them.
macro_rules! faults {
    ($($(#[$doc:meta])+ $name:ident,)*) => {
        /// A fault of a cell.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Fault {
            $($(#[$doc])+ $name,)*
        }

        impl Fault {
            /// Every fault of the table.
            pub const ALL: &[Self] = &[$(Self::$name),*];
        }
    };
}
pub(crate) use faults;

/// A fault of a table.
pub trait TableFault: Copy + Debug + PartialEq + 'static {
    /// Every fault of the table.
    const ALL: &'static [Self];
    /// The controller does not answer.
    const NO_COMMAND: Self;
    /// The reading is zero, varies, and is marked valid.
    const CONTACT_LOST: Self;

    /// Whether a task continues during the fault.
    fn is_tolerated(self) -> bool;
}

/// The active faults, and the values measured meanwhile.
#[derive(Debug)]
pub struct Trial<F> {
    /// Number of cycles since the start of the cell.
    pub cycle: u64,
    /// Active faults.
    pub faults: Vec<F>,
    /// Faults that were active in the cycle before.
    before: Vec<F>,
    /// Largest true force since the last reset, N.
    pub peak_n: f64,
}

impl<F> Default for Trial<F> {
    fn default() -> Self {
        Self {
            cycle: 0,
            faults: Vec::new(),
            before: Vec::new(),
            peak_n: 0.0,
        }
    }
}

impl<F: TableFault> Trial<F> {
    /// The faults that have begun and those that have ended since the last call; `None` if there is
    /// no change.
    pub fn changes(&mut self) -> Option<(Vec<F>, Vec<F>)> {
        if self.faults == self.before {
            return None;
        }
        let before = std::mem::replace(&mut self.before, self.faults.clone());
        let only = |of: &[F], not: &[F]| -> Vec<F> {
            let kept = of.iter().filter(|fault| !not.contains(fault));
            kept.copied().collect()
        };
        Some((only(&self.faults, &before), only(&before, &self.faults)))
    }
}

/// A cell in simulated time: robot, bridge or gate, sensors and law, without sockets and clock.
pub trait TableCell: Sized {
    /// Type that selects one of its variants.
    type Setup: pairs::Setup;
    /// Faults of the cell.
    type Fault: TableFault;
    /// Longest wait, cycles.
    const PATIENCE: u64;
    /// Joint speed below which the arm is at rest, rad/s.
    const AT_REST: f64;
    /// Whether a pause is a phase of its own; otherwise the cell stays in the phase in which it was
    /// paused.
    const PAUSE_IS_A_PHASE: bool;

    /// Creates a cell that is ready for a task; none runs.
    fn new(setup: Self::Setup) -> Self;
    /// Runs one period.
    fn step(&mut self);
    /// The active faults, and the largest force.
    fn trial(&self) -> &Trial<Self::Fault>;
    /// The active faults, to be changed.
    fn trial_mut(&mut self) -> &mut Trial<Self::Fault>;
    /// Period of the robot, s.
    fn period_s(&self) -> f64;
    /// Phase of the task.
    fn phase(&self) -> Phase;
    /// Whether the tool moves along the path.
    fn is_sliding(&self) -> bool;
    /// Whether a start is all that a task needs to move the arm.
    fn is_ready(&self) -> bool;
    /// State of law and bridge as text, for messages.
    fn in_words(&self) -> String;
    /// Ground truth of the contact.
    fn truth(&self) -> Truth;
    /// Force along the normal as the controller shows it, N.
    fn shown_n(&self) -> f64;
    /// Reason why the task ended or retracts.
    fn task_fault(&self) -> Option<TaskFault>;
    /// Progress of the tool on the path, 0 to 1.
    fn progress(&self) -> f64;
    /// Reference force of the task, N.
    fn reference_n(&self) -> f64;
    /// Largest joint speed of the arm, rad/s.
    fn robot_speed(&self) -> f64;
    /// Starts the task.
    fn start_task(&mut self);
    /// Pauses the task.
    fn pause_task(&mut self);
    /// Ends the task.
    fn stop_task(&mut self);

    /// Largest force allowed in any case: the larger of twice the reference and 10 N.
    fn most_n(&self) -> f64 {
        (2.0 * self.reference_n()).max(10.0)
    }

    /// Whether the fault is active.
    fn has(&self, fault: Self::Fault) -> bool {
        self.trial().faults.contains(&fault)
    }

    /// Runs `n` cycles.
    fn steps(&mut self, n: u64) {
        for _ in 0..n {
            self.step();
        }
    }

    /// Number of whole periods in a time of `s` seconds.
    fn cycles_in(&self, s: f64) -> u64 {
        (s / self.period_s()) as u64
    }

    /// Runs until `done` returns true.
    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = self.trial().cycle;
        while !done(self) {
            self.step();
            let waited = self.trial().cycle - begun;
            assert!(
                waited < Self::PATIENCE,
                "never: {what}; {}",
                self.in_words()
            );
        }
    }

    /// A cell whose tool slides on the path.
    fn sliding(setup: Self::Setup) -> Self {
        let mut cell = Self::new(setup);
        cell.start_task();
        cell.until("it slides", Self::is_sliding);
        cell.trial_mut().peak_n = 0.0;
        cell
    }

    /// A cell with a task in the first cycle of this phase.
    fn in_phase(setup: Self::Setup, phase: Phase) -> Self {
        let mut cell = match phase {
            Phase::Slide => return Self::sliding(setup),
            Phase::Hold | Phase::Retract | Phase::Clear => Self::sliding(setup),
            _ => Self::new(setup),
        };
        match phase {
            Phase::Hold => cell.pause_task(),
            Phase::Retract => cell.stop_task(),
            Phase::Clear => {
                // The task has ended on the surface.
                cell.trial_mut().faults = vec![Self::Fault::NO_COMMAND];
                cell.steps(cell.cycles_in(0.4));
                cell.trial_mut().faults.clear();
                cell.until("the task is over", |c| !c.phase().is_active());
                cell.until("the arm is ready", Self::is_ready);
                cell.start_task();
            }
            _ => cell.start_task(),
        }
        if phase != Phase::Hold || Self::PAUSE_IS_A_PHASE {
            cell.until("it is in the phase", |c| c.phase() == phase);
        }
        cell.trial_mut().peak_n = 0.0;
        cell
    }

    /// A cell that slides for `offset` cycles, with `fault` from the next cycle on.
    fn with(setup: Self::Setup, fault: Self::Fault, offset: u64) -> Self {
        let mut cell = Self::sliding(setup);
        cell.steps(offset);
        assert_eq!(cell.phase(), Phase::Slide);
        cell.trial_mut().faults = vec![fault];
        cell
    }

    /// Asserts that the force has not exceeded its limit.
    fn assert_force(&self, what: &dyn Debug) {
        let (peak_n, most_n) = (self.trial().peak_n, self.most_n());
        assert!(peak_n <= most_n, "{what:?}: {peak_n} N");
    }

    /// Asserts that the tool retracts along the normal and stops.
    fn assert_leaves_the_surface(&mut self, what: &str) {
        self.until("it has left", |c| !c.phase().is_active());
        self.until("it rests", |c| c.robot_speed() < Self::AT_REST);
        assert_eq!(self.truth().wrench.force.norm(), 0.0, "{what}");
        self.assert_force(&what);
    }

    /// Asserts that the arm is at rest within `rest` cycles, and stays so for `after` cycles
    /// without the fault.
    fn assert_stands(&mut self, what: &str, rest: u64, after: u64) {
        self.steps(rest);
        let speed = self.robot_speed();
        assert!(speed < Self::AT_REST, "{what}: {speed} rad/s");
        self.trial_mut().faults.clear();
        self.steps(after);
        assert!(!self.phase().is_active(), "{what}: {:?}", self.phase());
        assert!(self.robot_speed() < Self::AT_REST, "{what}: moves again");
        self.assert_force(&what);
    }

    /// Asserts that the tool slides for `cycles` without a reaction of the task to the fault.
    fn assert_slides_on(&mut self, what: &str, cycles: u64) {
        for cycle in 1..=cycles {
            self.step();
            assert_eq!(self.phase(), Phase::Slide, "{what}, {cycle}");
        }
        self.assert_force(&what);
    }

    /// Asserts that the tool slides for `cycles`, and that the phase is `next` afterwards.
    fn assert_phase_after(&mut self, what: &str, cycles: u64, next: Phase) {
        for cycle in 1..=cycles {
            assert_eq!(self.phase(), Phase::Slide, "{what}, cycle {cycle}");
            self.step();
        }
        assert_eq!(self.phase(), next, "{what}");
    }

    /// Asserts that the tool slides for a number of cycles in `cycles`, and then retracts because
    /// of the wrench.
    fn assert_retracts_within(
        &mut self,
        what: &str,
        cycles: std::ops::RangeInclusive<u64>,
        validity: Validity,
    ) {
        let (least, most) = cycles.into_inner();
        for cycle in 1..least {
            self.step();
            assert_eq!(self.phase(), Phase::Slide, "{what}, cycle {cycle}");
        }
        self.step();
        for _ in least..most {
            if self.phase() == Phase::Slide {
                self.step();
            }
        }
        assert_eq!(self.phase(), Phase::Retract, "{what}");
        assert_eq!(
            self.task_fault(),
            Some(TaskFault::Wrench(validity)),
            "{what}"
        );
    }

    /// Asserts that the tool slides for `cycles`, and then retracts because of the wrench.
    fn assert_retracts_for(&mut self, what: &str, cycles: u64, validity: Validity) {
        self.assert_phase_after(what, cycles, Phase::Retract);
        assert_eq!(
            self.task_fault(),
            Some(TaskFault::Wrench(validity)),
            "{what}"
        );
    }

    /// Number of cycles until the phase changes.
    fn cycles_of_phase(&mut self, phase: Phase) -> u64 {
        let begun = self.trial().cycle;
        self.until("another phase", |c| c.phase() != phase);
        self.trial().cycle - begun
    }

    /// Asserts that the path stops within these cycles, and that the tool retracts `patience`
    /// cycles later, up to one cycle.
    fn assert_stops_then_retracts(
        &mut self,
        what: &str,
        stops: RangeInclusive<u64>,
        patience: u64,
    ) {
        let stopped = self.cycles_of_phase(Phase::Slide);
        assert_eq!(self.phase(), Phase::Hold, "{what}");
        // If an age equals the limit, rounding decides.
        assert!(stops.contains(&stopped), "{what}: {stopped}");
        let waits = self.cycles_of_phase(Phase::Hold);
        assert_eq!(self.phase(), Phase::Retract, "{what}");
        assert!(waits.abs_diff(patience) <= 1, "{what}: {waits}");
    }

    /// Asserts that the tool seeks a contact that is lost after `cycles`, and continues where the
    /// path stopped when the contact is detected again. Returns that position on the path, 0 to 1.
    fn assert_seeks_after(&mut self, what: &str, cycles: u64) -> f64 {
        self.assert_phase_after(what, cycles, Phase::Seek);
        let progress = self.progress();
        self.trial_mut().faults.clear();
        self.until("it slides again", |c| {
            let slides = c.phase() == Phase::Slide;
            assert!(slides || c.progress() == progress, "{what}");
            slides
        });
        self.assert_force(&what);
        progress
    }
}

/// A second source is refused in each cycle, and the arm moves as without it. `refused`: number of
/// commands that the lease has refused. `given`: the commands to the arm.
pub fn second_source_changes_nothing<C: TableCell, G: Debug + PartialEq>(
    (mut cell, mut alone): (C, C),
    cycles: u64,
    refused: impl Fn(&C) -> u64,
    given: impl Fn(&C) -> G,
) -> C {
    for cycle in 1..=cycles {
        cell.step();
        alone.step();
        assert_eq!(refused(&cell), cycle);
        assert_eq!(given(&cell), given(&alone), "{cycle}");
    }
    cell
}

/// Identity of a publisher of commands.
pub fn source(name: &str, id: u8) -> Source {
    Source {
        name: Name::from(name).unwrap(),
        publisher: [id; 16],
    }
}

/// Each of the first `offsets` cycles of the path, with one of `faults` that have the same expected
/// result.
pub fn shared<F: Copy, const N: usize>(
    offsets: u64,
    faults: [F; N],
) -> impl Iterator<Item = (F, u64)> {
    (0..offsets).map(move |offset| (faults[offset as usize % N], offset))
}

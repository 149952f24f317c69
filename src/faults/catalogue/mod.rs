//! Every fault: what is done, who has to notice it and how soon, and when the arm has to be safe.

mod machine_side;
mod robot_side;
mod sensing_side;

use anyhow::Result;

use super::evidence::Evidence;
use super::private_cell::Layout;
use super::stage::Stage;

/// One cycle of the simulated robot, a CB3, ms.
const CYCLE_MS: f64 = 8.0;
/// From a command of zero to an arm at rest: ramp at the cell's limits from the sliding speed, the
/// robot's own delay, and the cycle in which it is seen, ms.
const STOP_MS: f64 = 120.0;
/// From a command to a joint velocity that can be seen, 3 to 5 cycles of a CB3: what is noticed by
/// the arm's own motion is noticed later by this, ms.
const ARM_MS: f64 = 5.0 * CYCLE_MS;
/// The path slows down from the sliding speed at its own acceleration: 20 mm/s at 0.1 m/s², ms.
const PATH_STOP_MS: f64 = 200.0;
/// A service speaks of itself at least once a second, ms.
const HEALTH_MS: f64 = 1000.0;

/// What has to become of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The tool stops sliding, or leaves the surface, and nothing moves again by itself.
    Ends,
    /// The path stops and goes on when the fault is over.
    Waits,
    /// The task goes on through it.
    GoesOn,
}

impl Outcome {
    /// In `tangent faults --json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ends => "ends",
            Self::Waits => "waits",
            Self::GoesOn => "goes_on",
        }
    }
}

/// One fault.
pub struct Case {
    /// Name on the command line and in the table.
    pub name: &'static str,
    /// What is done.
    pub what: &'static str,
    /// Who has to notice.
    pub notices: &'static str,
    /// Spread over processes as the fault needs it.
    pub layout: Layout,
    /// What has to become of the task.
    pub outcome: Outcome,
    /// Bound on the time until it is noticed, ms; none where it need not be.
    pub noticed_within_ms: Option<f64>,
    /// Lets it happen.
    pub provoke: fn(&mut Stage) -> Result<()>,
    /// It is noticed by the arm's motion, which comes later than what moves it.
    pub by_motion: bool,
    /// From then until the arm is safe, ms.
    pub stop_ms: f64,
    /// When it was first noticed.
    pub noticed: fn(&Evidence, i64) -> Option<i64>,
    /// Ends it.
    pub repair: fn(&mut Stage) -> Result<()>,
    /// How long it is watched, s.
    pub watch_s: f64,
    /// Topic on which this program speaks too, out of the real publisher's count.
    pub impostor: Option<&'static str>,
}

impl Case {
    /// How soon it has to be seen that it was noticed, ms.
    pub fn seen_within_ms(&self) -> Option<f64> {
        let arm_ms = if self.by_motion { ARM_MS } else { 0.0 };
        self.noticed_within_ms.map(|ms| ms + arm_ms)
    }

    /// How soon the arm has to be safe, ms.
    pub fn safe_within_ms(&self) -> Option<f64> {
        match self.outcome {
            Outcome::GoesOn => None,
            _ => self.noticed_within_ms.map(|ms| ms + self.stop_ms),
        }
    }
}

fn case(name: &'static str, what: &'static str, notices: &'static str) -> Case {
    Case {
        name,
        what,
        notices,
        layout: Layout::Composed,
        outcome: Outcome::Ends,
        noticed_within_ms: None,
        by_motion: false,
        stop_ms: STOP_MS,
        provoke: |_| Ok(()),
        noticed: |_, _| None,
        repair: |_| Ok(()),
        watch_s: 1.0,
        impostor: None,
    }
}

/// Two cycles, the wrench's allowance for jitter, and the cycle in which it is seen.
const WRENCH_MS: f64 = 3.0 * CYCLE_MS + 4.0;
/// Two held, ramped to zero by the fifth.
const PROGRAM_MS: f64 = 5.0 * CYCLE_MS;
/// The estimate's patience, and the cycle in which it is seen.
const ESTIMATE_MS: f64 = 100.0 + CYCLE_MS;
/// The bridge's patience with the controller, and the cycle in which it is seen.
const COMMAND_MS: f64 = 3.0 * CYCLE_MS;
/// A packet of the robot that says so, and the controller's or bridge's answer.
const PACKET_MS: f64 = 2.0 * CYCLE_MS;
/// Two cycles of records that repeat: what noise cannot do by chance.
const FROZEN_MS: f64 = 2.0 * CYCLE_MS;
/// The sensor's patience.
const SILENCE_MS: f64 = 50.0;

/// All of them, those that share a layout together.
pub fn catalogue() -> Vec<Case> {
    let mut all = Vec::new();
    all.extend(robot_side::of_the_bridge());
    all.extend(robot_side::of_the_robot());
    all.extend(sensing_side::of_the_sensor());
    all.extend(sensing_side::of_the_estimator());
    all.extend(machine_side::of_the_machine());
    all.extend(robot_side::of_commands());
    all.extend(robot_side::of_the_controller());
    all.extend(sensing_side::of_clocks());
    all.extend(sensing_side::of_the_surface());
    all
}

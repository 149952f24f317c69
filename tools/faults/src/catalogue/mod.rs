//! Every fault: what is done, which service must detect it and how soon, and when the arm must be
//! safe.

mod machine_side;
mod robot_side;
mod sensing_side;

use crate::error::Result;
use crate::evidence::Evidence;
use crate::layout::Layout;
use crate::stage::Stage;

/// One cycle of the simulated robot, a CB3, ms.
const CYCLE_MS: f64 = 8.0;
/// Time from a zero command to an arm at rest, ms: the ramp from the sliding speed at the cell's
/// limits, the robot's own delay, and the cycle in which it is observed.
const STOP_MS: f64 = 120.0;
/// Time from a command to a visible joint velocity, ms: 3 to 5 cycles of a CB3. A detection that is
/// observed through the arm's motion is later by this.
const ARM_MS: f64 = 5.0 * CYCLE_MS;
/// Time in which the path stops at its own deceleration, ms: 20 mm/s at 0.1 m/s².
const PATH_STOP_MS: f64 = 200.0;
/// Longest interval between health messages of a service, ms.
const HEALTH_MS: f64 = 1000.0;

/// Required outcome of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The tool stops sliding, or leaves the surface, and no motion restarts by itself.
    Ends,
    /// The path stops, and continues when the fault is over.
    Waits,
    /// The task continues during the fault.
    GoesOn,
}

impl Outcome {
    /// Name in `tangent faults --json`.
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
    /// Description of what is done.
    pub what: &'static str,
    /// Service that must detect it.
    pub notices: &'static str,
    /// Layout of the processes that the fault needs.
    pub layout: Layout,
    /// Required outcome of the task.
    pub outcome: Outcome,
    /// Bound on the time until detection, ms; `None` if no detection is required.
    pub noticed_within_ms: Option<f64>,
    /// Provokes the fault.
    pub provoke: fn(&mut Stage) -> Result<()>,
    /// The detection is observed through the arm's motion, which lags the command.
    pub by_motion: bool,
    /// Bound on the time from detection until the arm is safe, ms.
    pub stop_ms: f64,
    /// Time of the first detection, ns since the Unix epoch.
    pub noticed: fn(&Evidence, i64) -> Option<i64>,
    /// Ends the fault.
    pub repair: fn(&mut Stage) -> Result<()>,
    /// Time for which the cell is observed, s.
    pub watch_s: f64,
    /// Topic on which this program publishes too. Its messages are excluded from the real
    /// publisher's count.
    pub impostor: Option<&'static str>,
}

impl Case {
    /// Bound on the time until the detection is observed, ms.
    pub fn seen_within_ms(&self) -> Option<f64> {
        let arm_ms = if self.by_motion { ARM_MS } else { 0.0 };
        self.noticed_within_ms.map(|ms| ms + arm_ms)
    }

    /// Bound on the time until the arm is safe, ms.
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

/// Two cycles, the wrench's allowance for jitter, and the cycle in which it is observed, ms.
const WRENCH_MS: f64 = 3.0 * CYCLE_MS + 4.0;
/// The robot program holds the command for two cycles, and has ramped it to zero by the fifth, ms.
const PROGRAM_MS: f64 = 5.0 * CYCLE_MS;
/// Timeout of the estimate, and the cycle in which it is observed, ms.
const ESTIMATE_MS: f64 = 100.0 + CYCLE_MS;
/// The bridge's timeout of the controller, and the cycle in which it is observed, ms.
const COMMAND_MS: f64 = 3.0 * CYCLE_MS;
/// The robot's packet that reports the fault, and the controller's or bridge's answer, ms.
const PACKET_MS: f64 = 2.0 * CYCLE_MS;
/// Two cycles of identical records, which noise cannot produce by chance, ms.
const FROZEN_MS: f64 = 2.0 * CYCLE_MS;
/// The timeout of the sensor's records, ms.
const SILENCE_MS: f64 = 50.0;

/// All faults; those that share a layout follow each other.
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

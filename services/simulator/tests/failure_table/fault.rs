//! Faults of a UR cell.

use crate::table::{TableFault, faults};

faults! {
    /// The bridge's process, which contains the controller, has died: nothing reaches the robot.
    /// Afterwards both restart.
    BridgeDead,
    /// The controller does not answer.
    NoCommand,
    /// The controller's answer is not a number.
    CommandNan,
    /// The controller's answer is beyond the cell's limits.
    CommandFast,
    /// The controller answers a packet of a second ago.
    CommandOld,
    /// A second source sends commands too, in the same cycle and before the controller.
    SecondSource,
    /// No record of the sensor arrives.
    SensorSilent,
    /// The sensor's records are not numbers.
    SensorNan,
    /// A gauge of the sensor is saturated.
    SensorSaturated,
    /// The sensor reports an error.
    SensorError,
    /// The sensor's records continue and repeat the last one before the fault.
    SensorFrozen,
    /// One axis of the records repeats its value, the one along which the tool presses.
    AxisStuck,
    /// The transducer is disconnected: its records are exactly zero counts.
    SensorDead,
    /// One record in four is wrong by 30 N: well-formed, but caused by no load.
    SensorCorrupt,
    /// The sensor's zero has jumped by 1.5 N along the tool, so that it reads less.
    ZeroJumped,
    /// The sensor's service restarts, and no record arrives meanwhile. It keeps the last good zero.
    SensorRestart,
    /// No estimate arrives.
    EstimateSilent,
    /// The measured contact force is zero from now on.
    ContactLost,
    /// The robot stops protectively. Afterwards a person unlocks it, which takes 5 s.
    ProtectiveStop,
    /// The robot's emergency button is pressed. Afterwards a person powers the robot on.
    EmergencyStop,
    /// The robot restarts: its clock and registers are reset, and all connections are closed until
    /// it has started.
    RobotRestart,
}

impl TableFault for Fault {
    const ALL: &'static [Self] = Self::ALL;
    const NO_COMMAND: Self = Self::NoCommand;
    const CONTACT_LOST: Self = Self::ContactLost;

    fn is_tolerated(self) -> bool {
        self == Self::SecondSource
    }
}

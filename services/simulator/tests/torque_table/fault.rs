//! Faults of a torque cell.

use crate::table::{TableFault, faults};

faults! {
    /// The controller does not answer. Afterwards it continues.
    NoCommand,
    /// The controller has died. Afterwards another process takes its place.
    ControllerDead,
    /// The controller's answer is not a number.
    CommandNan,
    /// The controller's answer is beyond the effort limit of a joint.
    CommandStrong,
    /// The controller's answer contains velocities.
    CommandKind,
    /// The controller answers a state of a second ago.
    CommandOld,
    /// The controller's last answer before the fault is repeated in every cycle.
    CommandRepeated,
    /// Two answers of the controller arrive together, the older one last; none in the cycle
    /// between.
    CommandSwapped,
    /// The controller answers a future state.
    CommandAhead,
    /// A second source sends commands too, in the same cycle and before the controller.
    SecondSource,
    /// The arm publishes no state, so that no controller answers.
    StateSilent,
    /// The emergency button of the arm is pressed.
    EmergencyStop,
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
    /// The sensor's service restarts, and no record arrives meanwhile. It keeps the last good zero.
    SensorRestart,
    /// The camera takes no frames.
    CameraDark,
    /// No estimate of the object comes.
    EstimateSilent,
    /// No estimate of the object arrives.
    ContactLost,
}

impl TableFault for Fault {
    const ALL: &'static [Self] = Self::ALL;
    const NO_COMMAND: Self = Self::NoCommand;
    const CONTACT_LOST: Self = Self::ContactLost;

    fn is_tolerated(self) -> bool {
        matches!(self, Self::CommandSwapped | Self::SecondSource)
    }
}

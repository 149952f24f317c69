//! What can be wrong in a torque cell.

/// What is wrong in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The controller does not answer. Afterwards it goes on.
    NoCommand,
    /// The controller is gone. Afterwards another process takes its place.
    ControllerDead,
    /// Its answer is not a number.
    CommandNan,
    /// Its answer is beyond a joint's effort.
    CommandStrong,
    /// Its answer is of velocities.
    CommandKind,
    /// Its answer is to a state of a second ago.
    CommandOld,
    /// Its last answer before the fault comes again in every cycle, and no other.
    CommandRepeated,
    /// Two of its answers come together, the older one last; none in the cycle between.
    CommandSwapped,
    /// Its answer is to a state that has not been yet.
    CommandAhead,
    /// Somebody else commands too, in the same cycle and before it.
    SecondSource,
    /// The arm says no state, so that nobody answers.
    StateSilent,
    /// Its emergency button.
    EmergencyStop,
    /// No record of the sensor comes.
    SensorSilent,
    /// Its records are not numbers.
    SensorNan,
    /// A gauge is at its end.
    SensorSaturated,
    /// It reports an error.
    SensorError,
    /// Its records go on and say what the last one before said.
    SensorFrozen,
    /// One axis of them does, the one that presses.
    AxisStuck,
    /// The sensor's service begins anew, and no record comes while it does. It keeps the last good
    /// zero.
    SensorRestart,
    /// The camera takes no frames.
    CameraDark,
    /// No estimate of the object comes.
    EstimateSilent,
    /// Nothing is felt any more.
    ContactLost,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 22] = [
        Self::NoCommand,
        Self::ControllerDead,
        Self::CommandNan,
        Self::CommandStrong,
        Self::CommandKind,
        Self::CommandOld,
        Self::CommandRepeated,
        Self::CommandSwapped,
        Self::CommandAhead,
        Self::SecondSource,
        Self::StateSilent,
        Self::EmergencyStop,
        Self::SensorSilent,
        Self::SensorNan,
        Self::SensorSaturated,
        Self::SensorError,
        Self::SensorFrozen,
        Self::AxisStuck,
        Self::SensorRestart,
        Self::CameraDark,
        Self::EstimateSilent,
        Self::ContactLost,
    ];

    /// A task goes on through it.
    pub fn is_borne(self) -> bool {
        matches!(self, Self::CommandSwapped | Self::SecondSource)
    }
}

//! What can be wrong in a cell.

/// What is wrong in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The bridge's process is gone, and the controller in it: nothing reaches the robot.
    /// Afterwards both begin anew.
    BridgeDead,
    /// The controller does not answer.
    NoCommand,
    /// Its answer is not a number.
    CommandNan,
    /// Its answer is beyond the cell's limits.
    CommandFast,
    /// Its answer is to a packet of a second ago.
    CommandOld,
    /// Somebody else commands too, in the same cycle and before it.
    SecondSource,
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
    /// The transducer is cut off: its records say zero, to the count.
    SensorDead,
    /// One record in four is off by 30 N: well-formed, and of no load.
    SensorCorrupt,
    /// The sensor's service begins anew, and no record comes while it does. It keeps the last good
    /// zero.
    SensorRestart,
    /// No estimate comes.
    EstimateSilent,
    /// Nothing is felt any more.
    ContactLost,
    /// The robot stops protectively. Afterwards somebody unlocks it, which takes 5 s.
    ProtectiveStop,
    /// Its emergency button. Afterwards somebody powers it on.
    EmergencyStop,
    /// It begins anew: its clock and registers, and every connection is gone until it is up.
    RobotRestart,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 20] = [
        Self::BridgeDead,
        Self::NoCommand,
        Self::CommandNan,
        Self::CommandFast,
        Self::CommandOld,
        Self::SecondSource,
        Self::SensorSilent,
        Self::SensorNan,
        Self::SensorSaturated,
        Self::SensorError,
        Self::SensorFrozen,
        Self::AxisStuck,
        Self::SensorDead,
        Self::SensorCorrupt,
        Self::SensorRestart,
        Self::EstimateSilent,
        Self::ContactLost,
        Self::ProtectiveStop,
        Self::EmergencyStop,
        Self::RobotRestart,
    ];
}

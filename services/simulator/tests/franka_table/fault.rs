//! What can be wrong in a Franka's cell.

/// What is wrong in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The process of bridge and controller is gone, and its connection closed. Afterwards both
    /// begin anew.
    BridgeDead,
    /// That process stands still with its sockets open. Afterwards it goes on with the newest
    /// state.
    BridgeHung,
    /// The controller does not answer. Afterwards it goes on.
    NoCommand,
    /// The controller is gone. Afterwards another process takes its place.
    ControllerDead,
    /// Its answer is not a number.
    CommandNan,
    /// Its answer is beyond what a joint may be asked for.
    CommandStrong,
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
    /// No state of the robot arrives.
    StatesLost,
    /// Every second state is lost.
    StatesThinned,
    /// Each state arrives two cycles late.
    StateLate,
    /// Each state arrives twice.
    StateTwice,
    /// The states' estimate of the wrench is not a number: the whole state is none.
    StateNan,
    /// No answer reaches the robot.
    AnswersLost,
    /// Every second answer is lost.
    AnswersThinned,
    /// The connection is cut. Afterwards it can be had again.
    Disconnected,
    /// The controller hears no wrench any more.
    WrenchSilent,
    /// What it hears is not a number.
    WrenchNan,
    /// It is told that the estimate cannot be used.
    WrenchError,
    /// The robot's estimate stays as it is.
    WrenchFrozen,
    /// The part of it that presses does.
    AxisStuck,
    /// Nothing is felt any more: the estimate lives and says zero.
    ContactLost,
    /// No frame of the depth camera comes.
    CameraDark,
    /// Its normals are not numbers.
    CameraNan,
    /// Its normals are off by a radian, and sure of themselves.
    CameraAskew,
    /// No estimate from touch comes.
    TouchSilent,
    /// Neither comes.
    EstimatesSilent,
    /// Something pushes the tool off the surface with 90 N until the robot stops by its own reflex.
    Collision,
    /// The button of the robot's activation device.
    UserStop,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 32] = [
        Self::BridgeDead,
        Self::BridgeHung,
        Self::NoCommand,
        Self::ControllerDead,
        Self::CommandNan,
        Self::CommandStrong,
        Self::CommandOld,
        Self::CommandRepeated,
        Self::CommandSwapped,
        Self::CommandAhead,
        Self::SecondSource,
        Self::StatesLost,
        Self::StatesThinned,
        Self::StateLate,
        Self::StateTwice,
        Self::StateNan,
        Self::AnswersLost,
        Self::AnswersThinned,
        Self::Disconnected,
        Self::WrenchSilent,
        Self::WrenchNan,
        Self::WrenchError,
        Self::WrenchFrozen,
        Self::AxisStuck,
        Self::ContactLost,
        Self::CameraDark,
        Self::CameraNan,
        Self::CameraAskew,
        Self::TouchSilent,
        Self::EstimatesSilent,
        Self::Collision,
        Self::UserStop,
    ];

    /// A task goes on through it: it is borne, or the other sense stands in.
    pub fn is_borne(self) -> bool {
        matches!(
            self,
            Self::CommandSwapped
                | Self::SecondSource
                | Self::StatesThinned
                | Self::StateTwice
                | Self::AnswersThinned
                | Self::CameraDark
                | Self::CameraNan
                | Self::CameraAskew
                | Self::TouchSilent
        )
    }
}

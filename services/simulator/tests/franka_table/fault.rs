//! Faults of a Franka cell.

use crate::table::{TableFault, faults};

faults! {
    /// The process of bridge and controller has died, and its connection is closed. Afterwards both
    /// restart.
    BridgeDead,
    /// That process hangs with its sockets open. Afterwards it continues with the newest state.
    BridgeHung,
    /// The controller does not answer. Afterwards it continues.
    NoCommand,
    /// The controller has died. Afterwards another process takes its place.
    ControllerDead,
    /// The controller's answer is not a number.
    CommandNan,
    /// The controller's answer is beyond the torque limit of a joint.
    CommandStrong,
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
    /// No state of the robot arrives.
    StatesLost,
    /// Every second state is lost.
    StatesThinned,
    /// Each state arrives two cycles late.
    StateLate,
    /// Each state arrives twice.
    StateTwice,
    /// The wrench estimate in the states is not a number, so the whole state is invalid.
    StateNan,
    /// No answer reaches the robot.
    AnswersLost,
    /// Every second answer is lost.
    AnswersThinned,
    /// The connection is cut. Afterwards the bridge can connect again.
    Disconnected,
    /// The controller receives no wrench.
    WrenchSilent,
    /// The wrench that the controller receives is not a number.
    WrenchNan,
    /// The status that the controller receives marks the estimate as unusable.
    WrenchError,
    /// The robot's estimate keeps its last value.
    WrenchFrozen,
    /// The component of the estimate along which the tool presses keeps its last value.
    AxisStuck,
    /// The measured contact force is zero: the estimate varies around zero.
    ContactLost,
    /// No frame of the depth camera arrives.
    CameraDark,
    /// The camera's normals are not numbers.
    CameraNan,
    /// The camera's normals are wrong by one radian, with a small covariance.
    CameraAskew,
    /// No estimate from touch arrives.
    TouchSilent,
    /// No estimate arrives, neither from touch nor from the camera.
    EstimatesSilent,
    /// An external force of 90 N pushes the tool off the surface until the robot stops by its own
    /// reflex.
    Collision,
    /// The button of the robot's activation device is pressed.
    UserStop,
}

impl TableFault for Fault {
    const ALL: &'static [Self] = Self::ALL;
    const NO_COMMAND: Self = Self::NoCommand;
    const CONTACT_LOST: Self = Self::ContactLost;

    fn is_tolerated(self) -> bool {
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

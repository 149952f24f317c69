//! The session with the robot as a state machine, without sockets and clock. Inputs are replies and
//! states, outputs are requests.
//!
//! It connects, sets the robot up, starts, ends and stops the torque motion, and recovers from a
//! reflex on request. At most one request waits for its reply, apart from the motion's own, whose
//! second reply reports how the motion ended.

use std::collections::VecDeque;
use std::fmt;

use tangent_runtime::health::State;
use tangent_runtime::robot_loop::NotReady;

use crate::fci::{
    Command, ConnectStatus, Deviation, ErrorFlags, MoveController, MoveGenerator, MoveStatus,
    RecoveryStatus, Reply, ReplyBody, Request, RobotMode, RobotState, SetterStatus, VERSION,
};

/// Time after which a reply counts as missing, s. A recovery may take some seconds.
const REPLY_S: f64 = 10.0;
/// Time after which a refused setting or motion is tried again, s.
const RETRY_S: f64 = 1.0;

/// Errors after which the session cannot continue.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The robot uses another protocol version.
    #[error(
        "the robot speaks FCI version {theirs}, this bridge version 5 (Franka Emika Robot with system 4.2 or newer); an \
         FR3 has another version and is not supported"
    )]
    Version {
        /// Version of the robot.
        theirs: u16,
    },
    /// The robot does not answer.
    #[error("the robot has not answered the request to {} for {REPLY_S} s", words(.0))]
    Silent(Command),
    /// The robot refuses a setting.
    #[error(
        "the robot refuses to {}: its values are out of range; see [robot.franka] and [tool]",
        words(.0)
    )]
    Setting(Command),
    /// The robot replied to a request that was not made.
    #[error("the robot answers a request to {}, which was not made", words(.0))]
    Unexpected(Command),
}

/// The name of a command or a status of the protocol in lower-case words, for messages.
fn words(name: &impl fmt::Debug) -> String {
    let mut words = String::new();
    for c in format!("{name:?}").chars() {
        if c.is_ascii_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.push(c.to_ascii_lowercase());
    }
    words
}

/// Why a torque command would not move the arm now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// No connection, or no state yet.
    NoLink,
    /// The robot is receiving its settings.
    SettingUp,
    /// The robot is in a mode in which it cannot be moved.
    Mode(RobotMode),
    /// The robot stopped by itself.
    Reflex(ErrorFlags),
    /// The reflex can be left only by an operator at the robot.
    ManualRecovery(ErrorFlags),
    /// The robot is leaving the reflex.
    Recovering,
    /// The torque motion is starting.
    Starting,
    /// The motion is ending.
    Ending,
    /// The robot refused to start the motion.
    Refused(MoveStatus),
    /// The bridge is shutting down.
    ShuttingDown,
}

impl NotReady for Reason {
    fn service_state(&self) -> State {
        match self {
            Self::NoLink | Self::SettingUp | Self::Starting => State::Starting,
            Self::ShuttingDown => State::Stopping,
            _ => State::Degraded,
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLink => write!(f, "no connection to the robot"),
            Self::SettingUp => write!(f, "the robot is being set up"),
            Self::Mode(mode) => write!(f, "the robot is {mode}"),
            Self::Reflex(errors) if errors.is_empty() => {
                write!(
                    f,
                    "the robot stopped by a reflex; see `tangent robot unlock`"
                )
            }
            Self::Reflex(errors) => {
                write!(
                    f,
                    "the robot stopped by itself ({errors}); see `tangent robot unlock`"
                )
            }
            Self::ManualRecovery(errors) => write!(
                f,
                "the robot stopped by itself ({errors}) and cannot recover automatically: guide it back by hand"
            ),
            Self::Recovering => write!(f, "the robot is recovering"),
            Self::Starting => write!(f, "the torque motion is starting"),
            Self::Ending => write!(f, "the torque motion is ending"),
            Self::Refused(status) => {
                write!(f, "the robot refuses a torque motion ({})", words(status))
            }
            Self::ShuttingDown => write!(f, "the bridge is shutting down"),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    None,
    /// Requested; `started`: the reply that it runs has arrived.
    Asked {
        id: u32,
        started: bool,
    },
    /// The robot's state shows that it runs.
    Running {
        id: u32,
    },
    /// It is ending: by the flag in the answers (`finishing`), or by a stop request.
    Ending {
        id: u32,
        finishing: bool,
    },
}

/// State machine of the session with the robot.
#[derive(Debug)]
pub struct Session {
    settings: Vec<Request>,
    to_set: VecDeque<Request>,
    connected: bool,
    next_id: u32,
    /// Request that waits for its reply, and the time since when it does, s.
    waiting: Option<(u32, Request, f64)>,
    motion: Motion,
    not_before_s: f64,
    refused: Option<MoveStatus>,
    manual: bool,
    mode: RobotMode,
    errors: ErrorFlags,
    recoveries: u64,
    reflexes: u64,
    constraint_violations: u64,
}

impl Session {
    /// A session without a connection. `settings` are sent to the robot before its first motion, in
    /// order.
    pub fn new(settings: Vec<Request>) -> Self {
        Self {
            settings,
            to_set: VecDeque::new(),
            connected: false,
            next_id: 0,
            waiting: None,
            motion: Motion::None,
            not_before_s: 0.0,
            refused: None,
            manual: false,
            mode: RobotMode::Other,
            errors: ErrorFlags::default(),
            recoveries: 0,
            reflexes: 0,
            constraint_violations: 0,
        }
    }

    /// Starts the session on a new TCP connection; the robot is to send its states to `udp_port`.
    pub fn open(&mut self, udp_port: u16, now_s: f64, out: &mut Vec<u8>) {
        self.close();
        self.to_set.extend(self.settings.iter().copied());
        let request = Request::Connect {
            version: VERSION,
            udp_port,
        };
        self.ask(request, now_s, out);
    }

    /// Ends the session, as the connection is gone.
    pub fn close(&mut self) {
        self.to_set.clear();
        self.connected = false;
        self.waiting = None;
        self.motion = Motion::None;
        self.not_before_s = 0.0;
        self.refused = None;
        self.manual = false;
        self.mode = RobotMode::Other;
        self.errors = ErrorFlags::default();
    }

    /// Takes a reply of the robot.
    ///
    /// # Errors
    /// The session cannot continue.
    pub fn reply(&mut self, reply: &Reply, now_s: f64) -> Result<(), SessionError> {
        let motion_id = match self.motion {
            Motion::None => None,
            Motion::Asked { id, .. } | Motion::Running { id } | Motion::Ending { id, .. } => {
                Some(id)
            }
        };
        if reply.command == Command::Move && motion_id == Some(reply.id) {
            self.motion_reply(reply, now_s);
            return Ok(());
        }
        let Some((_, request, _)) = self
            .waiting
            .take_if(|(id, request, _)| *id == reply.id && request.command() == reply.command)
        else {
            // A motion that has ended may still get a reply.
            return if reply.command == Command::Move {
                Ok(())
            } else {
                Err(SessionError::Unexpected(reply.command))
            };
        };
        match &reply.body {
            ReplyBody::Connect(ConnectStatus::Success, theirs) if *theirs == VERSION => {
                self.connected = true;
            }
            ReplyBody::Connect(_, theirs) => {
                return Err(SessionError::Version { theirs: *theirs });
            }
            ReplyBody::Setter(SetterStatus::Success) => {}
            ReplyBody::Setter(SetterStatus::InvalidArgument) => {
                return Err(SessionError::Setting(reply.command));
            }
            ReplyBody::Setter(SetterStatus::NotPossible) => {
                self.to_set.push_front(request);
                self.not_before_s = now_s + RETRY_S;
            }
            ReplyBody::Recovery(status) => {
                self.manual = *status == RecoveryStatus::ManualRecoveryRequired;
                if *status == RecoveryStatus::Success {
                    self.recoveries += 1;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Takes a state of the robot. `wanted`: a controller sends commands, so the torque motion is
    /// to run.
    pub fn state(&mut self, state: &RobotState, wanted: bool, now_s: f64, out: &mut Vec<u8>) {
        let before = self.mode;
        self.mode = state.mode();
        self.errors = if state.reflex_reason.is_empty() {
            state.errors
        } else {
            state.reflex_reason
        };
        if self.mode == RobotMode::Reflex && before != RobotMode::Reflex {
            self.reflexes += 1;
            if self.errors.0[ErrorFlags::COMMUNICATION_CONSTRAINTS] {
                self.constraint_violations += 1;
            }
        }
        if self.mode != RobotMode::Reflex {
            self.manual = false;
        }
        if let Motion::Asked { id, started: true } = self.motion
            && state.in_torque_motion()
        {
            self.motion = Motion::Running { id };
            self.refused = None;
        }
        if !self.connected || self.waiting.is_some() || now_s < self.not_before_s {
            return;
        }
        if self.mode != RobotMode::Idle || self.motion != Motion::None {
            return;
        }
        if let Some(setting) = self.to_set.pop_front() {
            self.ask(setting, now_s, out);
        } else if wanted {
            let id = self.next_id;
            let request = Request::Move {
                controller: MoveController::External,
                generator: MoveGenerator::JointVelocity,
                path_deviation: Deviation::WIDE,
                goal_deviation: Deviation::WIDE,
            };
            request.encode(id, out);
            self.next_id = self.next_id.wrapping_add(1);
            self.motion = Motion::Asked { id, started: false };
            self.waiting = Some((id, request, now_s));
        }
    }

    /// Checks whether a reply is overdue.
    ///
    /// # Errors
    /// A reply is overdue.
    pub fn check(&self, now_s: f64) -> Result<(), SessionError> {
        match &self.waiting {
            Some((_, request, since_s)) if now_s - since_s > REPLY_S => {
                Err(SessionError::Silent(request.command()))
            }
            _ => Ok(()),
        }
    }

    /// Requests to leave a reflex, if there is one. Returns whether the request was sent.
    pub fn recover(&mut self, now_s: f64, out: &mut Vec<u8>) -> bool {
        let can = self.connected
            && self.waiting.is_none()
            && self.mode == RobotMode::Reflex
            && self.motion == Motion::None;
        if can {
            self.ask(Request::AutomaticErrorRecovery, now_s, out);
        }
        can
    }

    /// Has the robot end the motion by itself, now.
    pub fn stop(&mut self, now_s: f64, out: &mut Vec<u8>) {
        if let Motion::Running { id } = self.motion
            && self.waiting.is_none()
        {
            self.ask(Request::StopMove, now_s, out);
            self.motion = Motion::Ending {
                id,
                finishing: false,
            };
        }
    }

    /// From now on the answers ask the robot to end the motion.
    pub fn finish(&mut self) {
        if let Motion::Running { id } = self.motion {
            self.motion = Motion::Ending {
                id,
                finishing: true,
            };
        }
    }

    /// Whether the torque motion runs and each state is answered with torques.
    pub fn is_running(&self) -> bool {
        matches!(self.motion, Motion::Running { .. })
    }

    /// Whether the motion is ending by the flag in the answers, which are still sent.
    pub fn is_finishing(&self) -> bool {
        matches!(
            self.motion,
            Motion::Ending {
                finishing: true,
                ..
            }
        )
    }

    /// Whether no motion runs or is requested.
    pub fn is_at_rest(&self) -> bool {
        self.motion == Motion::None
    }

    /// Whether the robot has accepted the connection.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    /// Why a torque command would not move the arm now; `None` if it would. `wanted` as for
    /// [`Session::state`].
    pub fn reason(&self, wanted: bool) -> Option<Reason> {
        if !self.connected {
            return Some(Reason::NoLink);
        }
        if let Some((_, Request::AutomaticErrorRecovery, _)) = self.waiting {
            return Some(Reason::Recovering);
        }
        match self.mode {
            RobotMode::Reflex if self.manual => Some(Reason::ManualRecovery(self.errors)),
            RobotMode::Reflex => Some(Reason::Reflex(self.errors)),
            RobotMode::AutomaticErrorRecovery => Some(Reason::Recovering),
            RobotMode::Idle | RobotMode::Move => match self.motion {
                Motion::Running { .. } => None,
                Motion::Ending { .. } => Some(Reason::Ending),
                Motion::Asked { .. } => Some(Reason::Starting),
                Motion::None if self.is_setting_up() => Some(Reason::SettingUp),
                Motion::None => match self.refused {
                    Some(status) => Some(Reason::Refused(status)),
                    None if self.mode == RobotMode::Move => Some(Reason::Mode(self.mode)),
                    None => wanted.then_some(Reason::Starting),
                },
            },
            mode => Some(Reason::Mode(mode)),
        }
    }

    /// Number of reflexes that were left on request, since the start.
    pub fn recoveries(&self) -> u64 {
        self.recoveries
    }

    /// Number of reflexes since the start.
    pub fn reflexes(&self) -> u64 {
        self.reflexes
    }

    /// Number of reflexes since the start that were due to late or missing answers.
    pub fn constraint_violations(&self) -> u64 {
        self.constraint_violations
    }

    fn is_setting_up(&self) -> bool {
        !self.to_set.is_empty() || self.waiting.is_some()
    }

    fn ask(&mut self, request: Request, now_s: f64, out: &mut Vec<u8>) {
        request.encode(self.next_id, out);
        self.waiting = Some((self.next_id, request, now_s));
        self.next_id = self.next_id.wrapping_add(1);
    }

    fn motion_reply(&mut self, reply: &Reply, now_s: f64) {
        let ReplyBody::Move(status) = reply.body else {
            return;
        };
        self.waiting
            .take_if(|(id, request, _)| *id == reply.id && request.command() == Command::Move);
        if status == MoveStatus::MotionStarted {
            if let Motion::Asked { id, .. } = self.motion {
                self.motion = Motion::Asked { id, started: true };
            }
            return;
        }
        if matches!(self.motion, Motion::Asked { started: false, .. }) {
            self.refused = Some(status);
            self.not_before_s = now_s + RETRY_S;
        }
        self.motion = Motion::None;
    }
}

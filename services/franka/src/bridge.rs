//! The bridge as a state machine. Inputs are states and replies of the robot, commands of the
//! controller, and the time; outputs are bytes for the robot. It owns the session, the gate, the
//! lease and the counters.
//!
//! The cycle is: [`Bridge::state`] takes a state, the caller publishes it, and [`Bridge::command`]
//! writes the answer. Neither allocates while a motion runs.
//!
//! The torque motion runs while a controller sends commands, whether the arm moves or not. A task
//! therefore starts without waiting for a motion, and between tasks the arm is held. Without a
//! controller the motion ends, and the robot holds itself.

use nalgebra::Vector3;
use tangent_actuation::Command;
use tangent_actuation::lease::{Lease, LeaseDecision, Source};
use tangent_actuation::torque::{Permission, Posture, TorqueGate, TorqueLimits};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::fci::{PERIOD_S, Reply, Request, RobotCommand, RobotState};
use crate::session::{Reason, Session, SessionError};

/// Time without commands after which the controller counts as gone, s.
const COMMANDER_GONE_S: f64 = 1.0;
/// Joint speed below which the arm counts as at rest, rad/s: the measured speed of a real arm is
/// never exactly zero.
const AT_REST_RAD_PER_S: f64 = 0.02;
/// Time allowed at shutdown for the arm to come to rest, s.
const REST_S: f64 = 2.0;
/// Time allowed at shutdown for the motion to end, s.
const END_S: f64 = 2.0;

/// Configuration of the bridge. It learns everything else from the robot.
#[derive(Clone, Debug)]
pub struct BridgeConfig {
    /// Settings to send to the robot before its first motion.
    pub settings: Vec<Request>,
    /// Limits of the gate.
    pub limits: TorqueLimits<7>,
}

/// Errors after which the connection cannot continue.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BridgeError {
    /// A reply of the robot, or a missing one, ends the session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A state has a value that is not finite or not plausible.
    #[error("the robot sends a value that is not finite or not possible")]
    NotFinite,
    /// The robot's message counter went back.
    #[error("the robot's counter went from {before} to {now}: it was restarted")]
    Restarted {
        /// Counter of the last message.
        before: u64,
        /// Counter of this message.
        now: u64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Shutdown {
    No,
    ToRest { since_s: f64 },
    ToEnd { since_s: f64 },
    Done,
}

/// The bridge as a state machine, without sockets and clock.
#[derive(Debug)]
pub struct Bridge {
    session: Session,
    gate: TorqueGate<7>,
    lease: Lease,
    state: RobotState,
    has_state: bool,
    cycle: u64,
    packets_lost: u64,
    heard_s: Option<f64>,
    /// Activation for which the robot was asked to leave a reflex; kept for the motion that
    /// follows.
    recovering_for: Option<u64>,
    recover_asked: bool,
    stop_asked: bool,
    shutdown: Shutdown,
    sent: Option<(Joints<7>, f64)>,
    latency_s: Option<f64>,
}

impl Bridge {
    /// A bridge without a connection.
    pub fn new(config: BridgeConfig) -> Self {
        Self {
            session: Session::new(config.settings),
            gate: TorqueGate::new(config.limits, PERIOD_S),
            lease: Lease::default(),
            state: RobotState::default(),
            has_state: false,
            cycle: 0,
            packets_lost: 0,
            heard_s: None,
            recovering_for: None,
            recover_asked: false,
            stop_asked: false,
            shutdown: Shutdown::No,
            sent: None,
            latency_s: None,
        }
    }

    /// Starts a session on a new TCP connection; the robot sends its states to `udp_port`.
    pub fn open(&mut self, udp_port: u16, now_s: f64, tcp: &mut Vec<u8>) {
        self.close();
        self.session.open(udp_port, now_s, tcp);
    }

    /// Ends the session, as the connection is lost or given up. The current activation and all
    /// older ones are rejected from now on.
    pub fn close(&mut self) {
        self.session.close();
        self.gate.admission.latch();
        self.has_state = false;
        self.recovering_for = None;
        self.recover_asked = false;
        self.stop_asked = false;
        self.sent = None;
        if self.shutdown != Shutdown::No {
            self.shutdown = Shutdown::Done;
        }
    }

    /// Takes a reply of the robot.
    ///
    /// # Errors
    /// The session cannot continue.
    pub fn reply(&mut self, reply: &Reply, now_s: f64) -> Result<(), BridgeError> {
        Ok(self.session.reply(reply, now_s)?)
    }

    /// Takes a state of the robot, received after `skipped` older ones that were discarded. Returns
    /// false for a state that is not newer than the last; it must not be answered.
    ///
    /// # Errors
    /// The connection cannot continue.
    pub fn state(
        &mut self,
        state: &RobotState,
        skipped: u64,
        now_s: f64,
        tcp: &mut Vec<u8>,
    ) -> Result<bool, BridgeError> {
        if !state.is_usable() {
            return Err(BridgeError::NotFinite);
        }
        if self.has_state {
            let (before, now) = (self.state.message_id, state.message_id);
            if now.saturating_add(1000) < before {
                return Err(BridgeError::Restarted { before, now });
            }
            if now <= before {
                return Ok(false);
            }
            let lost = (now - before - 1).saturating_sub(skipped);
            self.packets_lost = self.packets_lost.saturating_add(lost);
        }
        self.measure_latency(state, now_s);
        self.cycle += 1;
        self.state = *state;
        self.has_state = true;
        if std::mem::take(&mut self.stop_asked) {
            self.session.stop(now_s, tcp);
        }
        if std::mem::take(&mut self.recover_asked) {
            self.session.recover(now_s, tcp);
        }
        let wanted = self.is_wanted(now_s);
        if !wanted
            && self.session.is_running()
            && !self.gate.admission.is_commanded()
            && self.rests()
        {
            self.session.finish();
        }
        self.session.state(state, wanted, now_s, tcp);
        self.session.check(now_s)?;
        if self.gate.admission.is_commanded()
            && !(self.session.is_running() && state.in_torque_motion())
        {
            // The activation that moved the arm when its motion ended is rejected at once.
            // Otherwise that task would request the recovery.
            self.gate.admission.latch();
        }
        self.advance_shutdown(now_s);
        Ok(true)
    }

    /// Whether a command from `source` may be passed to [`Bridge::command`]: only one source at a
    /// time commands the arm. When the lease changes hands, `activation` of the new source and all
    /// older ones are rejected, so that a task has to be started again.
    pub fn admit(&mut self, source: &Source, activation: u64, now_s: f64) -> bool {
        let rests = !self.gate.admission.is_commanded() && self.rests();
        let admission = self.lease.admit(source, now_s, rests);
        if admission == LeaseDecision::Taken {
            self.gate.admission.change_hands(activation);
            self.recovering_for = None;
        }
        if admission != LeaseDecision::Refused {
            self.heard_s = Some(now_s);
        }
        admission != LeaseDecision::Refused
    }

    /// Writes the answer to the last state into `udp`, if that state is to be answered. `posture`
    /// is of that state; `arrived` is a command that was not passed before.
    pub fn command(
        &mut self,
        posture: &Posture<7>,
        arrived: Option<&Command<'_>>,
        now_s: f64,
        tcp: &mut Vec<u8>,
        udp: &mut Vec<u8>,
    ) {
        let running = self.session.is_running();
        let finishing = self.session.is_finishing();
        let permission = match (running, finishing, self.shutdown) {
            (true, _, Shutdown::No) => Permission::Move,
            (true, ..) | (_, true, _) => Permission::Hold,
            _ => Permission::Off,
        };
        if running {
            self.recovering_for = None;
        }
        let arrived = arrived.filter(|wanted| !self.waits_for_recovery(wanted, now_s, tcp));
        let allowed = self.gate.step(self.cycle, permission, posture, arrived);
        if allowed.soft_stop {
            self.session.stop(now_s, tcp);
            return;
        }
        if permission == Permission::Off {
            return;
        }
        let answer = RobotCommand::torque(
            self.state.message_id,
            allowed.torque.into(),
            self.session.is_finishing(),
        );
        answer.encode(udp);
        self.sent = Some((allowed.torque, now_s));
    }

    /// Requests to leave a reflex, on behalf of an operator.
    pub fn recover(&mut self) {
        self.recover_asked = true;
    }

    /// Has the robot end the motion by itself. The arm moves again only for a newer activation.
    pub fn stop(&mut self) {
        self.gate.admission.latch();
        self.stop_asked = true;
    }

    /// Begins the orderly shutdown: hold the arm, then end the motion.
    pub fn end(&mut self, now_s: f64) {
        if self.shutdown == Shutdown::No {
            self.shutdown = if self.session.is_at_rest() {
                Shutdown::Done
            } else {
                Shutdown::ToRest { since_s: now_s }
            };
        }
    }

    /// Whether the orderly shutdown is complete.
    pub fn is_finished(&self) -> bool {
        self.shutdown == Shutdown::Done
    }

    /// The last state; meaningful after the first [`Bridge::state`].
    pub fn robot(&self) -> &RobotState {
        &self.state
    }

    /// Number of states received from the robot since the bridge started.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Number of states lost since the start, by the robot's message counter.
    pub fn packets_lost(&self) -> u64 {
        self.packets_lost
    }

    /// Time from sending a torque until the robot reports it in use, s; `None` if the last state
    /// does not show it.
    pub fn latency_s(&self) -> Option<f64> {
        self.latency_s
    }

    /// The gate with its counters.
    pub fn gate(&self) -> &TorqueGate<7> {
        &self.gate
    }

    /// The lease: which source commands the arm.
    pub fn lease(&self) -> &Lease {
        &self.lease
    }

    /// The session with the robot.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Why a command with a new activation would not move the arm now.
    pub fn reason(&self, now_s: f64) -> Option<Reason> {
        if !self.has_state {
            Some(Reason::NoLink)
        } else if self.shutdown != Shutdown::No {
            Some(Reason::ShuttingDown)
        } else {
            self.session.reason(self.is_wanted(now_s))
        }
    }

    fn is_wanted(&self, now_s: f64) -> bool {
        self.shutdown == Shutdown::No
            && self
                .heard_s
                .is_some_and(|heard_s| now_s - heard_s <= COMMANDER_GONE_S)
    }

    fn rests(&self) -> bool {
        self.state.dq.iter().all(|v| v.abs() < AT_REST_RAD_PER_S)
    }

    /// Handles a torque command with a new activation while the robot is in a reflex: asks the
    /// robot once to leave it, and keeps the activation for the motion that follows. Returns false
    /// for a command that goes to the gate.
    fn waits_for_recovery(&mut self, wanted: &Command<'_>, now_s: f64, tcp: &mut Vec<u8>) -> bool {
        if wanted.kind != CommandKind::JointTorque.number() || self.shutdown != Shutdown::No {
            return false;
        }
        if self.recovering_for == Some(wanted.activation) {
            return matches!(
                self.session.reason(true),
                Some(Reason::Recovering | Reason::Starting | Reason::Mode(_) | Reason::Reflex(_))
            );
        }
        let fresh = wanted.activation > self.gate.admission.activation_latched();
        let reflex = matches!(self.session.reason(true), Some(Reason::Reflex(_)));
        if fresh && reflex && self.session.recover(now_s, tcp) {
            self.recovering_for = Some(wanted.activation);
            return true;
        }
        false
    }

    fn measure_latency(&mut self, state: &RobotState, now_s: f64) {
        self.latency_s = self
            .sent
            .filter(|(torque, _)| *torque == Joints::from(state.tau_j_d))
            .map(|(_, sent_s)| now_s - sent_s);
        if self.latency_s.is_some() {
            self.sent = None;
        }
    }

    fn advance_shutdown(&mut self, now_s: f64) {
        match self.shutdown {
            Shutdown::No | Shutdown::Done => {}
            Shutdown::ToRest { since_s } => {
                if self.session.is_at_rest() {
                    self.shutdown = Shutdown::Done;
                } else if self.rests() || now_s - since_s > REST_S {
                    self.session.finish();
                    self.shutdown = Shutdown::ToEnd { since_s: now_s };
                }
            }
            Shutdown::ToEnd { since_s } => {
                if self.session.is_at_rest() || now_s - since_s > END_S {
                    self.shutdown = Shutdown::Done;
                }
            }
        }
    }
}

/// Posture from a state; tool position and Jacobian come from the caller's model.
pub fn posture_of(
    state: &RobotState,
    tool_m: Vector3<f64>,
    tool_jacobian: nalgebra::SMatrix<f64, 6, 7>,
) -> Posture<7> {
    Posture {
        q: Joints::from(state.q),
        qd: Joints::from(state.dq),
        torque: Joints::from(state.tau_j_d),
        tool_m,
        tool_jacobian,
    }
}

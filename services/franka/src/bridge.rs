//! The bridge as a state machine: states and replies of the robot and commands of the controller go in with the time, bytes
//! for the robot come out. It owns the session, the guard, the lease and the counters.
//!
//! The cycle is: [`Bridge::state`] takes a state, the caller publishes it, and [`Bridge::command`] writes the answer. Neither
//! allocates while a motion runs.
//!
//! The torque motion runs while somebody commands, moving the arm or not: so a task starts without the wait for a motion, and
//! between tasks the arm is held. With nobody there the motion ends, and the robot holds itself.

use nalgebra::Vector3;
use tangent_mechanics::Joints;
use tangent_runtime::lease::{Admission, Lease, Source};

use crate::fci::{PERIOD_S, Reply, Request, RobotCommand, RobotState};
use crate::guard::{Guard, GuardLimits, Permission, Posture, Wanted};
use crate::session::{Reason, Session, SessionError};

/// A commander that says nothing for so long has gone, s.
const COMMANDER_GONE_S: f64 = 1.0;
/// Below this joint speed the arm rests, rad/s: a real arm's measured speed is never quite zero.
const AT_REST_RAD_PER_S: f64 = 0.02;
/// At shutdown so long is waited for the arm to rest, s.
const REST_S: f64 = 2.0;
/// And so long for the motion's end, s.
const END_S: f64 = 2.0;

/// What the bridge has to know; everything else it learns from the robot.
#[derive(Clone, Debug)]
pub struct BridgeConfig {
    /// What the robot is set to before its first motion.
    pub settings: Vec<Request>,
    /// For the guard.
    pub limits: GuardLimits,
}

/// A robot that cannot be gone on with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BridgeError {
    /// What it answers.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A state with a value that is not a number.
    #[error("the robot sends a value that is no finite number, or that no arm has")]
    NotFinite,
    /// Its clock went back.
    #[error("the robot counts anew (from {before} to {now}): it was restarted")]
    Restarted {
        /// Last message.
        before: u64,
        /// This one.
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

/// See the module.
#[derive(Debug)]
pub struct Bridge {
    session: Session,
    guard: Guard,
    lease: Lease,
    state: RobotState,
    has_state: bool,
    cycle: u64,
    packets_lost: u64,
    heard_s: Option<f64>,
    /// The activation that asked the robot to leave its reflex: kept for the motion after it.
    recovering_for: Option<u64>,
    recover_asked: bool,
    stop_asked: bool,
    shutdown: Shutdown,
    sent: Option<(Joints<7>, f64)>,
    latency_s: Option<f64>,
}

impl Bridge {
    /// Not connected.
    pub fn new(config: BridgeConfig) -> Self {
        Self {
            session: Session::new(config.settings),
            guard: Guard::new(config.limits, PERIOD_S),
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

    /// The TCP connection is made; states come to `udp_port`.
    pub fn open(&mut self, udp_port: u16, now_s: f64, tcp: &mut Vec<u8>) {
        self.close();
        self.session.open(udp_port, now_s, tcp);
    }

    /// The connection is gone, or is given up. Whatever was commanded is latched out.
    pub fn close(&mut self) {
        self.session.close();
        self.guard.latch();
        self.has_state = false;
        self.recovering_for = None;
        self.recover_asked = false;
        self.stop_asked = false;
        self.sent = None;
        if self.shutdown != Shutdown::No {
            self.shutdown = Shutdown::Done;
        }
    }

    /// A reply came.
    ///
    /// # Errors
    /// The conversation cannot go on.
    pub fn reply(&mut self, reply: &Reply, now_s: f64) -> Result<(), BridgeError> {
        Ok(self.session.reply(reply, now_s)?)
    }

    /// A state came, after `skipped` others that it made old. False when it is older than one before, which is not to be
    /// answered.
    ///
    /// # Errors
    /// It cannot be gone on with.
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
        if !wanted && self.session.is_running() && !self.guard.is_commanded() && self.rests() {
            self.session.finish();
        }
        self.session.state(state, wanted, now_s, tcp);
        self.session.check(now_s)?;
        if self.guard.is_commanded() && !(self.session.is_running() && state.in_torque_motion()) {
            // Whoever moved the arm when its motion ended starts anew: at once, or that task would ask for the recovery.
            self.guard.latch();
        }
        self.advance_shutdown(now_s);
        Ok(true)
    }

    /// Whether a command from `source` may be given to [`Bridge::command`]: only one source at a time commands the arm.
    /// `activation`: what it brings; a source that was not heard before has to start a task anew.
    pub fn admit(&mut self, source: &Source, activation: u64, now_s: f64) -> bool {
        let rests = !self.guard.is_commanded() && self.rests();
        let admission = self.lease.admit(source, now_s, rests);
        if admission == Admission::Taken {
            self.guard.change_hands(activation);
            self.recovering_for = None;
        }
        if admission != Admission::Refused {
            self.heard_s = Some(now_s);
        }
        admission != Admission::Refused
    }

    /// Writes the answer to the last state into `udp`, if it is to be answered. `posture`: of that state. `arrived`: a command
    /// not given before.
    pub fn command(
        &mut self,
        posture: &Posture,
        arrived: Option<&Wanted<'_>>,
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
        let allowed = self.guard.step(self.cycle, permission, posture, arrived);
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

    /// A person asks to leave a reflex.
    pub fn recover(&mut self) {
        self.recover_asked = true;
    }

    /// The robot ends the motion by itself; moving needs a newer activation.
    pub fn stop(&mut self) {
        self.guard.latch();
        self.stop_asked = true;
    }

    /// Begins the orderly end: hold, end the motion.
    pub fn end(&mut self, now_s: f64) {
        if self.shutdown == Shutdown::No {
            self.shutdown = if self.session.is_at_rest() {
                Shutdown::Done
            } else {
                Shutdown::ToRest { since_s: now_s }
            };
        }
    }

    /// The orderly end is done.
    pub fn is_finished(&self) -> bool {
        self.shutdown == Shutdown::Done
    }

    /// The last state; meaningful after the first [`Bridge::state`].
    pub fn robot(&self) -> &RobotState {
        &self.state
    }

    /// States of the robot since the bridge started.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// States lost since the start, by the robot's own count.
    pub fn packets_lost(&self) -> u64 {
        self.packets_lost
    }

    /// From sending a torque to the robot's word that it goes by it, s; `None` where the last state says nothing new.
    pub fn latency_s(&self) -> Option<f64> {
        self.latency_s
    }

    /// The guard with its counters.
    pub fn guard(&self) -> &Guard {
        &self.guard
    }

    /// Who commands.
    pub fn lease(&self) -> &Lease {
        &self.lease
    }

    /// The conversation with the robot.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Why a command of a fresh activation would not move the arm now.
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

    /// A torque of a fresh activation in front of a reflex: the robot is asked to leave it, once, and the activation is kept for
    /// the motion that follows. Everything else that does not move the arm goes to the guard.
    fn waits_for_recovery(&mut self, wanted: &Wanted<'_>, now_s: f64, tcp: &mut Vec<u8>) -> bool {
        if wanted.kind != 2 || self.shutdown != Shutdown::No {
            return false;
        }
        if self.recovering_for == Some(wanted.activation) {
            return matches!(
                self.session.reason(true),
                Some(Reason::Recovering | Reason::Starting | Reason::Mode(_) | Reason::Reflex(_))
            );
        }
        let fresh = wanted.activation > self.guard.activation_latched();
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

impl Posture {
    /// Of a state; tool pose and Jacobian come from the caller's model.
    pub fn of(
        state: &RobotState,
        tool_m: Vector3<f64>,
        tool_jacobian: nalgebra::SMatrix<f64, 6, 7>,
    ) -> Self {
        Self {
            q: Joints::from(state.q),
            qd: Joints::from(state.dq),
            torque: Joints::from(state.tau_j_d),
            tool_m,
            tool_jacobian,
        }
    }
}

//! Supervises the robot and the bridge's program on it: what runs there, whether it is alive,
//! whether the arm may move, and when the program has to be sent again.
//!
//! A connection does not imply that the arm can move: the socket stays open while the program is
//! dead, replaced or paused. Presence (identity and session), liveness (its loop counter advances)
//! and readiness are therefore distinguished, each with its reason.

use tangent_actuation::velocity::Permission;
use tangent_schemas::arm_modes::{ROBOT_RUNNING, RUNTIME_PLAYING, RUNTIME_STOPPED};

use crate::program::{self, ProgramState};
use crate::reason::Reason;
use crate::sample::Sample;
use crate::status::safety_allows_motion;

/// Number of states for which the program's loop counter may stay unchanged.
const STUCK_CYCLES: u32 = 5;
/// Time that a program may take to become ready after it was sent, s.
const START_S: f64 = 4.0;
/// Time for which a program may hang before it is given up, s.
const HUNG_S: f64 = 2.0;
/// Time after a safety stop within which a program must continue by itself; otherwise it counts as
/// dead, s.
const HALTED_S: f64 = 1.0;
/// Pause after the program has ended, and longest pause between attempts to start it, which doubles
/// with each failure, s.
const RETRY_S: (f64, f64) = (1.0, 16.0);

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Not present, and not sent.
    Absent,
    /// Sent, not ready yet.
    Starting { since_s: f64 },
    /// It was ready with the current session.
    Running,
}

/// Supervisor of the robot and of the bridge's program on it.
#[derive(Clone, Debug)]
pub struct Supervisor {
    scaling_min: f64,
    stage: Stage,
    session: i32,
    random: u64,
    attempts: u32,
    next_attempt_s: f64,
    /// Reason for which `rtde/reset` is needed before the program is sent or re-armed.
    reset_needed: Option<Reason>,
    take_over: bool,
    wrong_model: bool,
    loops: Option<i32>,
    /// Number of states since the loop counter of a program with our identity last advanced.
    still: u32,
    stuck: u32,
    hung_since_s: Option<f64>,
    safety_stopped: bool,
    halted_since_s: Option<f64>,
    rearm: u32,
    permission: Permission,
    reason: Option<Reason>,
    upload_due: bool,
}

impl Supervisor {
    /// `scaling_min`: smallest speed scaling at which the arm may move. `seed`: for session tokens,
    /// a new one at each start.
    pub fn new(scaling_min: f64, seed: u64) -> Self {
        Self {
            scaling_min,
            stage: Stage::Absent,
            session: 1,
            random: seed | 1,
            attempts: 0,
            next_attempt_s: 0.0,
            reset_needed: None,
            take_over: false,
            wrong_model: false,
            loops: None,
            still: u32::MAX,
            stuck: 0,
            hung_since_s: None,
            safety_stopped: false,
            halted_since_s: None,
            rearm: 0,
            permission: Permission::Off,
            reason: Some(Reason::NoLink),
            upload_due: false,
        }
    }

    /// Resets the state for a lost or new connection: the program has to be sent again, with a new
    /// session.
    pub fn disconnected(&mut self) {
        self.stage = Stage::Absent;
        self.loops = None;
        self.still = u32::MAX;
        self.permission = Permission::Off;
        self.reason = Some(Reason::NoLink);
        self.upload_due = false;
        self.attempts = 0;
        self.next_attempt_s = 0.0;
        self.renew_session();
    }

    /// An operator has acknowledged the cause: the program may be sent again, even in place of
    /// another one, and re-armed.
    pub fn reset(&mut self) {
        self.reset_needed = None;
        self.take_over = true;
        self.attempts = 0;
        self.next_attempt_s = 0.0;
    }

    /// Sets whether the robot is another model than the cell's.
    pub fn set_wrong_model(&mut self, wrong: bool) {
        self.wrong_model = wrong;
    }

    /// Session token: part of every package, and of the program when it is sent.
    pub fn session(&self) -> i32 {
        self.session
    }

    /// True once for each time that the program has to be sent with [`Supervisor::session`].
    pub fn take_upload(&mut self) -> bool {
        std::mem::take(&mut self.upload_due)
    }

    /// Whether the arm may move.
    pub fn permission(&self) -> Permission {
        self.permission
    }

    /// Why the arm may not move; `None` if it may.
    pub fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// Whether the bridge's program is present with the current session, and its loop counter
    /// advances.
    pub fn is_alive(&self) -> bool {
        self.stage == Stage::Running && self.stuck <= STUCK_CYCLES
    }

    /// Whether the bridge's program was seen ready, and has not been replaced or ended since.
    pub fn is_present(&self) -> bool {
        self.stage == Stage::Running
    }

    /// Flag register for the next package. While the program is latched and may be re-armed, the
    /// flag alternates between low and high, as the program has to see it low first.
    pub fn flags(&self) -> i32 {
        i32::from(self.rearm % 16 >= 4)
    }

    /// Takes a state of the robot. `lost` is the number of cycles that the robot's clock skipped.
    pub fn observe(&mut self, sample: &Sample, lost: u64, now_s: f64) {
        let known = program::version(sample.ident).is_some();
        let ours = known && sample.session == self.session;
        let advanced = self.loops.is_some_and(|before| before != sample.loops);
        self.loops = Some(sample.loops);
        self.still = if advanced && known {
            0
        } else {
            self.still.saturating_add(1)
        };
        self.follow(sample, ours, advanced, now_s);
        self.plan_rearm(sample);
        self.plan_upload(sample, now_s);
        (self.permission, self.reason) = self.verdict(sample, lost);
    }

    /// Updates the stage of the program.
    fn follow(&mut self, sample: &Sample, ours: bool, advanced: bool, now_s: f64) {
        match self.stage {
            Stage::Absent => {}
            Stage::Starting { since_s } => {
                let ready = sample.program_state == i32::from(ProgramState::Ready.number());
                if ours && ready && advanced && sample.runtime_state == RUNTIME_PLAYING {
                    self.stage = Stage::Running;
                    self.attempts = 0;
                    self.stuck = 0;
                    self.hung_since_s = None;
                    self.safety_stopped = false;
                    self.halted_since_s = None;
                    self.take_over = false;
                } else if now_s - since_s > START_S {
                    self.give_up(now_s);
                }
            }
            Stage::Running => {
                let exited = sample.program_state == i32::from(ProgramState::Exiting.number());
                if !ours {
                    self.stage = Stage::Absent;
                    self.reset_needed = Some(Reason::Replaced);
                } else if exited || sample.runtime_state == RUNTIME_STOPPED {
                    self.stage = Stage::Absent;
                    self.next_attempt_s = now_s + RETRY_S.0;
                    if matches!(sample.cause, 4 | 5) {
                        self.reset_needed = Some(Reason::ResetNeeded {
                            cause: sample.cause,
                        });
                    }
                } else if self.died_in_a_safety_stop(sample, now_s) {
                    self.stage = Stage::Absent;
                } else {
                    self.watch_loop(sample, advanced, now_s);
                }
            }
        }
    }

    /// Whether a safety stop has left the program paused permanently. After a protective or
    /// safeguard stop the program may continue by itself. If the stop is over and it still does not
    /// run after some time, it is to be replaced by a new one.
    fn died_in_a_safety_stop(&mut self, sample: &Sample, now_s: f64) -> bool {
        let safe = safety_allows_motion(sample.safety_mode) && sample.robot_mode == ROBOT_RUNNING;
        if !safe {
            self.safety_stopped = true;
        }
        if sample.runtime_state == RUNTIME_PLAYING {
            self.safety_stopped &= !safe;
            self.halted_since_s = None;
            return false;
        }
        if !safe || !self.safety_stopped {
            self.halted_since_s = None;
            return false;
        }
        now_s - *self.halted_since_s.get_or_insert(now_s) > HALTED_S
    }

    fn watch_loop(&mut self, sample: &Sample, advanced: bool, now_s: f64) {
        // The program does not count loops during `stopj`, or while it is paused.
        let stopping = sample.program_state == i32::from(ProgramState::Stopping.number());
        if advanced || stopping || sample.runtime_state != RUNTIME_PLAYING {
            self.stuck = 0;
            self.hung_since_s = None;
            return;
        }
        self.stuck = self.stuck.saturating_add(1);
        // A speed slider below 100 % stretches each motion call, so the loop counts more slowly.
        let patience = f64::from(STUCK_CYCLES) / sample.scaling().max(0.05);
        if f64::from(self.stuck) > patience {
            let since = *self.hung_since_s.get_or_insert(now_s);
            if now_s - since > HUNG_S {
                self.hung_since_s = None;
                self.stage = Stage::Absent;
                self.reset_needed = Some(Reason::Hung);
            }
        }
    }

    fn give_up(&mut self, now_s: f64) {
        self.stage = Stage::Absent;
        self.attempts = self.attempts.saturating_add(1);
        let pause = RETRY_S.0 * f64::from(1u32 << self.attempts.min(6));
        self.next_attempt_s = now_s + pause.min(RETRY_S.1);
    }

    /// Determines whether the arm may move, and if not, why.
    fn verdict(&self, sample: &Sample, lost: u64) -> (Permission, Option<Reason>) {
        let off = |reason| (Permission::Off, Some(reason));
        let ramp = |reason| (Permission::RampDown, Some(reason));
        if !safety_allows_motion(sample.safety_mode) {
            return off(Reason::Safety(sample.safety_mode));
        }
        if sample.robot_mode != ROBOT_RUNNING {
            return off(Reason::RobotMode(sample.robot_mode));
        }
        if self.wrong_model {
            return off(Reason::WrongModel);
        }
        if let Some(reason) = self.reset_needed {
            return off(reason);
        }
        match self.stage {
            Stage::Absent if self.attempts > 0 => {
                return off(Reason::NotStarting {
                    attempts: self.attempts,
                });
            }
            Stage::Absent if self.foreign_program_runs(sample) => {
                return off(Reason::OtherProgram);
            }
            Stage::Absent => {
                return off(Reason::Ended {
                    cause: if sample.session == self.session {
                        sample.cause
                    } else {
                        0
                    },
                });
            }
            Stage::Starting { .. } => return off(Reason::Starting),
            Stage::Running => {}
        }
        if sample.runtime_state != RUNTIME_PLAYING {
            return off(Reason::Runtime(sample.runtime_state));
        }
        match ProgramState::from_number(sample.program_state) {
            Some(ProgramState::Ready | ProgramState::Streaming | ProgramState::Guided) => {}
            _ => {
                return off(Reason::Stopped {
                    cause: sample.cause,
                });
            }
        }
        if self.hung_since_s.is_some() {
            return ramp(Reason::Hung);
        }
        if lost >= u64::from(STUCK_CYCLES) {
            return ramp(Reason::Gap { lost });
        }
        let scaling = sample.scaling();
        if scaling < self.scaling_min {
            return ramp(Reason::Scaling { scaling });
        }
        (Permission::Move, None)
    }

    /// Whether a program that is not the bridge's runs. Registers keep their values after the
    /// program that wrote them, so a running program with our identity whose counter stands still
    /// is a different one.
    fn foreign_program_runs(&self, sample: &Sample) -> bool {
        let playing = sample.runtime_state == RUNTIME_PLAYING;
        sample.runtime_state != RUNTIME_STOPPED
            && (program::version(sample.ident).is_none() || playing && self.still > STUCK_CYCLES)
    }

    /// Re-arms a latched program where that is allowed. It then only holds still; motion needs a
    /// newer activation.
    fn plan_rearm(&mut self, sample: &Sample) {
        let latched = self.stage == Stage::Running
            && sample.program_state == i32::from(ProgramState::Stopped.number())
            && sample.runtime_state == RUNTIME_PLAYING
            && safety_allows_motion(sample.safety_mode);
        if latched && matches!(sample.cause, 4 | 5) && !self.take_over {
            self.reset_needed = Some(Reason::ResetNeeded {
                cause: sample.cause,
            });
        }
        if latched && self.reset_needed.is_none() {
            self.rearm = self.rearm.wrapping_add(1);
        } else {
            self.rearm = 0;
            if !latched && self.stage == Stage::Running {
                self.take_over = false;
            }
        }
    }

    /// Marks the program to be sent, if the robot is running, is in no stop, and runs no other
    /// program, or one that may be replaced.
    fn plan_upload(&mut self, sample: &Sample, now_s: f64) {
        let may = self.stage == Stage::Absent
            && self.reset_needed.is_none()
            && !self.wrong_model
            && safety_allows_motion(sample.safety_mode)
            && sample.robot_mode == ROBOT_RUNNING
            && (self.take_over || !self.foreign_program_runs(sample))
            && now_s >= self.next_attempt_s;
        if may {
            self.renew_session();
            self.stage = Stage::Starting { since_s: now_s };
            self.upload_due = true;
        }
    }

    /// Draws a new positive number that differs from the one before: splitmix64 over a counter.
    fn renew_session(&mut self) {
        let before = self.session;
        while self.session == before || self.session == 0 {
            self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut x = self.random;
            x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            self.session = ((x ^ (x >> 31)) & 0x7fff_ffff) as i32;
        }
    }
}

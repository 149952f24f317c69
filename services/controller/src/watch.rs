//! Law-independent reports of a loop: phases, faults, tares, and which source drives the arm.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use tangent_control::{Clearance, EstimatorName, Fault, Phase};
use tangent_runtime::{Counter, Gauge, HealthReporter, State};
use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{Name, Text};
use tangent_sensing::TareGround;

use crate::mailbox::{Mailbox, Note};

/// Distance from the stored position within which a new one is not stored, m. It is a small part of
/// the distance within which a start accepts the stored position.
const KEPT_WITHIN_M: f64 = 0.002;
/// Cosine of the angle to the stored normal, 2 degrees, within which a new one is not stored.
const KEPT_WITHIN_COS: f64 = 0.9994;

/// Time for which the arm may say why it takes no commands after the task has ended for that, s.
const REASON_S: f64 = 0.5;

/// Relation of the controller to the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Nothing to report.
    Well,
    /// Another controller drives the arm.
    Second(Name),
    /// The state of the arm is not usable.
    Unusable,
}

/// Result of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Phase after the cycle.
    pub phase: Phase,
    /// The last fault of the task.
    pub fault: Option<Fault>,
    /// The fault as text; empty if there is none.
    pub fault_text: Text,
    /// Whether a tare is due.
    pub tare_requested: bool,
    /// Whether the tool may touch something.
    pub clearance: Clearance,
    /// Whether the zero in force was taken in contact.
    pub zero_withdrawn: bool,
    /// Another controller that drives the arm.
    pub other: Option<Name>,
}

/// Compares each cycle with the one before and reports changes. Takes no lock and allocates
/// nothing.
pub struct Watch<P> {
    mailbox: Arc<Mailbox<P>>,
    health: Arc<HealthReporter>,
    missed: Counter,
    unusable: Gauge,
    cycle: Option<u64>,
    phase: Phase,
    fault: Option<Fault>,
    /// The fault as text, as last reported.
    text: Text,
    /// Whether a person confirmed before this start that the tool is free: the next tare relies on
    /// it.
    pub said_clear: bool,
    tare: bool,
    /// Why the tare that the task waits for was refused; empty if it was not.
    tare_refused: Text,
    /// When the task ended because the arm takes no commands, s in the robot's time, and why it
    /// does not.
    arm_left: Option<(f64, Text)>,
    withdrawn: bool,
    /// Last stored value of whether the tool may touch something.
    clearance: Option<Clearance>,
    /// Estimator in use, and how often it changed.
    used: Option<(EstimatorName, u32)>,
    said: Option<Standing>,
}

impl<P> Watch<P> {
    /// A watch that reports to the mailbox and the health message.
    pub fn new(mailbox: &Arc<Mailbox<P>>, health: &Arc<HealthReporter>) -> Self {
        Self {
            mailbox: Arc::clone(mailbox),
            health: Arc::clone(health),
            missed: health.missed_cycles(),
            unusable: health.gauge("arm_states_unusable"),
            cycle: None,
            phase: Phase::default(),
            fault: None,
            text: Text::new(),
            said_clear: false,
            tare: false,
            tare_refused: Text::new(),
            arm_left: None,
            withdrawn: false,
            clearance: None,
            used: None,
            said: None,
        }
    }

    /// Counts the robot's packets that did not arrive here.
    pub fn count_missed(&mut self, cycle: u64) {
        if let Some(last) = self.cycle
            && cycle > last
        {
            self.missed.add(cycle - last - 1);
        }
        self.cycle = Some(cycle);
    }

    /// Counts a state of the arm that is not usable and therefore not answered.
    pub fn unusable(&mut self) {
        self.unusable.set(self.unusable.get() + 1.0);
        self.say(Standing::Unusable);
    }

    /// Reports the estimator in use, and the cause of a change.
    pub fn estimator(&mut self, name: EstimatorName, switches: u32, cause: Text) {
        if self.used != Some((name, switches)) {
            self.used = Some((name, switches));
            self.mailbox
                .notes
                .force_push(Note::Estimator(name, cause), drop);
        }
    }

    /// The fault as text. If a tare is missing, the text says why it was refused; if the `arm`
    /// takes no commands, why it does not.
    pub fn fault_text(&mut self, fault: Option<Fault>, text: Text, arm: &ArmState) -> Text {
        if let Some(reason) = self.mailbox.tare_refused.pop() {
            self.tare_refused = reason;
        }
        if fault != Some(Fault::ArmNotReady) {
            self.arm_left = None;
        }
        match fault {
            _ if text.is_empty() => text,
            Some(Fault::NoTare) if !self.tare_refused.is_empty() => {
                cut_format(format_args!("no tare in time: {}", self.tare_refused))
            }
            Some(Fault::ArmNotReady) => {
                let now_s = arm.robot_time_s;
                let (left_s, why) = self.arm_left.get_or_insert((now_s, Text::new()));
                // The robot may name its reason a few cycles later, and others while it recovers.
                let first = (0.0..REASON_S).contains(&(now_s - *left_s));
                if first && !arm.ready && !arm.not_ready_reason.is_empty() {
                    *why = arm.not_ready_reason;
                }
                if why.is_empty() {
                    return text;
                }
                cut_format(format_args!("arm does not take commands: {why}"))
            }
            _ => text,
        }
    }

    /// Reports what has changed, at the end of a cycle.
    pub fn after(&mut self, told: &Told) {
        if told.tare_requested && !self.tare {
            let said = std::mem::take(&mut self.said_clear);
            let ground = if said {
                TareGround::SaidClear
            } else {
                told.clearance.tare_ground()
            };
            self.mailbox.tare_due.force_push(ground, drop);
        }
        self.tare = told.tare_requested;
        if told.zero_withdrawn && !self.withdrawn {
            self.mailbox.withdraw_due.store(true, Ordering::Release);
        }
        self.withdrawn = told.zero_withdrawn;
        self.keep_in_mind(told);
        let anew = told.phase == Phase::Fault && told.fault_text != self.text;
        if told.phase != self.phase || told.fault != self.fault || anew {
            self.mailbox
                .notes
                .force_push(Note::Phase(told.phase, told.fault_text), drop);
            self.phase = told.phase;
            self.fault = told.fault;
            self.text = told.fault_text;
            if told.phase == Phase::Fault {
                self.health.set(State::Fault, told.fault_text);
                self.said = None;
            }
        }
        if told.phase != Phase::Fault {
            self.say(told.other.map_or(Standing::Well, Standing::Second));
        }
        self.mailbox.tick(told.phase);
    }

    /// Stores what must outlast this process. In phases `Tare`, `Clear` and `Travel`, in which the
    /// tool moves off, travels to its start and is tared, the value stored at the start stays: that
    /// it may touch something.
    fn keep_in_mind(&mut self, told: &Told) {
        if told.phase.is_before_approach() {
            self.clearance = None;
            return;
        }
        let near = |a: &Clearance, b: &Clearance| match (a, b) {
            (
                Clearance::Possible {
                    normal: n,
                    position: p,
                },
                Clearance::Possible {
                    normal: m,
                    position: q,
                },
            ) => (p - q).norm() < KEPT_WITHIN_M && n.dot(m) > KEPT_WITHIN_COS,
            _ => a == b,
        };
        if !self
            .clearance
            .is_some_and(|last| near(&last, &told.clearance))
        {
            self.clearance = Some(told.clearance);
            self.mailbox.clearance.force_push(told.clearance, drop);
        }
    }

    fn say(&mut self, standing: Standing) {
        if self.said == Some(standing) {
            return;
        }
        self.said = Some(standing);
        match standing {
            Standing::Well => self.health.running(),
            Standing::Second(other) => self.health.degraded(format_args!(
                "{other} drives the arm; tasks are refused here"
            )),
            Standing::Unusable => self.health.degraded(format_args!(
                "arm/state has no usable pose or joints: is it this cell's arm?"
            )),
        }
    }
}

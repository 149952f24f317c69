//! What every loop tells the others about itself, whatever its law: phases, faults, tares, who drives the arm.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use tangent_control::{Clearance, EstimatorName, Fault, Phase};
use tangent_runtime::{Counter, Gauge, HealthReporter, State};
use tangent_schemas::convert::cut_format;
use tangent_schemas::{Name, Text};

use crate::mailbox::{Mailbox, Note};

/// A place within this of the one kept is not kept anew, m: a small part of the distance within which a start believes it.
const KEPT_WITHIN_M: f64 = 0.002;
/// The same of its normal: 2 degrees.
const KEPT_WITHIN_COS: f64 = 0.9994;

/// How the controller stands towards the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Nothing to say.
    Well,
    /// Another controller has the arm.
    Second(Name),
    /// Its state makes no sense.
    Unusable,
}

/// What a cycle came to.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Phase after it.
    pub phase: Phase,
    /// The last fault of the task, and in words.
    pub fault: Option<Fault>,
    /// Empty when there is none.
    pub fault_text: Text,
    /// A tare is due.
    pub tare_requested: bool,
    /// Whether the tool may touch something.
    pub clearance: Clearance,
    /// The zero in force was taken in contact.
    pub zero_withdrawn: bool,
    /// Who else drives the arm.
    pub other: Option<Name>,
}

/// Compares each cycle with the one before, and speaks of what is new. Takes no lock and no memory.
pub struct Watch<P> {
    mailbox: Arc<Mailbox<P>>,
    health: Arc<HealthReporter>,
    missed: Counter,
    unusable: Gauge,
    cycle: Option<u64>,
    phase: Phase,
    fault: Option<Fault>,
    tare: bool,
    /// Why the tare that is waited for was refused; empty when it was not.
    tare_refused: Text,
    withdrawn: bool,
    /// What was told last of whether the tool may touch something.
    clearance: Option<Clearance>,
    /// Estimator, and how often it changed.
    used: Option<(EstimatorName, u32)>,
    said: Option<Standing>,
}

impl<P> Watch<P> {
    /// Tells these.
    pub fn new(mailbox: &Arc<Mailbox<P>>, health: &Arc<HealthReporter>) -> Self {
        Self {
            mailbox: Arc::clone(mailbox),
            health: Arc::clone(health),
            missed: health.missed_cycles(),
            unusable: health.gauge("arm_states_unusable"),
            cycle: None,
            phase: Phase::default(),
            fault: None,
            tare: false,
            tare_refused: Text::new(),
            withdrawn: false,
            clearance: None,
            used: None,
            said: None,
        }
    }

    /// Counts the robot's packets that never came here.
    pub fn count_missed(&mut self, cycle: u64) {
        if let Some(last) = self.cycle
            && cycle > last
        {
            self.missed.add(cycle - last - 1);
        }
        self.cycle = Some(cycle);
    }

    /// The arm's state makes no sense; nothing is answered.
    pub fn unusable(&mut self) {
        self.unusable.set(self.unusable.get() + 1.0);
        self.say(Standing::Unusable);
    }

    /// The estimator in use, why, and how often it changed.
    pub fn estimator(&mut self, name: EstimatorName, switches: u32, cause: Text) {
        if self.used != Some((name, switches)) {
            self.used = Some((name, switches));
            self.mailbox.notes.force_push(Note::Estimator(name, cause));
        }
    }

    /// A fault in words: a task that got no tare says why it was refused.
    pub fn fault_text(&mut self, fault: Option<Fault>, text: Text) -> Text {
        if let Some(reason) = self.mailbox.tare_refused.pop() {
            self.tare_refused = reason;
        }
        if fault == Some(Fault::NoTare) && !text.is_empty() && !self.tare_refused.is_empty() {
            return cut_format(format_args!("no tare in time: {}", self.tare_refused));
        }
        text
    }

    /// At the cycle's end.
    pub fn after(&mut self, told: &Told) {
        if told.tare_requested && !self.tare {
            self.mailbox.tare_due.store(true, Ordering::Release);
        }
        self.tare = told.tare_requested;
        if told.zero_withdrawn && !self.withdrawn {
            self.mailbox.withdraw_due.store(true, Ordering::Release);
        }
        self.withdrawn = told.zero_withdrawn;
        self.keep_in_mind(told);
        if told.phase != self.phase || told.fault != self.fault {
            self.mailbox
                .notes
                .force_push(Note::Phase(told.phase, told.fault_text));
            self.phase = told.phase;
            self.fault = told.fault;
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

    /// What outlasts this process. While the tool is on its way off and tared, what was kept at the start stands: that it may touch.
    fn keep_in_mind(&mut self, told: &Told) {
        if matches!(told.phase, Phase::Tare | Phase::Clear) {
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
            self.mailbox.clearance.force_push(told.clearance);
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
                "the arm is driven by {other}; tasks are refused here"
            )),
            Standing::Unusable => self.health.degraded(format_args!(
                "arm/state has no usable pose or joints: is it this cell's arm?"
            )),
        }
    }
}

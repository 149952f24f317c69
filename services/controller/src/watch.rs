//! What every loop tells the others about itself, whatever its law: phases, faults, tares, who drives the arm.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use tangent_control::{EstimatorName, Fault, Phase};
use tangent_runtime::{Counter, Gauge, HealthReporter, State};
use tangent_schemas::{Name, Text};

use crate::mailbox::{Mailbox, Note};

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

    /// At the cycle's end.
    pub fn after(&mut self, told: &Told) {
        if told.tare_requested && !self.tare {
            self.mailbox.tare_due.store(true, Ordering::Release);
        }
        self.tare = told.tare_requested;
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

//! Whether the arm is ready to move, and why not: in `arm/state`, in the service's health, and in
//! the log.

use std::fmt;

use tangent_actuation::lease::{Lease, Source};
use tangent_schemas::Text;
use tangent_schemas::convert::cut_format;
use tangent_schemas::tangent::ArmState;

use super::notes::{Note, Notes};
use crate::health::{HealthReporter, State};

/// Reason why a command with a new activation would not move the arm now.
pub trait NotReady: fmt::Display + Copy + PartialEq {
    /// State of the service while this reason applies.
    fn service_state(&self) -> State;
}

/// Last announced readiness. Text is created only after a change.
#[derive(Clone, Copy, Debug)]
pub struct Readiness<R> {
    announced: Option<(Option<R>, Option<Source>)>,
}

impl<R> Default for Readiness<R> {
    fn default() -> Self {
        Self { announced: None }
    }
}

impl<R: NotReady> Readiness<R> {
    /// Discards the last announcement, as the connection has ended.
    pub fn forget(&mut self) {
        self.announced = None;
    }

    /// Writes `reason` into `state`, which is that of the previous cycle; `None`: the arm is ready.
    pub fn fill(&self, state: &mut ArmState, reason: Option<R>) {
        state.ready = reason.is_none();
        if self.announced.map(|(announced, _)| announced) != Some(reason) {
            state.not_ready_reason =
                reason.map_or_else(Text::new, |reason| cut_format(format_args!("{reason}")));
        }
    }

    /// Announces `reason`, and a source that `lease` refuses at `now_s`, in health and log, if
    /// either has changed. Takes no lock and allocates nothing.
    pub fn announce<V: fmt::Display>(
        &mut self,
        reason: Option<R>,
        lease: &Lease,
        now_s: f64,
        health: &HealthReporter,
        notes: &Notes<V>,
    ) {
        let rival = lease.rival(now_s).copied();
        if self.announced == Some((reason, rival)) {
            return;
        }
        let ready_before = matches!(self.announced, Some((None, _)));
        self.announced = Some((reason, rival));
        match (reason, rival) {
            (None, None) => {
                health.running();
                if !ready_before {
                    notes.push(Note::Info(cut_format(format_args!("ready"))));
                }
            }
            (None, Some(rival)) => {
                let text = lease.refusal_of(&rival);
                health.set(State::Degraded, text);
                notes.push(Note::Refused(text));
            }
            (Some(reason), _) => {
                let text = cut_format(format_args!("{reason}"));
                let state = reason.service_state();
                health.set(state, text);
                // A service that was asked to end is no problem.
                notes.push(match state {
                    State::Stopping => Note::Info(text),
                    _ => Note::NotReady(text),
                });
            }
        }
    }
}

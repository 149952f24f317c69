//! Tare requests in the service's loop, between two readings.

use tangent_runtime::ticket::Order;
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{ConditionedWrench, TareConfig, WrenchConditioner, WrenchConditionerState};

use crate::memory::{KeptZero, ZeroNotes};
use crate::requests::{Outcome, TareWork, Wanted};

/// Part of the tare that runs in the service's loop. It never blocks, and allocates only in
/// [`Taring::adopt`].
pub struct Taring {
    work: TareWork,
    notes: ZeroNotes,
    /// Last good zero before the restart.
    kept: Option<KeptZero>,
    /// Identity of the sensor; empty before it is known.
    owner: String,
}

impl Taring {
    pub(crate) fn new(work: TareWork, notes: ZeroNotes, kept: Option<KeptZero>) -> Self {
        Self {
            work,
            notes,
            kept,
            owner: String::new(),
        }
    }

    /// Sets the sensor by its serial number or another identity, `owner`. Its stored zero is then
    /// in force, unless it is older than `config` allows; a zero of another sensor is removed.
    /// `now_s` is on the clock of [`tangent_sensing::Reading::time_s`].
    pub fn adopt(
        &mut self,
        owner: &str,
        config: &TareConfig,
        state: &mut WrenchConditionerState,
        now_s: f64,
    ) {
        if self.owner == owner {
            return;
        }
        if !self.owner.is_empty() {
            tracing::warn!("another sensor: the zero of {} does not apply", self.owner);
            state.set_tare(None);
            state.forget_reference();
            self.notes.forget();
        }
        owner.clone_into(&mut self.owner);
        let kept = self.kept.take();
        let zero = kept.and_then(|kept| kept.tare(owner, now_s, config.reference_age_max_s));
        if let Some(zero) = zero {
            let age_s = now_s - zero.time_s;
            tracing::info!("the last good zero, {age_s:.0} s old, is in force");
            state.set_tare(Some(zero));
        }
    }

    /// Handles the pending request, before the next reading. `now_s` is on the clock of
    /// [`tangent_sensing::Reading::time_s`].
    pub fn serve(
        &mut self,
        conditioner: &WrenchConditioner,
        state: &mut WrenchConditionerState,
        now_s: f64,
    ) {
        match self.work.order() {
            Order::None => return,
            Order::Forget => return state.cancel_tare(),
            Order::Begin => {}
        }
        match self.work.wanted() {
            Wanted::Tare(ground) => conditioner.start_tare(state, ground),
            Wanted::Withdraw => {
                let had = state.tare().is_some();
                state.withdraw_tare();
                match state.reference() {
                    Some(zero) => self.notes.keep(&self.owner, zero, now_s - zero.time_s),
                    None => self.notes.forget(),
                }
                self.work.answer(Outcome::Withdrawn(had));
            }
        }
    }

    /// Answers the request and stores the zero, if the last reading completed a tare.
    pub fn finish(&mut self, state: &mut WrenchConditionerState) {
        let Some(ended) = state.take_tare_outcome() else {
            return;
        };
        self.work.answer(match ended {
            Ok(tare) => {
                self.notes.keep(&self.owner, &tare, 0.0);
                Outcome::Tared(tare)
            }
            Err(refusal) => Outcome::Refused(refusal),
        });
    }
}

/// Writes the untared wrench, the zero, its age and the bound on its drift to `status`.
pub fn tell_zero(conditioned: &ConditionedWrench, config: &TareConfig, status: &mut WrenchStatus) {
    let age_s = conditioned.bias_age_s;
    status.bias = (&conditioned.bias).into();
    status.bias_age_s = age_s.unwrap_or(-1.0);
    status.bias_bound_n = age_s.map_or(-1.0, |age_s| config.drift_bound_n(age_s));
    status.bias_said_clear = conditioned.said_clear;
    status.untared = (&conditioned.untared).into();
    let reference = conditioned.reference;
    status.reference = reference.map_or_else(Default::default, |(zero, _)| (&zero).into());
    status.reference_age_s = reference.map_or(-1.0, |(_, age_s)| age_s);
    status.rated_share = config.rated_share(&conditioned.untared).unwrap_or(-1.0);
}

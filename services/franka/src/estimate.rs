//! The robot's wrench estimate, conditioned as a sensor's readings are: watched, tared, and told with what it was before its zero.
//!
//! The estimate is treated as the reading of a sensor at the tool's origin, in tool axes, that carries nothing (the robot takes
//! its load off by itself). So a tare is averaged, judged and taken back as `netft` does it.

use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_runtime::ticket::Order;
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{
    ConditionedWrench, ConditioningConfig, Payload, Reading, SensingError, TareConfig,
    WrenchConditioner, WrenchConditionerState,
};
use tangent_tare::{Outcome, Taring, Wanted};

use crate::fci::PERIOD_S;
use crate::wrench_watch::WrenchWatch;

/// Watch, zero and memory of the estimate.
pub(crate) struct Estimate {
    conditioner: WrenchConditioner,
    state: WrenchConditionerState,
    watch: WrenchWatch,
    taring: Taring,
    /// What the zero belongs to: the robot and its tool.
    owner: String,
}

impl Estimate {
    /// Goes on with the zero of `owner` that the service before left. The clock of [`Estimate::take`] begins now.
    ///
    /// # Errors
    /// A number of the tare that is out of range.
    pub(crate) fn new(
        tare: &TareConfig,
        mut taring: Taring,
        owner: String,
    ) -> Result<Self, SensingError> {
        let config = ConditioningConfig {
            // The robot filters, and the watch holds its faults by itself.
            filter_cutoff_hz: 0.0,
            fault_hold_s: 0.0,
            tare: tare.clone(),
            ..ConditioningConfig::default()
        };
        let conditioner = WrenchConditioner::new(
            &config,
            &Payload::default(),
            Pose::identity(),
            1.0 / PERIOD_S,
        )?;
        let mut state = WrenchConditionerState::default();
        let kept = taring.zero.take();
        if let Some(zero) = kept.and_then(|kept| kept.tare(&owner, 0.0, tare.reference_age_max_s)) {
            tracing::info!("the last good zero, {:.0} s old, is in force", -zero.time_s);
            state.set_tare(Some(zero));
        }
        Ok(Self {
            conditioner,
            state,
            watch: WrenchWatch::default(),
            taring,
            owner,
        })
    }

    /// One estimate as the robot gives it, at the tool. No lock, no memory.
    pub(crate) fn take(
        &mut self,
        raw: &Wrench<Tool>,
        base_from_tool: &Pose<Base, Tool>,
        now_s: f64,
    ) -> ConditionedWrench {
        self.serve(now_s);
        let condition = self.watch.take(&raw.vector());
        let wrench = Wrench::<Sensor>::from_vector(&raw.vector());
        let conditioned = self.conditioner.update(
            &mut self.state,
            &Reading {
                condition,
                ..Reading::new(now_s, wrench, *base_from_tool)
            },
        );
        if let Some(ended) = self.state.take_tare_outcome() {
            self.taring.work.answer(match ended {
                Ok(tare) => {
                    self.taring.notes.keep(&self.owner, &tare, 0.0);
                    Outcome::Tared(tare)
                }
                Err(refusal) => Outcome::Refused(refusal),
            });
        }
        conditioned
    }

    /// What was asked of the zero.
    fn serve(&mut self, now_s: f64) {
        match self.taring.work.order() {
            Order::None => return,
            Order::Forget => return self.state.cancel_tare(),
            Order::Begin => {}
        }
        match self.taring.work.wanted() {
            Wanted::Tare(ground) => self.conditioner.start_tare_on(&mut self.state, ground),
            Wanted::Withdraw => {
                let had = self.state.tare().is_some();
                self.state.withdraw_tare();
                match self.state.reference() {
                    Some(zero) => self
                        .taring
                        .notes
                        .keep(&self.owner, zero, now_s - zero.time_s),
                    None => self.taring.notes.forget(),
                }
                self.taring.work.answer(Outcome::Withdrawn(had));
            }
        }
    }

    /// Says in `status` how far the estimate and its zero can be trusted.
    pub(crate) fn tell(&self, conditioned: &ConditionedWrench, status: &mut WrenchStatus) {
        let tare = self.conditioner.tare_config();
        status.validity = conditioned.validity as u8;
        status.stuck_axes = self.watch.stuck_axes();
        status.bias_age_s = conditioned.bias_age_s.unwrap_or(-1.0);
        status.bias = (&conditioned.bias).into();
        status.bias_said_clear = conditioned.said_clear;
        status.untared = (&conditioned.untared).into();
        let reference = conditioned.reference;
        status.reference = reference.map_or_else(Default::default, |(zero, _)| (&zero).into());
        status.reference_age_s = reference.map_or(-1.0, |(_, age_s)| age_s);
        status.rated_share = tare.rated_share(&conditioned.untared).unwrap_or(-1.0);
        // How wrong the zero is depends on the pose, not on its age.
        status.bias_bound_n = -1.0;
    }
}

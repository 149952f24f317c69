//! The robot's wrench estimate, conditioned like a sensor's readings: checked, tared, and published
//! together with its untared value.
//!
//! The estimate is treated as the reading of a sensor at the tool's origin, in tool axes, that
//! carries nothing, since the robot subtracts its load itself. A tare is therefore averaged,
//! checked and undone as in `netft`.

use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{
    ConditionedWrench, ConditioningConfig, Payload, Reading, SensingError, TareConfig,
    WrenchConditioner, WrenchConditionerState,
};
use tangent_tare::{Taring, tell_zero};

use crate::fci::PERIOD_S;
use crate::wrench_watch::WrenchWatch;

/// Checks, zero and stored state of the estimate.
pub(crate) struct Estimate {
    conditioner: WrenchConditioner,
    state: WrenchConditionerState,
    watch: WrenchWatch,
    taring: Taring,
}

impl Estimate {
    /// Continues with the zero of `owner`, the robot and its tool, that the previous run of the
    /// service stored. The clock of [`Estimate::take`] begins now.
    ///
    /// # Errors
    /// A setting of the tare is out of range.
    pub(crate) fn new(
        tare: &TareConfig,
        mut taring: Taring,
        owner: &str,
    ) -> Result<Self, SensingError> {
        let config = ConditioningConfig {
            // The robot filters, and the watch handles held values.
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
        taring.adopt(owner, tare, &mut state, 0.0);
        Ok(Self {
            conditioner,
            state,
            watch: WrenchWatch::default(),
            taring,
        })
    }

    /// Takes one estimate of the robot, at the tool. Takes no lock and allocates nothing.
    pub(crate) fn take(
        &mut self,
        raw: &Wrench<Tool>,
        base_from_tool: &Pose<Base, Tool>,
        now_s: f64,
    ) -> ConditionedWrench {
        self.taring.serve(&self.conditioner, &mut self.state, now_s);
        let condition = self.watch.take(&raw.vector());
        let wrench = Wrench::<Sensor>::from_vector(&raw.vector());
        let conditioned = self.conditioner.update(
            &mut self.state,
            &Reading {
                condition,
                ..Reading::new(now_s, wrench, *base_from_tool)
            },
        );
        self.taring.finish(&mut self.state);
        conditioned
    }

    /// Writes into `status` how far the estimate and its zero can be trusted.
    pub(crate) fn tell(&self, conditioned: &ConditionedWrench, status: &mut WrenchStatus) {
        status.validity = conditioned.validity as u8;
        status.stuck_axes = self.watch.stuck_axes();
        tell_zero(conditioned, self.conditioner.tare_config(), status);
        // The error of the zero depends on the pose, not on its age.
        status.bias_bound_n = -1.0;
    }
}

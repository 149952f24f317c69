//! The robot's wrench estimate, conditioned as a sensor's readings are: watched, tared, and told
//! with what it was before its zero.
//!
//! The estimate is treated as the reading of a sensor at the tool's origin, in tool axes, that
//! carries nothing (the robot takes its load off by itself). So a tare is averaged, judged and
//! taken back as `netft` does it.

use tangent_mechanics::{Base, Pose, Sensor, Tool, Wrench};
use tangent_schemas::tangent::WrenchStatus;
use tangent_sensing::{
    ConditionedWrench, ConditioningConfig, Payload, Reading, SensingError, TareConfig,
    WrenchConditioner, WrenchConditionerState,
};
use tangent_tare::{Taring, tell_zero};

use crate::fci::PERIOD_S;
use crate::wrench_watch::WrenchWatch;

/// Watch, zero and memory of the estimate.
pub(crate) struct Estimate {
    conditioner: WrenchConditioner,
    state: WrenchConditionerState,
    watch: WrenchWatch,
    taring: Taring,
}

impl Estimate {
    /// Goes on with the zero of `owner`, the robot and its tool, that the service before left. The
    /// clock of [`Estimate::take`] begins now.
    ///
    /// # Errors
    /// A number of the tare that is out of range.
    pub(crate) fn new(
        tare: &TareConfig,
        mut taring: Taring,
        owner: &str,
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
        taring.adopt(owner, tare, &mut state, 0.0);
        Ok(Self {
            conditioner,
            state,
            watch: WrenchWatch::default(),
            taring,
        })
    }

    /// One estimate as the robot gives it, at the tool. No lock, no memory.
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

    /// Says in `status` how far the estimate and its zero can be trusted.
    pub(crate) fn tell(&self, conditioned: &ConditionedWrench, status: &mut WrenchStatus) {
        status.validity = conditioned.validity as u8;
        status.stuck_axes = self.watch.stuck_axes();
        tell_zero(conditioned, self.conditioner.tare_config(), status);
        // How wrong the zero is depends on the pose, not on its age.
        status.bias_bound_n = -1.0;
    }
}

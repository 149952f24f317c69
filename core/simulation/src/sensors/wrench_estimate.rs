//! External wrench as estimated by a torque-controlled robot: a momentum observer on the robot's
//! own model, with delay and noise.

use arrayvec::ArrayVec;
use nalgebra::SMatrix;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Arm, Base, Joints, Pose, Tool, Wrench};
use tangent_sensing::{MomentumObserver, MomentumObserverState, wrench_of_torques};

use super::fault::{FaultySensor, SensorFault};
use crate::hardware_errors::WrenchEstimateErrors;
use crate::plant_error::PlantError;

/// Longest stated delay, periods.
const DELAY_PERIODS_MAX: usize = 16;
/// Longest delay with its error, periods.
const DELAY_LINE_MAX: usize = 24;

/// The `[plant.external_wrench]` table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExternalWrenchConfig {
    /// Gain of the observer, 1/s: the inverse of its time constant.
    pub gain_per_s: f64,
    /// Delay of the estimate, periods.
    pub delay_periods: usize,
    /// White noise of a measured torque, standard deviation per period, Nm.
    pub torque_noise_nm: f64,
    /// Zero error of a measured torque, standard deviation over seeds, Nm.
    pub torque_bias_nm: f64,
    /// Fault of the estimate and its start time; only `deaf` is possible.
    pub fault: Option<SensorFault>,
}

impl Default for ExternalWrenchConfig {
    fn default() -> Self {
        Self {
            gain_per_s: 60.0,
            delay_periods: 1,
            torque_noise_nm: 0.03,
            torque_bias_nm: 0.05,
            fault: None,
        }
    }
}

impl ExternalWrenchConfig {
    /// Checks that every number is in its range.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        let value = PlantError::unless;
        value(
            "external_wrench.gain_per_s",
            self.gain_per_s,
            "1 to 1000 1/s",
            (1.0..=1000.0).contains(&self.gain_per_s),
        )?;
        value(
            "external_wrench.delay_periods",
            self.delay_periods as f64,
            "0 to 16",
            self.delay_periods <= DELAY_PERIODS_MAX,
        )?;
        if let Some(fault) = self.fault {
            let known = matches!(fault, SensorFault::Deaf { .. });
            value("external_wrench.fault", 0.0, "of kind deaf", known)?;
            if let Some((_, x, allowed)) = fault.mistake() {
                value("external_wrench.fault", x, allowed, false)?;
            }
        }
        for (key, x) in [
            ("external_wrench.torque_noise_nm", self.torque_noise_nm),
            ("external_wrench.torque_bias_nm", self.torque_bias_nm),
        ] {
            value(key, x, "0 to 5 Nm", (0.0..=5.0).contains(&x))?;
        }
        Ok(())
    }
}

/// Observer, noise and delay. It uses the arm's stated model and no state of the contact.
#[derive(Clone, Debug)]
pub struct WrenchEstimate<const N: usize> {
    config: ExternalWrenchConfig,
    model: Arm<N>,
    observer: MomentumObserver,
    state: MomentumObserverState<N>,
    bias: Joints<N>,
    fault: Option<FaultySensor>,
    /// Noise after the observer, without signal, Nm, and the number of periods so far.
    hiss: (Joints<N>, u64),
    rng: Pcg64Mcg,
    under_way: ArrayVec<(Wrench<Tool>, Joints<N>), { DELAY_LINE_MAX + 1 }>,
}

impl<const N: usize> WrenchEstimate<N> {
    /// `model` is the arm's model in its own controller.
    pub fn new(config: &ExternalWrenchConfig, model: Arm<N>, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x70c4_0b5e_44e2_11d7);
        let bias = normal_joints(&mut rng) * config.torque_bias_nm;
        Self {
            config: *config,
            model,
            observer: MomentumObserver {
                gain_per_s: config.gain_per_s,
            },
            state: MomentumObserverState::default(),
            bias,
            fault: config.fault.map(|fault| FaultySensor::new(fault, 1.0)),
            hiss: (Joints::zeros(), 0),
            rng,
            under_way: ArrayVec::new(),
        }
    }

    /// The estimate with errors of its observer.
    pub fn with_errors(mut self, errors: &WrenchEstimateErrors) -> Self {
        self.config.gain_per_s *= errors.gain_ratio;
        self.observer.gain_per_s = self.config.gain_per_s;
        let delay = self.config.delay_periods + errors.delay_periods;
        self.config.delay_periods = delay.min(DELAY_LINE_MAX);
        self
    }

    /// One period that ended at measured `q` and `qd` under motor torques `torque` (Nm). `jacobian`
    /// is that of the tool. Returns the wrench on the tool and the torques on the joints that have
    /// arrived by now.
    pub fn step(
        &mut self,
        q: &Joints<N>,
        qd: &Joints<N>,
        torque: &Joints<N>,
        tool: &Pose<Base, Tool>,
        jacobian: &SMatrix<f64, 6, N>,
        dt_s: f64,
    ) -> (Wrench<Tool>, Joints<N>) {
        let noise = normal_joints::<N>(&mut self.rng) * self.config.torque_noise_nm;
        let measured = torque + self.bias + noise;
        let external = self
            .observer
            .update(&mut self.state, &self.model, q, qd, &measured, dt_s);
        let seen = |torque: &Joints<N>| {
            tool.unalign_wrench(&Wrench::from_vector(&wrench_of_torques(jacobian, torque)))
        };
        let mut wrench = seen(&external);
        if let Some(fault) = &mut self.fault {
            let share = self.config.gain_per_s * dt_s;
            let (hiss, periods) = &mut self.hiss;
            *hiss -= (noise + *hiss) * (share / (1.0 + share));
            *periods += 1;
            let noise = seen(hiss).vector();
            let time_s = *periods as f64 * dt_s;
            wrench = Wrench::from_vector(&(fault.load(time_s, &(wrench.vector() - noise)) + noise));
        }
        // Never full: one estimate is added per period, and one is removed once the delay has
        // passed.
        let _ = self.under_way.try_push((wrench, external));
        if self.under_way.len() > self.config.delay_periods {
            return self.under_way.remove(0);
        }
        (Wrench::zero(), Joints::zeros())
    }
}

fn normal_joints<const N: usize>(rng: &mut Pcg64Mcg) -> Joints<N> {
    Joints::from_fn(|_, _| StandardNormal.sample(rng))
}

//! A torque-controlled arm of any model: full rigid-body dynamics, joint friction and torque
//! limits.

use serde::{Deserialize, Serialize};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Arm, JointFriction, Joints};

use super::servo::quantise;
use crate::hardware_errors::TorqueArmErrors;
use crate::hardware_errors::torque_errors::entry;
use crate::plant_error::PlantError;

/// Longest delay of a torque, periods.
const DELAY_PERIODS_MAX: usize = 8;
/// Longest delay of a torque with its error, periods.
const DELAY_LINE_MAX: usize = 16;

/// The `[plant.arm]` table of a torque-controlled cell. Lists have one entry per joint, base to
/// flange; a single entry applies to all joints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TorqueArmConfig {
    /// Time between commands, s.
    pub period_s: f64,
    /// Steps of integration per period.
    pub sub_steps: usize,
    /// Periods between a measurement and the effect of the torque computed from it, as the law is
    /// told.
    pub delay_periods: usize,
    /// Viscous friction, Nm s/rad.
    pub viscous_nm_s_per_rad: Vec<f64>,
    /// Coulomb friction, Nm.
    pub coulomb_nm: Vec<f64>,
    /// Speed at which Coulomb friction has reached 71 % of its value, rad/s.
    pub coulomb_speed_rad_per_s: f64,
    /// Resolution of measured joint positions, rad; 0 for none.
    pub encoder_resolution_rad: f64,
    /// Resolution of measured joint velocities, rad/s; 0 for none.
    pub velocity_resolution_rad_per_s: f64,
}

impl Default for TorqueArmConfig {
    fn default() -> Self {
        Self {
            period_s: 0.001,
            sub_steps: 4,
            delay_periods: 1,
            viscous_nm_s_per_rad: vec![0.0],
            coulomb_nm: vec![0.0],
            coulomb_speed_rad_per_s: 0.01,
            encoder_resolution_rad: 0.0,
            velocity_resolution_rad_per_s: 0.0,
        }
    }
}

impl TorqueArmConfig {
    /// Checks that every number is in its range.
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        let arm = self;
        let value = PlantError::unless;
        let period = arm.period_s;
        value(
            "arm.period_s",
            period,
            "0.0005 to 0.01 s",
            (5e-4..=0.01).contains(&period),
        )?;
        value(
            "arm.sub_steps",
            arm.sub_steps as f64,
            "1 to 100",
            (1..=100).contains(&arm.sub_steps),
        )?;
        value(
            "arm.delay_periods",
            arm.delay_periods as f64,
            "0 to 8",
            arm.delay_periods <= DELAY_PERIODS_MAX,
        )?;
        value(
            "arm.coulomb_speed_rad_per_s",
            arm.coulomb_speed_rad_per_s,
            "above 0",
            arm.coulomb_speed_rad_per_s > 0.0,
        )?;
        for &x in &arm.viscous_nm_s_per_rad {
            value("arm.viscous_nm_s_per_rad", x, "0 or above", x >= 0.0)?;
        }
        for &x in &arm.coulomb_nm {
            value("arm.coulomb_nm", x, "0 or above", x >= 0.0)?;
        }
        Ok(())
    }

    /// Viscous and Coulomb friction of the plant's joints, without the errors.
    fn friction<const N: usize>(&self) -> JointFriction<N> {
        JointFriction::from_lists(
            &self.viscous_nm_s_per_rad,
            &self.coulomb_nm,
            self.coulomb_speed_rad_per_s,
        )
    }
}

/// Friction of the joints as it is: viscous and Coulomb friction, with Stribeck's excess at rest
/// and a dependence on the direction.
#[derive(Clone, Copy, Debug)]
struct TrueFriction<const N: usize> {
    smooth: JointFriction<N>,
    /// Friction at rest beyond Coulomb friction, as a share of it.
    excess: f64,
    stribeck_rad_per_s: f64,
    asymmetry: f64,
}

impl<const N: usize> TrueFriction<N> {
    fn new(config: &TorqueArmConfig, errors: &TorqueArmErrors) -> Self {
        let mut smooth = config.friction();
        for i in 0..N {
            let ratio = entry(&errors.friction_ratio, i, 1.0);
            smooth.viscous[i] *= ratio;
            smooth.coulomb[i] *= ratio;
        }
        Self {
            smooth,
            excess: errors.static_ratio - 1.0,
            stribeck_rad_per_s: errors.stribeck_rad_per_s,
            asymmetry: errors.asymmetry,
        }
    }

    /// Friction torque divided by speed, Nm s/rad; never negative.
    fn slope(&self, qd: &Joints<N>) -> Joints<N> {
        if self.excess == 0.0 && self.asymmetry == 0.0 {
            return self.smooth.slope(qd);
        }
        let mut friction = self.smooth;
        for i in 0..N {
            let stribeck = (-(qd[i] / self.stribeck_rad_per_s).powi(2)).exp();
            let direction = qd[i] / qd[i].hypot(friction.speed);
            friction.coulomb[i] *=
                (1.0 + self.excess * stribeck) * (1.0 + self.asymmetry * direction);
        }
        friction.slope(qd)
    }
}

/// State of an arm under torques.
#[derive(Clone, Debug)]
pub struct TorqueArm<const N: usize> {
    model: Arm<N>,
    friction: TrueFriction<N>,
    motor_inertia: Joints<N>,
    /// Measured minus true positions, rad.
    offset: Joints<N>,
    /// Positions, rad.
    pub q: Joints<N>,
    /// Velocities, rad/s.
    pub qd: Joints<N>,
    /// Accelerations of the last sub-step, rad/s².
    pub qdd: Joints<N>,
    resolution: (f64, f64),
    /// Torques in transit to the motors, newest first, Nm.
    torques: [Joints<N>; DELAY_LINE_MAX + 1],
    delay_periods: usize,
}

impl<const N: usize> TorqueArm<N> {
    /// Arm at rest at `q` (rad), held by its motors, without errors.
    pub fn new(model: Arm<N>, config: &TorqueArmConfig, q: Joints<N>) -> Self {
        Self {
            model,
            friction: TrueFriction::new(config, &TorqueArmErrors::default()),
            motor_inertia: Joints::zeros(),
            offset: Joints::zeros(),
            q,
            qd: Joints::zeros(),
            qdd: Joints::zeros(),
            resolution: (
                config.encoder_resolution_rad,
                config.velocity_resolution_rad_per_s,
            ),
            torques: [model.gravity(&q); DELAY_LINE_MAX + 1],
            delay_periods: config.delay_periods.min(DELAY_PERIODS_MAX),
        }
    }

    /// Adds the inertia of the motors, kg m² per joint: that of a rotor times the square of its
    /// gear ratio. A new arm has none, and its links alone are accelerated.
    #[must_use]
    pub fn with_motor_inertia(mut self, motor_inertia: Joints<N>) -> Self {
        self.motor_inertia = motor_inertia;
        self
    }

    /// The arm with errors; `config` is the one that it was made from.
    pub fn with_errors(mut self, config: &TorqueArmConfig, errors: &TorqueArmErrors) -> Self {
        self.friction = TrueFriction::new(config, errors);
        self.offset = Joints::from_fn(|i, _| entry(&errors.offset_rad, i, 0.0));
        let delay = config.delay_periods + errors.delay_periods;
        self.delay_periods = delay.min(DELAY_LINE_MAX);
        self
    }

    /// Model of the arm that moves.
    pub fn model(&self) -> &Arm<N> {
        &self.model
    }

    /// Friction torque divided by speed at joint velocities `qd` (rad/s), Nm s/rad.
    pub fn friction_slope(&self, qd: &Joints<N>) -> Joints<N> {
        self.friction.slope(qd)
    }

    /// Takes the torques commanded in a period and returns those that take effect in it, commanded
    /// `delay_periods` earlier, Nm.
    pub fn exchange(&mut self, torque: &Joints<N>) -> Joints<N> {
        self.torques[..=self.delay_periods].rotate_right(1);
        self.torques[0] = *torque;
        self.torques[self.delay_periods]
    }

    /// `torque` limited to the joints' effort, Nm.
    pub fn limited(&self, torque: &Joints<N>) -> Joints<N> {
        match self.model.limits().effort {
            Some(effort) => Joints::from_fn(|i, _| torque[i].clamp(-effort[i], effort[i])),
            None => *torque,
        }
    }

    /// `torque` (Nm) limited to the rate that the motors can follow within `period_s`, starting
    /// from `before`.
    pub fn within_rate(&self, torque: &Joints<N>, before: &Joints<N>, period_s: f64) -> Joints<N> {
        match self.model.limits().effort_rate {
            Some(rate) => Joints::from_fn(|i, _| {
                let step = rate[i] * period_s;
                before[i] + (torque[i] - before[i]).clamp(-step, step)
            }),
            None => *torque,
        }
    }

    /// One sub-step of `dt` (s) under motor torques and `external` torques (Nm, from the
    /// environment on the joints).
    ///
    /// Velocity is integrated first, then position with the new velocity, so that a spring never
    /// gains energy over time. Friction acts on the new velocity, so it can stop a joint but not
    /// reverse it.
    pub fn step(&mut self, torque: &Joints<N>, external: &Joints<N>, dt: f64) {
        let (mut mass, bias) = self.model.mass_matrix_and_bias(&self.q, &self.qd);
        let slope = self.friction.slope(&self.qd);
        for i in 0..N {
            mass[(i, i)] += dt * slope[i] + self.motor_inertia[i];
        }
        let drive = self.limited(torque) + external - bias - slope.component_mul(&self.qd);
        // The mass matrix of a checked model is positive definite, so only a bad torque fails here.
        self.qdd =
            solve_positive_definite(&mass, &drive).unwrap_or_else(|| Joints::repeat(f64::NAN));
        self.qd += self.qdd * dt;
        self.q += self.qd * dt;
        // Hard stops.
        let limits = self.model.limits();
        for i in 0..N {
            let (lower, upper) = (limits.position_lower[i], limits.position_upper[i]);
            // A NaN is beyond neither limit and stays visible.
            if self.q[i] < lower || self.q[i] > upper {
                self.q[i] = self.q[i].clamp(lower, upper);
                self.qd[i] = 0.0;
            }
        }
    }

    /// Joint positions measured by the encoders, rad.
    pub fn q_measured(&self) -> Joints<N> {
        (self.q + self.offset).map(|x| quantise(x, self.resolution.0))
    }

    /// Joint velocities reported by the controller, rad/s.
    pub fn qd_measured(&self) -> Joints<N> {
        self.qd.map(|x| quantise(x, self.resolution.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_mechanics::ModelData;

    fn arm<const N: usize>(name: &str, config: &TorqueArmConfig) -> TorqueArm<N> {
        let model = Arm::new(&ModelData::builtin(name).unwrap()).unwrap();
        TorqueArm::new(model, config, model.home())
    }

    fn falls_and_keeps_its_energy<const N: usize>(name: &str) {
        let mut arm = arm::<N>(name, &TorqueArmConfig::default());
        let energy = |a: &TorqueArm<N>| {
            a.model().kinetic_energy(&a.q, &a.qd) + a.model().potential_energy(&a.q)
        };
        let start = energy(&arm);
        let mut kinetic = 0.0_f64;
        let limits = *arm.model().limits();
        for _ in 0..1200 {
            // A joint loses its kinetic energy at its stop.
            let free = (0..N).all(|i| {
                arm.q[i] - limits.position_lower[i] > 0.05
                    && limits.position_upper[i] - arm.q[i] > 0.05
            });
            if !free {
                break;
            }
            arm.step(&Joints::zeros(), &Joints::zeros(), 2.5e-4);
            kinetic = kinetic.max(arm.model().kinetic_energy(&arm.q, &arm.qd));
        }
        let drift = (energy(&arm) - start).abs();
        assert!(kinetic > 0.5, "{name}: {kinetic} J");
        assert!(drift < 5e-3 * kinetic, "{name}: {drift} of {kinetic} J");
    }

    #[test]
    fn every_arm_keeps_its_energy_without_friction() {
        falls_and_keeps_its_energy::<6>("smart3s_substitute");
        falls_and_keeps_its_energy::<6>("ur5");
        falls_and_keeps_its_energy::<7>("panda");
    }

    #[test]
    fn the_inertia_of_the_motors_is_accelerated_with_the_links() {
        let model = Arm::<7>::new(&ModelData::builtin("panda").unwrap()).unwrap();
        let inertia = Joints::<7>::repeat(0.1);
        let mut arm = TorqueArm::new(model, &TorqueArmConfig::default(), model.home())
            .with_motor_inertia(inertia);
        let mut torque = model.gravity(&arm.q);
        torque[6] += 1.0;
        let mass = model.mass_matrix(&arm.q) + nalgebra::Matrix::from_diagonal(&inertia);
        let wanted = mass.try_inverse().unwrap().column(6) * 1e-4;
        arm.step(&torque, &Joints::zeros(), 1e-4);
        assert!((arm.qd - wanted).amax() < 1e-9, "{}", arm.qd);
    }

    #[test]
    fn friction_brings_a_balanced_arm_to_rest_and_not_back() {
        let config = TorqueArmConfig {
            viscous_nm_s_per_rad: vec![5.0],
            coulomb_nm: vec![2.0],
            ..TorqueArmConfig::default()
        };
        let mut arm = arm::<6>("smart3s_substitute", &config);
        arm.qd = Joints::repeat(0.3);
        for _ in 0..40_000 {
            let hold = arm.model().gravity(&arm.q);
            arm.step(&hold, &Joints::zeros(), 2.5e-4);
        }
        assert!(arm.qd.amax() < 1e-4, "{}", arm.qd);
    }

    #[test]
    fn another_friction_law_is_stronger_at_rest_and_in_one_direction_and_never_drives() {
        let config = TorqueArmConfig {
            viscous_nm_s_per_rad: vec![0.0],
            coulomb_nm: vec![2.0],
            ..TorqueArmConfig::default()
        };
        let errors = TorqueArmErrors {
            static_ratio: 1.5,
            asymmetry: 0.1,
            friction_ratio: vec![1.0, 2.0],
            ..TorqueArmErrors::default()
        };
        let friction = TrueFriction::<6>::new(&config, &errors);
        let at = |speed: f64| {
            let qd = Joints::<6>::repeat(speed);
            friction.slope(&qd).component_mul(&qd)
        };
        let (fast, slow, back) = (at(1.0), at(0.01), at(-1.0));
        assert!(
            (fast[0] - 2.2).abs() < 1e-3 && (fast[1] - 4.4).abs() < 1e-3,
            "{fast}"
        );
        assert!((back[0] + 1.8).abs() < 1e-3, "{back}");
        // Coulomb friction has not quite built up at this speed.
        assert!(slow[0] > 1.2 * 2.0 * 0.707, "{slow}");
        assert!(
            (-300..300).all(|i| friction.slope(&Joints::repeat(f64::from(i) * 1e-3)).min() >= 0.0)
        );
    }

    #[test]
    fn the_offset_of_an_encoder_is_in_what_it_measures_alone() {
        let errors = TorqueArmErrors {
            offset_rad: vec![1e-3, 0.0],
            ..TorqueArmErrors::default()
        };
        let exact = arm::<6>("smart3s_substitute", &TorqueArmConfig::default());
        let off = exact
            .clone()
            .with_errors(&TorqueArmConfig::default(), &errors);
        let error = off.q_measured() - off.q;
        assert!((error[0] - 1e-3).abs() < 1e-15);
        assert_eq!((off.q, error[5]), (exact.q, 0.0));
    }

    #[test]
    fn a_torque_beyond_the_effort_is_cut_and_the_stops_hold() {
        let mut arm = arm::<6>("smart3s_substitute", &TorqueArmConfig::default());
        let huge = Joints::repeat(1e5);
        assert_eq!(arm.limited(&huge), arm.model().limits().effort.unwrap());
        for _ in 0..8000 {
            arm.step(&huge, &Joints::zeros(), 2.5e-4);
        }
        assert!(arm.model().limits().contains(&arm.q));
    }

    #[test]
    fn a_torque_rises_no_faster_than_the_motors_do() {
        let arm = arm::<7>("panda", &TorqueArmConfig::default());
        let mut before = Joints::<7>::zeros();
        let wanted = Joints::<7>::repeat(2.5);
        for expected in [1.0, 2.0, 2.5, 2.5] {
            before = arm.within_rate(&wanted, &before, 1e-3);
            assert!((before - Joints::<7>::repeat(expected)).amax() < 1e-12);
        }
    }

    #[test]
    fn a_torque_that_is_no_number_is_seen_in_the_state() {
        let mut arm = arm::<6>("smart3s_substitute", &TorqueArmConfig::default());
        arm.step(&Joints::repeat(f64::NAN), &Joints::zeros(), 1e-3);
        assert!(arm.qd.iter().all(|x| x.is_nan()));
    }
}

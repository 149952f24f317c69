//! Errors of a torque-controlled cell: what its plant does differently from what the file states.
//!
//! [`TorqueErrors`] are exact values. [`ErrorRanges`] are the ranges from which further errors are
//! drawn with the seed.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::{FrameErrors, WrenchErrors};
use crate::contact::FrictionVariation;
use crate::plant_error::PlantError;
use crate::tool::PayloadErrorConfig;

/// Longest further delay, periods.
const DELAY_PERIODS_MAX: usize = 8;

/// The `[plant.errors]` table of a torque-controlled cell. Everything in it is off by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TorqueErrors {
    /// Frames of tip and force/torque sensor.
    pub frames: FrameErrors,
    /// Joints, their friction and their delay.
    pub arm: TorqueArmErrors,
    /// Readings of the force/torque sensor.
    pub wrench: WrenchErrors,
    /// The robot's own estimate of the wrench, in cells without a force/torque sensor.
    pub external_wrench: WrenchEstimateErrors,
    /// Contact friction that varies along the surface; constant if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction: Option<FrictionVariation>,
}

/// True joints of a torque-controlled arm against stated ones. Lists have one entry per joint, base
/// to flange; a single entry applies to all joints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TorqueArmErrors {
    /// Periods by which a torque takes effect later than `arm.delay_periods` states.
    pub delay_periods: usize,
    /// Measured joint position minus the true one, constant, rad.
    pub offset_rad: Vec<f64>,
    /// Viscous and Coulomb friction over those of `arm`, ratio.
    pub friction_ratio: Vec<f64>,
    /// Friction at rest over Coulomb friction, ratio, at least 1: Stribeck's law, which a model of
    /// viscous and Coulomb friction does not have.
    pub static_ratio: f64,
    /// Speed at which the excess of the static friction has fallen to 37 %, rad/s.
    pub stribeck_rad_per_s: f64,
    /// Share by which Coulomb friction is higher in the joint's positive direction and lower in the
    /// negative one.
    pub asymmetry: f64,
}

impl Default for TorqueArmErrors {
    fn default() -> Self {
        Self {
            delay_periods: 0,
            offset_rad: vec![0.0],
            friction_ratio: vec![1.0],
            static_ratio: 1.0,
            stribeck_rad_per_s: 0.02,
            asymmetry: 0.0,
        }
    }
}

/// True observer of the external wrench against the stated one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WrenchEstimateErrors {
    /// Gain of the observer over `external_wrench.gain_per_s`, ratio.
    pub gain_ratio: f64,
    /// Periods by which the estimate is later than `external_wrench.delay_periods`.
    pub delay_periods: usize,
}

impl Default for WrenchEstimateErrors {
    fn default() -> Self {
        Self {
            gain_ratio: 1.0,
            delay_periods: 0,
        }
    }
}

impl TorqueErrors {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        self.frames.check()?;
        self.wrench.check()?;
        if let Some(friction) = &self.friction {
            friction.check()?;
        }
        let unless = PlantError::unless;
        let (arm, observer) = (&self.arm, &self.external_wrench);
        for (key, periods) in [
            ("errors.arm.delay_periods", arm.delay_periods),
            (
                "errors.external_wrench.delay_periods",
                observer.delay_periods,
            ),
        ] {
            let ok = periods <= DELAY_PERIODS_MAX;
            unless(key, periods as f64, "0 to 8", ok)?;
        }
        for &x in &arm.offset_rad {
            let allowed = "-0.1 to 0.1 rad";
            unless("errors.arm.offset_rad", x, allowed, x.abs() <= 0.1)?;
        }
        for &x in &arm.friction_ratio {
            let ok = (0.0..=10.0).contains(&x);
            unless("errors.arm.friction_ratio", x, "0 to 10", ok)?;
        }
        for (key, x, (low, high), allowed) in [
            (
                "errors.arm.static_ratio",
                arm.static_ratio,
                (1.0, 5.0),
                "1 to 5",
            ),
            (
                "errors.arm.stribeck_rad_per_s",
                arm.stribeck_rad_per_s,
                (1e-4, 10.0),
                "0.0001 to 10 rad/s",
            ),
            (
                "errors.arm.asymmetry",
                arm.asymmetry,
                (-0.9, 0.9),
                "-0.9 to 0.9",
            ),
            (
                "errors.external_wrench.gain_ratio",
                observer.gain_ratio,
                (0.1, 10.0),
                "0.1 to 10",
            ),
        ] {
            unless(key, x, allowed, (low..=high).contains(&x))?;
        }
        Ok(())
    }
}

/// The `[plant.errors_drawn]` table: ranges of errors that are drawn with the seed and added to
/// those of `[plant.errors]`. Everything in it is 0 by default: nothing is drawn. A range is the
/// largest size, of either sign unless stated otherwise; draws are uniform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ErrorRanges {
    /// Position of the tip along each of the tool's axes, m.
    pub tip_position_m: [f64; 3],
    /// Rotation of the tip about each of the tool's axes, rad.
    pub tip_rotation_rad: f64,
    /// Rotation of the force/torque sensor about each of its axes, rad.
    pub sensor_rotation_rad: f64,
    /// Mass of the payload, kg.
    pub payload_kg: f64,
    /// Centre of mass of the payload along each of the sensor's axes, m.
    pub payload_com_m: f64,
    /// Further delay of a torque, periods, from 0.
    pub delay_periods: usize,
    /// Constant error of a joint's position, rad.
    pub joint_offset_rad: f64,
    /// Relative change of each joint's friction.
    pub joint_friction: f64,
    /// Friction of the joints at rest beyond Coulomb friction, as a share of it, from 0.
    pub joint_static_excess: f64,
    /// Share by which Coulomb friction of the joints depends on the direction.
    pub joint_asymmetry: f64,
    /// Coloured noise of the force sensor, N, from 0; its torque has a lever of 20 mm.
    pub coloured_n: f64,
    /// Cross-talk of the force sensor, from 0.
    pub cross_talk: f64,
    /// Latency of the force sensor that its records do not tell, s, from 0.
    pub wrench_latency_s: f64,
    /// Relative change of the observer's gain.
    pub observer_gain: f64,
    /// Relative change of the contact friction along the surface, from 0.
    pub friction_variation: f64,
    /// Shortest and longest wavelength of that change, m.
    pub friction_wavelength_m: [f64; 2],
}

/// Lever of the coloured noise's torque, m.
const COLOURED_LEVER_M: f64 = 0.02;

impl ErrorRanges {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        let [x, y, z] = self.tip_position_m;
        let [short, long] = self.friction_wavelength_m;
        for (key, value, most) in [
            ("errors_drawn.tip_position_m", x, 0.05),
            ("errors_drawn.tip_position_m", y, 0.05),
            ("errors_drawn.tip_position_m", z, 0.05),
            ("errors_drawn.tip_rotation_rad", self.tip_rotation_rad, 0.2),
            (
                "errors_drawn.sensor_rotation_rad",
                self.sensor_rotation_rad,
                0.2,
            ),
            ("errors_drawn.payload_kg", self.payload_kg, 10.0),
            ("errors_drawn.payload_com_m", self.payload_com_m, 0.1),
            (
                "errors_drawn.delay_periods",
                self.delay_periods as f64,
                DELAY_PERIODS_MAX as f64,
            ),
            ("errors_drawn.joint_offset_rad", self.joint_offset_rad, 0.05),
            ("errors_drawn.joint_friction", self.joint_friction, 0.9),
            (
                "errors_drawn.joint_static_excess",
                self.joint_static_excess,
                2.0,
            ),
            ("errors_drawn.joint_asymmetry", self.joint_asymmetry, 0.9),
            ("errors_drawn.coloured_n", self.coloured_n, 10.0),
            ("errors_drawn.cross_talk", self.cross_talk, 0.1),
            ("errors_drawn.wrench_latency_s", self.wrench_latency_s, 0.05),
            ("errors_drawn.observer_gain", self.observer_gain, 0.8),
            (
                "errors_drawn.friction_variation",
                self.friction_variation,
                0.8,
            ),
            ("errors_drawn.friction_wavelength_m", short, 10.0),
            ("errors_drawn.friction_wavelength_m", long, 10.0),
        ] {
            let ok = (0.0..=most).contains(&value);
            PlantError::unless(key, value, "0 or above, and small", ok)?;
        }
        let ok = self.friction_variation == 0.0 || (0.001..=long).contains(&short);
        let key = "errors_drawn.friction_wavelength_m";
        PlantError::unless(
            key,
            short,
            "at least 0.001 m, and the shorter one first",
            ok,
        )
    }

    /// `errors` and `payload` with the errors of one seed added, for an arm with `joints` joints.
    pub(crate) fn added(
        &self,
        errors: &TorqueErrors,
        payload: &PayloadErrorConfig,
        joints: usize,
        seed: u64,
    ) -> (TorqueErrors, PayloadErrorConfig) {
        let (mut errors, mut payload) = (errors.clone(), payload.clone());
        if *self == Self::default() {
            return (errors, payload);
        }
        let mut dice = Dice::new(seed);
        let frames = &mut errors.frames;
        for (value, most) in frames.tip_position_m.iter_mut().zip(self.tip_position_m) {
            *value += dice.either(most);
        }
        for (values, most) in [
            (&mut frames.tip_rotation_rad, self.tip_rotation_rad),
            (&mut frames.sensor_rotation_rad, self.sensor_rotation_rad),
        ] {
            let turn = dice.vector(most);
            for (value, part) in values.iter_mut().zip(turn.iter()) {
                *value += part;
            }
        }
        payload.mass_kg += dice.either(self.payload_kg);
        let com = dice.vector(self.payload_com_m);
        for (value, part) in payload.com_in_sensor_m.iter_mut().zip(com.iter()) {
            *value += part;
        }
        let arm = &mut errors.arm;
        arm.delay_periods += dice.count(self.delay_periods);
        arm.offset_rad = (0..joints)
            .map(|i| entry(&arm.offset_rad, i, 0.0) + dice.either(self.joint_offset_rad))
            .collect();
        arm.friction_ratio = (0..joints)
            .map(|i| entry(&arm.friction_ratio, i, 1.0) * (1.0 + dice.either(self.joint_friction)))
            .collect();
        arm.static_ratio += dice.upto(self.joint_static_excess);
        arm.asymmetry += dice.either(self.joint_asymmetry);
        let wrench = &mut errors.wrench;
        let coloured_n = dice.upto(self.coloured_n);
        wrench.coloured_n += coloured_n;
        wrench.coloured_nm += coloured_n * COLOURED_LEVER_M;
        wrench.cross_talk += dice.upto(self.cross_talk);
        wrench.latency_s += dice.upto(self.wrench_latency_s);
        errors.external_wrench.gain_ratio *= 1.0 + dice.either(self.observer_gain);
        let (relative, share) = (dice.upto(self.friction_variation), dice.upto(1.0));
        if self.friction_variation > 0.0 {
            let [short, long] = self.friction_wavelength_m;
            errors.friction = Some(FrictionVariation {
                relative,
                wavelength_m: short * (long / short).powf(share),
            });
        }
        (errors, payload)
    }
}

/// Entry of a joint in a list whose last entry holds for the remaining joints.
pub(crate) fn entry(list: &[f64], joint: usize, empty: f64) -> f64 {
    list.get(joint).or(list.last()).copied().unwrap_or(empty)
}

/// Random numbers of the drawn errors.
struct Dice(Pcg64Mcg);

impl Dice {
    fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed ^ 0x5e1f_9a30_c47d_b286))
    }

    fn upto(&mut self, most: f64) -> f64 {
        let share: f64 = self.0.random();
        share * most
    }

    fn either(&mut self, most: f64) -> f64 {
        2.0 * self.upto(most) - most
    }

    fn vector(&mut self, most: f64) -> Vector3<f64> {
        Vector3::new(self.either(most), self.either(most), self.either(most))
    }

    /// A number from 0 to `most`.
    fn count(&mut self, most: usize) -> usize {
        (self.upto(most as f64 + 1.0) as usize).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranges() -> ErrorRanges {
        ErrorRanges {
            tip_position_m: [0.001, 0.001, 0.002],
            tip_rotation_rad: 0.01,
            sensor_rotation_rad: 0.02,
            payload_kg: 0.02,
            payload_com_m: 0.002,
            delay_periods: 2,
            joint_offset_rad: 3e-4,
            joint_friction: 0.2,
            joint_static_excess: 0.4,
            joint_asymmetry: 0.1,
            coloured_n: 0.1,
            cross_talk: 0.01,
            wrench_latency_s: 0.004,
            observer_gain: 0.2,
            friction_variation: 0.2,
            friction_wavelength_m: [0.01, 0.1],
        }
    }

    #[test]
    fn nothing_is_drawn_by_default() {
        let (errors, payload) = (TorqueErrors::default(), PayloadErrorConfig::default());
        let drawn = ErrorRanges::default().added(&errors, &payload, 6, 3);
        assert_eq!(drawn, (errors, payload));
    }

    #[test]
    fn draws_follow_from_the_seed_and_stay_within_their_ranges() {
        let (errors, payload) = (TorqueErrors::default(), PayloadErrorConfig::default());
        let draw = |seed| ranges().added(&errors, &payload, 6, seed);
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        ranges().check().unwrap();
        let (mut delays, mut largest) = ([0; 3], 0.0_f64);
        for seed in 0..300 {
            let (drawn, payload) = draw(seed);
            drawn.check().unwrap();
            delays[drawn.arm.delay_periods] += 1;
            assert_eq!(drawn.arm.offset_rad.len(), 6);
            assert!(drawn.arm.offset_rad.iter().all(|x| x.abs() <= 3e-4));
            assert!(payload.mass_kg.abs() <= 0.02);
            assert!((1.0..=1.4).contains(&drawn.arm.static_ratio));
            let wavelength = drawn.friction.unwrap().wavelength_m;
            assert!((0.01..=0.1).contains(&wavelength));
            largest = largest.max(drawn.frames.tip_position_m[2].abs());
        }
        assert!(delays.iter().all(|count| *count > 60), "{delays:?}");
        assert!((0.0019..=0.002).contains(&largest), "{largest}");
    }
}

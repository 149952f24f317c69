//! Compares the force that the arm itself feels with that of the sensor.
//!
//! A sensor that has died in free space, with its noise alive, looks as free space does: only a
//! second witness tells that the tool has touched. The arm's own force is far less accurate (UR
//! states 10 N for a CB3 arm, from its motors' currents), and its zero changes with the pose and
//! the direction of motion. It is taken at the start of each motion towards a surface, and kept
//! while the force builds up; other motions are compared with that of the motions before, by a
//! wider bound.

use nalgebra::Vector3;

use super::clamp_norm;
use crate::phase_machine::Phase;

/// Time constant of the smoothing of the difference, s.
const SMOOTH_S: f64 = 0.1;
/// Time from the start of a motion over which the zero of the difference is averaged, s.
const ZERO_S: f64 = 0.2;
/// Bound in any motion, as a multiple of that in the motion in which the zero was taken.
const ANY_MOTION: f64 = 2.0;
/// Share of the sensor's force by which the bound is wider: an error of the scale.
const SCALE_SHARE: f64 = 0.5;
/// Largest change of the zero for other motions by one motion towards a surface, N.
const RENEWED_N: f64 = 10.0;

/// What the tool does, for the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moving {
    /// It touches nothing, and the sensor may get another zero.
    Apart,
    /// Towards a surface.
    In,
    /// Stopped on the way there for a moment.
    Stopped,
    /// Into the surface that it has met so, while the force builds up.
    Pressing,
    /// Any other way.
    Other,
}

impl Moving {
    /// What the tool does in `phase`; `stopped` is the phase that a missing wrench interrupted.
    pub fn of(phase: Phase, stopped: Option<Phase>) -> Self {
        match (phase, stopped) {
            (Phase::Approach | Phase::Seek, _) => Self::In,
            (Phase::Contact, _) => Self::Pressing,
            (_, Some(Phase::Approach | Phase::Seek)) => Self::Stopped,
            (apart, _) if apart.is_before_approach() => Self::Apart,
            _ => Self::Other,
        }
    }
}

/// Both forces of one cycle, N, in the same axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TwoForces {
    /// Force of the environment as the arm itself feels it.
    pub arm: Vector3<f64>,
    /// Force of the sensor.
    pub sensor: Vector3<f64>,
}

impl TwoForces {
    /// Both forces, if there are both.
    pub fn of(arm: Option<Vector3<f64>>, sensor: Option<Vector3<f64>>) -> Option<Self> {
        let (arm, sensor) = arm.zip(sensor)?;
        Some(Self { arm, sensor })
    }
}

/// Zero of the difference in a motion towards a surface, N.
#[derive(Clone, Copy, Debug)]
struct MotionZero {
    mean: Vector3<f64>,
    time_s: f64,
}

/// State of the comparison for one task. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ArmForceGuard {
    smooth: Option<Vector3<f64>>,
    /// Zero of the present motion towards a surface.
    motion: Option<MotionZero>,
    /// Zero of the motions before.
    task: Option<Vector3<f64>>,
}

impl ArmForceGuard {
    /// Processes one cycle; `forces` is `None` if one of them is missing or old. Returns whether
    /// the arm feels more than `most_n` that the sensor does not.
    pub fn step(
        &mut self,
        moving: Moving,
        forces: Option<TwoForces>,
        most_n: f64,
        dt_s: f64,
    ) -> bool {
        if moving == Moving::Apart {
            *self = Self::default();
            return false;
        }
        let Some(forces) = forces else {
            return false;
        };
        let difference = forces.arm - forces.sensor;
        if moving == Moving::Stopped || !difference.iter().all(|x| x.is_finite()) {
            return false;
        }
        let smooth = self.smooth.get_or_insert(difference);
        *smooth += (difference - *smooth) * (dt_s / (dt_s + SMOOTH_S));
        let smooth = *smooth;
        let wider_n = SCALE_SHARE * forces.sensor.norm();
        let beyond = |zero: &Vector3<f64>, most| (smooth - zero).norm() > most + wider_n;
        let in_motion = match (moving, &mut self.motion) {
            (Moving::In, motion) => {
                let zero = motion.get_or_insert(MotionZero {
                    mean: Vector3::zeros(),
                    time_s: 0.0,
                });
                let before_s = zero.time_s;
                zero.time_s += dt_s;
                if zero.time_s <= ZERO_S {
                    zero.mean += (difference - zero.mean) * (dt_s / zero.time_s);
                } else if before_s <= ZERO_S {
                    let task = self.task.get_or_insert(zero.mean);
                    *task += clamp_norm(zero.mean - *task, RENEWED_N);
                }
                beyond(&zero.mean, most_n)
            }
            (Moving::Pressing, Some(zero)) if zero.time_s > ZERO_S => beyond(&zero.mean, most_n),
            (_, motion) => {
                *motion = None;
                false
            }
        };
        in_motion || (self.task).is_some_and(|zero| beyond(&zero, ANY_MOTION * most_n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST_N: f64 = 30.0;

    fn arm(force: Vector3<f64>) -> Option<TwoForces> {
        Some(TwoForces {
            arm: force,
            sensor: Vector3::zeros(),
        })
    }

    fn felt(force_n: f64) -> Option<TwoForces> {
        arm(Vector3::new(0.0, 0.0, force_n))
    }

    /// A guard after 0.8 s of a motion towards a surface without a force.
    fn moved() -> ArmForceGuard {
        let mut guard = ArmForceGuard::default();
        for _ in 0..100 {
            assert!(!guard.step(Moving::In, felt(5.0), MOST_N, 0.008));
        }
        guard
    }

    fn finds(guard: &mut ArmForceGuard, moving: Moving, forces: Option<TwoForces>) -> bool {
        (0..100).any(|_| guard.step(moving, forces, MOST_N, 0.008))
    }

    /// Largest force (N) of the arm alone that goes unnoticed as it rises by `per_s` N/s after
    /// `free_s`, beside an offset and a ripple of 10 N each.
    fn unnoticed_n(per_s: f64, free_s: f64, dt_s: f64) -> f64 {
        let mut guard = ArmForceGuard::default();
        for k in 0..100_000 {
            let time_s = f64::from(k) * dt_s;
            let force = per_s * (time_s - free_s).max(0.0);
            let ripple = 10.0 * (300.0 * time_s).sin();
            let forces = arm(Vector3::new(10.0, -10.0, -force + ripple));
            if guard.step(Moving::In, forces, MOST_N, dt_s) {
                return force;
            }
        }
        panic!("not noticed");
    }

    #[test]
    fn a_force_that_the_sensor_does_not_show_is_found() {
        for dt_s in [0.002, 0.008] {
            for per_s in [5.0, 50.0, 200.0] {
                // The smoothing's lag; a touch at the start of the motion also moves the zero.
                for (free_s, late_s) in [(3.0, SMOOTH_S), (0.0, SMOOTH_S + 0.5 * ZERO_S)] {
                    let force = unnoticed_n(per_s, free_s, dt_s);
                    let most = MOST_N + 6.0 + per_s * late_s;
                    assert!((MOST_N - 6.0..most).contains(&force), "{force} of {most}");
                }
            }
        }
    }

    #[test]
    fn an_offset_and_the_noise_of_the_arm_are_no_force() {
        let mut guard = ArmForceGuard::default();
        for k in 0..10_000 {
            let noise = 10.0 * f64::from(k * k % 7 - 3);
            let forces = arm(Vector3::new(15.0, 40.0 + noise, -25.0));
            assert!(!guard.step(Moving::In, forces, MOST_N, 0.008));
        }
    }

    #[test]
    fn a_missing_or_broken_value_and_a_stop_keep_the_zero_and_a_new_motion_takes_its_own() {
        let mut guard = moved();
        for broken in [None, felt(f64::NAN), felt(f64::INFINITY)] {
            assert!(!guard.step(Moving::In, broken, MOST_N, 0.008));
        }
        assert!(!guard.step(Moving::Stopped, felt(45.0), MOST_N, 0.008));
        assert!(finds(&mut guard, Moving::In, felt(45.0)));
        assert!(!guard.step(Moving::Other, felt(45.0), MOST_N, 0.008));
        assert!(!finds(&mut guard, Moving::In, felt(45.0)));
    }

    /// The bug: a sensor that died as the force built up was found only at twice the bound.
    #[test]
    fn while_the_force_builds_up_the_bound_is_that_of_the_motion_before() {
        let pressing = Moving::of(Phase::Contact, None);
        assert!(!finds(&mut moved(), pressing, felt(34.0)));
        assert!(finds(&mut moved(), pressing, felt(37.0)));
        // Without a motion of which the zero is known, and after another motion, it is wider.
        let mut short = ArmForceGuard::default();
        let mut slid = moved();
        short.step(Moving::In, felt(5.0), MOST_N, 0.008);
        slid.step(Moving::Other, felt(5.0), MOST_N, 0.008);
        assert!(!finds(&mut short, pressing, felt(60.0)));
        assert!(!finds(&mut slid, pressing, felt(60.0)));
    }

    #[test]
    fn while_the_tool_slides_the_bound_is_wider_and_more_so_by_the_sensors_force() {
        assert!(!finds(&mut moved(), Moving::Other, felt(60.0)));
        assert!(finds(&mut moved(), Moving::Other, felt(70.0)));
        // An arm that reads twice what the sensor does.
        let pressed = TwoForces {
            arm: Vector3::z() * 160.0,
            sensor: Vector3::z() * 80.0,
        };
        assert!(!finds(&mut moved(), Moving::Other, Some(pressed)));
    }

    /// The bug: the sensor's zero, subtracted in one cycle, was a force of the arm in the next.
    #[test]
    fn the_sensors_zero_is_no_force_of_the_arm() {
        let mut guard = moved();
        let raw = TwoForces {
            arm: Vector3::zeros(),
            sensor: Vector3::new(10.0, 0.0, 80.0),
        };
        for phase in [Phase::Clear, Phase::Tare] {
            let moving = Moving::of(phase, None);
            assert!(!finds(&mut guard, moving, Some(raw)));
        }
        assert!(!finds(
            &mut guard,
            Moving::of(Phase::Approach, None),
            felt(0.0)
        ));
    }
}

//! Compares the force that the arm itself feels with that of the sensor.
//!
//! A sensor that has died in free space, with its noise alive, looks as free space does: only a
//! second witness tells that the tool has touched. The arm's own force is far less accurate (UR
//! states 10 N for a CB3 arm, from its motors' currents), and its zero changes with the pose and
//! the direction of motion. It is taken at the start of each motion towards a surface; other
//! motions are compared with that of the first one, by a wider bound.

use nalgebra::Vector3;

/// Time constant of the smoothing of the difference, s.
const SMOOTH_S: f64 = 0.1;
/// Time from the start of a motion over which the zero of the difference is averaged, s.
const ZERO_S: f64 = 0.4;
/// Bound in any motion, as a multiple of that in the motion in which the zero was taken.
const ANY_MOTION: f64 = 2.0;

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
    /// Zero of the first such motion.
    task: Option<Vector3<f64>>,
}

impl ArmForceGuard {
    /// Processes one cycle. `moves_in`: whether the tool moves towards a surface; `difference`:
    /// force of the arm less that of the sensor, N; `None` without one of them. Returns
    /// whether the arm feels more than `most_n` that the sensor does not.
    pub fn step(
        &mut self,
        moves_in: bool,
        difference: Option<Vector3<f64>>,
        most_n: f64,
        dt_s: f64,
    ) -> bool {
        let Some(difference) = difference.filter(|d| d.iter().all(|x| x.is_finite())) else {
            return false;
        };
        let smooth = self.smooth.get_or_insert(difference);
        *smooth += (difference - *smooth) * (dt_s / (dt_s + SMOOTH_S));
        let smooth = *smooth;
        let beyond = |zero: &Vector3<f64>, most| (smooth - zero).norm() > most;
        let in_motion = if moves_in {
            let zero = self.motion.get_or_insert(MotionZero {
                mean: Vector3::zeros(),
                time_s: 0.0,
            });
            zero.time_s += dt_s;
            if zero.time_s <= ZERO_S {
                zero.mean += (difference - zero.mean) * (dt_s / zero.time_s);
            } else {
                self.task.get_or_insert(zero.mean);
            }
            beyond(&zero.mean, most_n)
        } else {
            self.motion = None;
            false
        };
        in_motion
            || self
                .task
                .is_some_and(|zero| beyond(&zero, ANY_MOTION * most_n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST_N: f64 = 30.0;

    /// Largest force (N) of the arm alone that goes unnoticed as it rises by `per_s` N/s after
    /// `free_s`, beside an offset and a ripple of 10 N each.
    fn unnoticed_n(per_s: f64, free_s: f64, dt_s: f64) -> f64 {
        let mut guard = ArmForceGuard::default();
        for k in 0..100_000 {
            let time_s = f64::from(k) * dt_s;
            let force = per_s * (time_s - free_s).max(0.0);
            let ripple = 10.0 * (300.0 * time_s).sin();
            let difference = Vector3::new(10.0, -10.0, -force + ripple);
            if guard.step(true, Some(difference), MOST_N, dt_s) {
                return force;
            }
        }
        panic!("not noticed");
    }

    #[test]
    fn a_force_that_the_sensor_does_not_show_is_found() {
        for dt_s in [0.002, 0.008] {
            for free_s in [0.0, 0.2, 3.0] {
                for per_s in [5.0, 50.0, 200.0] {
                    let force = unnoticed_n(per_s, free_s, dt_s);
                    // The smoothing's lag, and what rose while the zero was taken.
                    let late = per_s * (SMOOTH_S + ZERO_S);
                    assert!(
                        (MOST_N - 5.0..MOST_N + 5.0 + late).contains(&force),
                        "{force}"
                    );
                }
            }
        }
    }

    #[test]
    fn an_offset_and_the_noise_of_the_arm_are_no_force() {
        let mut guard = ArmForceGuard::default();
        for k in 0..10_000 {
            let noise = 10.0 * f64::from(k * k % 7 - 3);
            let difference = Vector3::new(15.0, 40.0 + noise, -25.0);
            assert!(!guard.step(true, Some(difference), MOST_N, 0.008));
        }
    }

    #[test]
    fn a_missing_or_broken_value_keeps_the_zero_and_a_new_motion_takes_its_own() {
        let mut guard = ArmForceGuard::default();
        let felt = |force| Some(Vector3::new(0.0, 0.0, force));
        for _ in 0..100 {
            assert!(!guard.step(true, felt(5.0), MOST_N, 0.008));
        }
        for broken in [None, felt(f64::NAN), felt(f64::INFINITY)] {
            assert!(!guard.step(true, broken, MOST_N, 0.008));
        }
        let found = (0..100).any(|_| guard.step(true, felt(45.0), MOST_N, 0.008));
        assert!(found);
        assert!(!guard.step(false, felt(45.0), MOST_N, 0.008));
        for _ in 0..1000 {
            assert!(!guard.step(true, felt(45.0), MOST_N, 0.008));
        }
    }

    #[test]
    fn while_the_tool_slides_the_bound_is_wider() {
        let after = |force| {
            let mut guard = ArmForceGuard::default();
            for _ in 0..100 {
                assert!(!guard.step(true, Some(Vector3::zeros()), MOST_N, 0.008));
            }
            (0..100).any(|_| guard.step(false, Some(Vector3::x() * force), MOST_N, 0.008))
        };
        assert!(!after(55.0));
        assert!(after(65.0));
    }
}

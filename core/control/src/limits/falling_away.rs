//! Whether the surface ends or falls away under the tool.
//!
//! Called by `response_guard` in each cycle. A tool that moves in without an answer, or is held
//! aside, with much less force than it had pressed with, may be over a rim; or the surface is
//! steeper than the normal in use says, and the force law cannot follow at this speed. So the first
//! such sign is a doubt, in which the path should stand. On a surface the force then comes back.
//!
//! A wide tip that rolls around a rim still gets an answer: less force than it should press with,
//! from the rim, while it moves further in than any contact gives.

use nalgebra::Vector3;

use crate::contact::alignment::depth_and_across;

/// Time constant of the means, s; shares of the reference that the pressing force has reached
/// and below which it has fallen.
const MEAN_S: f64 = 0.04;
const REACHED_SHARE: f64 = 0.8;
const FALLEN_SHARE: f64 = 0.7;
/// Time that the path takes to stand, s.
const BRAKES_S: f64 = 0.2;
/// Distance into the surface with too little force, m, after which there is no surface, beyond the
/// distance over which a contact of the least stiffness, N/m, gives the reference.
const IN_M: f64 = 0.01;
const SOFTEST_N_PER_M: f64 = 500.0;
/// Share of a distance along the surface that a wrong normal, by up to 25 degrees, turns into one
/// into it.
const WRONG_NORMAL: f64 = 0.47;

/// Force in one cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Felt {
    /// Whether the tool is meant to press.
    pub pressing: bool,
    /// Part of the force along the normal in use, and the whole force, N.
    pub force_n: f64,
    pub whole_n: f64,
    /// Reference of the pressing force, N.
    pub reference_n: f64,
    /// Motion since the last cycle, m, and normal in use, out of the material.
    pub step: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Period, s.
    pub dt_s: f64,
}

/// State for one task. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FallingAway {
    /// Means of the pressing force and of the whole force, N.
    mean_n: f64,
    whole_n: f64,
    /// Mean velocity, m/s: noise of the position must not pass for a motion.
    velocity: Vector3<f64>,
    /// Whether the first has reached its reference in this task.
    reached: bool,
    /// Time since the first sign, s, until the force is back.
    doubted_s: Option<f64>,
    /// Distance into the surface since the force was there, m, less what a wrong normal explains.
    in_m: f64,
    ended: bool,
}

impl FallingAway {
    /// Processes the force of one cycle; returns whether a tool that had pressed with its reference
    /// now presses with much less.
    pub fn presses_less(&mut self, felt: &Felt) -> bool {
        let share = felt.dt_s / (felt.dt_s + MEAN_S);
        self.mean_n += (felt.force_n - self.mean_n) * share;
        self.whole_n += (felt.whole_n - self.whole_n) * share;
        self.velocity += (felt.step - self.velocity * felt.dt_s) / (felt.dt_s + MEAN_S);
        let reaches = self.mean_n >= REACHED_SHARE * felt.reference_n;
        self.reached |= felt.pressing && reaches;
        if reaches || !felt.pressing {
            self.doubted_s = None;
            self.in_m = 0.0;
        } else if self.reached {
            let way = self.velocity * felt.dt_s;
            let (deeper_m, across_m) = depth_and_across(&way, &felt.normal);
            self.in_m = (self.in_m + deeper_m - WRONG_NORMAL * across_m).max(0.0);
            self.ended |= self.in_m > IN_M + felt.reference_n / SOFTEST_N_PER_M;
        }
        // A force that has only turned aside is not less: that is the sensor, not the surface.
        // Once it has been less, what is aside is the rim.
        let fallen_n = match self.doubted_s {
            None => self.mean_n.max(self.whole_n) / FALLEN_SHARE,
            Some(_) => self.mean_n / REACHED_SHARE,
        };
        felt.pressing && self.reached && fallen_n < felt.reference_n
    }

    /// Takes one cycle in which the tool presses less; `shown`: it has moved in without an answer,
    /// or is held aside. Returns whether to look for such a sign anew: one from before the path
    /// stood says nothing.
    pub fn looks_again(&mut self, shown: bool, dt_s: f64) -> bool {
        match &mut self.doubted_s {
            None => {
                self.doubted_s = shown.then_some(0.0);
                shown
            }
            Some(doubted_s) if *doubted_s < BRAKES_S => {
                *doubted_s += dt_s;
                true
            }
            Some(_) => {
                self.ended |= shown;
                false
            }
        }
    }

    /// Whether there was a sign, and the force is not back since.
    pub fn is_doubted(&self) -> bool {
        self.doubted_s.is_some()
    }

    /// Whether the surface ends or falls away: there was a sign when the path stood, or the tool
    /// moved in too far.
    pub fn has_ended(&self) -> bool {
        self.ended
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.008;

    /// A tool that has pressed with `reference_n` and then moves by `velocity` (m/s) under the
    /// force that `force_n` gives by the distance into the surface; that distance, m, where the
    /// surface counts as ended, within `most_m`.
    fn ended_at_m(
        reference_n: f64,
        velocity: Vector3<f64>,
        noise_m: f64,
        most_m: f64,
        force_n: impl Fn(f64) -> f64,
    ) -> Option<f64> {
        let felt = |step, force_n: f64| Felt {
            pressing: true,
            force_n,
            whole_n: force_n,
            reference_n,
            step,
            normal: Vector3::z(),
            dt_s: DT_S,
        };
        let mut fall = FallingAway::default();
        for _ in 0..100 {
            fall.presses_less(&felt(Vector3::zeros(), reference_n));
        }
        let (mut in_m, mut before) = (0.0, Vector3::zeros());
        for k in 0.. {
            in_m -= velocity.z * DT_S;
            let noise = Vector3::new(0.0, noise_m, 0.0) * f64::from(k % 2);
            let step = velocity * DT_S + noise - std::mem::replace(&mut before, noise);
            fall.presses_less(&felt(step, force_n(in_m)));
            if fall.has_ended() {
                return Some(in_m);
            }
            if in_m > most_m {
                return None;
            }
        }
        None
    }

    #[test]
    fn a_tool_that_moves_in_far_with_less_force_is_beside_the_surface() {
        // The rim presses more or less, never as it should.
        let rim_n = |in_m: f64| 1.2 + 0.6 * (in_m / 1e-3).sin();
        let down = Vector3::new(0.0, 0.0, -0.006);
        for noise_m in [0.0, 2e-5] {
            let way = ended_at_m(3.0, down, noise_m, 0.1, rim_n).unwrap();
            assert!((0.016..0.025).contains(&way), "{noise_m}: {way}");
        }
    }

    #[test]
    fn a_force_that_comes_back_now_and_then_is_a_surface() {
        let wavy_n = |in_m: f64| 2.1 + 0.9 * (in_m / 1e-3).sin();
        let down = Vector3::new(0.0, 0.0, -0.006);
        assert_eq!(ended_at_m(3.0, down, 0.0, 0.1, wavy_n), None);
    }

    #[test]
    fn a_slope_that_the_normal_in_use_does_not_know_is_a_surface() {
        let downhill = |angle: f64| Vector3::new(angle.cos(), 0.0, -angle.sin()) * 0.02;
        let light = |_: f64| 1.5;
        assert_eq!(ended_at_m(3.0, downhill(0.42), 0.0, 0.1, light), None);
        assert!(ended_at_m(3.0, downhill(1.2), 0.0, 0.1, light).is_some());
    }

    #[test]
    fn a_soft_tool_gets_its_way() {
        let down = Vector3::new(0.0, 0.0, -0.006);
        let soft_n = |in_m: f64| (600.0 * in_m).min(30.0);
        assert_eq!(ended_at_m(30.0, down, 0.0, 0.1, soft_n), None);
    }
}

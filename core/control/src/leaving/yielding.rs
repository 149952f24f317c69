//! What a tool does that has met something on its way off: it gives way along the force until
//! little of it is left.
//!
//! An arm that merely stops stays where it came to rest, as deep in the obstacle as its own lag let
//! it go, and presses there until somebody moves it. Called by the velocity-controlled law; under a
//! torque law, the arm itself gives way.

use nalgebra::Vector3;

/// Load below which the tool may rest, as a share of the rise that opposed the motion.
const REST_SHARE: f64 = 0.5;
/// Least speed, m/s: the last newtons of a soft obstacle would take seconds otherwise.
const LEAST_M_PER_S: f64 = 0.001;
/// Longest way, m, and longest time, s.
const MOST_M: f64 = 0.01;
const MOST_S: f64 = 4.0;
/// Way from the place of the largest load after which it must have fallen to this share, m: a
/// reading that stays is not answered by more motion.
const ANSWERS_WITHIN_M: f64 = 0.001;
const FALLEN_SHARE: f64 = 0.9;

/// Rules of one motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct YieldRules {
    /// Damping against the force, Ns/m: stable on the stiffest contact.
    pub damping_n_s_per_m: f64,
    /// Highest speed, m/s.
    pub speed_max_m_per_s: f64,
}

/// State of one motion. Loads are relative to the force of a free tool, or to the least one felt if
/// the zero cannot be trusted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Yielding {
    /// Force that counts as none, base axes, N.
    none: Vector3<f64>,
    /// Load with which the tool may rest, N.
    rest_n: f64,
    from: Vector3<f64>,
    /// Largest load, N, and where it was felt, m.
    most: (f64, Vector3<f64>),
    /// Velocity, base axes, m/s.
    pub velocity: Vector3<f64>,
    elapsed_s: f64,
}

impl Yielding {
    /// From `position` (m), with `none` the force that counts as none (N); base axes. `opposed_n`
    /// (N) is the rise of the load that opposed the motion.
    pub fn new(position: Vector3<f64>, none: Vector3<f64>, opposed_n: f64) -> Self {
        Self {
            none,
            rest_n: REST_SHARE * opposed_n,
            from: position,
            most: (0.0, position),
            velocity: Vector3::zeros(),
            elapsed_s: 0.0,
        }
    }

    /// Processes one cycle with the tool at `position` (m) under `force` (N), base axes. Returns
    /// whether the tool still gives way, with its [`Yielding::velocity`].
    pub fn step(
        &mut self,
        rules: &YieldRules,
        position: &Vector3<f64>,
        force: &Vector3<f64>,
        dt_s: f64,
    ) -> bool {
        self.elapsed_s += dt_s;
        let load = force - self.none;
        let load_n = load.norm();
        if load_n > self.most.0 {
            self.most = (load_n, *position);
        }
        let back_m = (position - self.most.1).norm();
        let stays = back_m > ANSWERS_WITHIN_M && load_n > FALLEN_SHARE * self.most.0;
        let astray = (position - self.from).norm() > MOST_M || self.elapsed_s > MOST_S;
        if load_n <= self.rest_n || stays || astray {
            self.velocity = Vector3::zeros();
            return false;
        }
        let speed = (load_n - self.rest_n) / rules.damping_n_s_per_m;
        let speed = speed.max(LEAST_M_PER_S).min(rules.speed_max_m_per_s);
        self.velocity = load * (speed / load_n);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: YieldRules = YieldRules {
        damping_n_s_per_m: 1e4,
        speed_max_m_per_s: 0.02,
    };

    /// Gives way to `force_at`, starting at 1 mm; returns where it stands then, and after how long,
    /// m and s.
    fn gives_way(none: f64, force_at: impl Fn(f64) -> f64) -> (f64, f64) {
        let mut way_m = 1e-3;
        let mut yielding = Yielding::new(Vector3::z() * way_m, Vector3::z() * none, 5.0);
        for k in 0..10_000 {
            let (at, force) = (Vector3::z() * way_m, Vector3::z() * force_at(way_m));
            if !yielding.step(&RULES, &at, &force, 1e-3) {
                return (way_m, 1e-3 * f64::from(k));
            }
            way_m += yielding.velocity.z * 1e-3;
        }
        panic!("it never ends");
    }

    #[test]
    fn the_load_falls_and_the_tool_rests_with_little_of_it() {
        for stiffness in [2e3, 2e4, 1e5] {
            let wall = |way: f64| -stiffness * way.max(0.0);
            let (way_m, _) = gives_way(0.0, wall);
            assert!(
                (1.0..=2.5).contains(&-wall(way_m)) || stiffness * 1e-3 < 2.5,
                "{way_m}"
            );
            // The same with a zero that is off by 8 N.
            let (other_m, _) = gives_way(8.0, |way| wall(way) + 8.0);
            assert!((way_m - other_m).abs() < 1e-9);
        }
    }

    #[test]
    fn a_reading_that_does_not_answer_ends_it_after_a_millimetre() {
        let (way_m, _) = gives_way(0.0, |_| -30.0);
        assert!((way_m - 1e-3).abs() < 1.1e-3, "{way_m}");
    }

    #[test]
    fn it_ends_in_any_case() {
        // Softer than anything it may meet, and one that moves after the tool.
        let (way_m, after_s) = gives_way(0.0, |way| -10.0 - 300.0 * way.max(-0.02));
        assert!(way_m.abs() < 0.012 && after_s <= 4.0, "{way_m} {after_s}");
    }
}

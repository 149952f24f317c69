//! What the force shows while the tool moves away from the surface: that the tool is free, or that
//! an obstacle opposes the motion.
//!
//! Called in phase `clear`, in lifts and in the retraction, each cycle.

use nalgebra::Vector3;

use crate::leaving::config::LeaveConfig;
use crate::leaving::moves_in::MovesIn;
use crate::leaving::retreat::{Ceiling, Met, Retreat};

/// Time constant of the average of the force before the test for steadiness, s: the sensor's noise
/// must not look like a touch.
const STEADY_S: f64 = 0.02;

/// Monitors the force while the tool moves away. Only differences count, so that any zero will do.
/// Each motion needs a new monitor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LeaveWatch {
    /// Force at the start, base axes, N.
    first: Option<Vector3<f64>>,
    /// Motion towards the surface in phase `clear`.
    towards: MovesIn,
    /// Low-pass filtered force, base axes, N.
    mean: Option<Vector3<f64>>,
    /// Where the mean force took its present value, and that value.
    steady: Option<(f64, Vector3<f64>)>,
    /// Whether the force was steady over the required distance and has not changed since.
    free: bool,
    retreat: Option<Retreat>,
}

impl LeaveWatch {
    /// Processes one cycle of phase `clear`: the tool is `way_m` (m) along `normal` (unit) from its
    /// start, and `force` acts on it in the same axes. `release_max_n` is the largest force with
    /// which anything can have pressed, N.
    pub fn clear(
        &mut self,
        config: &LeaveConfig,
        normal: &Vector3<f64>,
        way_m: f64,
        force: &Vector3<f64>,
        release_max_n: f64,
        dt_s: f64,
    ) -> Leaving {
        let first = self.first.get_or_insert(*force);
        // An arm that still moves in presses harder until it has turned around: that is no
        // obstacle.
        if self.towards.step(way_m, dt_s) && (force - *first).dot(normal) > 0.0 {
            *first = *force;
        }
        let change = force - *first;
        let along = change.dot(normal);
        let across = (change - normal * along).norm();
        // A surface that pressed along the normal releases; an obstacle pushes back in the same
        // direction, and beyond zero.
        if along > config.grow_n
            || along < -(release_max_n + config.grow_n)
            || across > release_max_n + config.grow_n
        {
            return Leaving::Opposed;
        }
        self.steadiness(config, way_m, force, dt_s)
    }

    /// Processes one cycle of a retraction. It is opposed if the load rises too far above its
    /// minimum since the start, if it exceeds both `ceiling` and the load at the start, or if the
    /// untared reading goes beyond its limit.
    pub fn retract(&mut self, config: &LeaveConfig, ceiling: &Ceiling, met: &Met) -> Leaving {
        let retreat = match &mut self.retreat {
            // Another zero makes the readings incomparable.
            Some(retreat) if retreat.zeroed == met.zeroed => retreat,
            other => other.insert(Retreat::begin(met)),
        };
        if retreat.is_opposed(config, ceiling, met) {
            return Leaving::Opposed;
        }
        let way_m = met.position.dot(&met.along);
        self.steadiness(config, way_m, &met.force, met.dt_s)
    }

    /// Force that counts as none, base axes, N: zero in a retraction with a zero that can be
    /// trusted; otherwise the least one felt since the start, and in phase `clear` the first one.
    pub fn none(&self) -> Vector3<f64> {
        match self.retreat {
            Some(retreat) => retreat.none(),
            None => self.first.unwrap_or_default(),
        }
    }

    /// Marks a cycle without a wrench: earlier steadiness no longer counts.
    pub fn blind(&mut self) {
        self.mean = None;
        self.steady = None;
        self.free = false;
    }

    fn steadiness(
        &mut self,
        config: &LeaveConfig,
        way_m: f64,
        force: &Vector3<f64>,
        dt_s: f64,
    ) -> Leaving {
        let mean = self.mean.get_or_insert(*force);
        *mean += (force - *mean) * (dt_s / STEADY_S).min(1.0);
        let (from, since) = *self.steady.get_or_insert((way_m, *mean));
        if (*mean - since).norm() > config.steady_n || way_m < from {
            self.steady = Some((way_m, *mean));
            self.free = false;
        } else if way_m - from >= config.free_m {
            // The reference moves on: over a long distance the inertial force of the tool's load
            // comes and goes.
            self.steady = Some((way_m, *mean));
            self.free = true;
        }
        if self.free {
            Leaving::Free
        } else {
            Leaving::Going
        }
    }
}

/// What the force shows about a motion away from the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Leaving {
    /// Undecided so far.
    #[default]
    Going,
    /// The force has been steady over the required distance: the tool is free.
    Free,
    /// An obstacle opposes the motion.
    Opposed,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moves away from a contact force of `force_at`; returns the result and the distance, m.
    fn clear(force_at: impl Fn(f64) -> Vector3<f64>) -> (Leaving, f64) {
        let (config, mut watch) = (LeaveConfig::default(), LeaveWatch::default());
        let n = Vector3::z();
        for step in 0..500 {
            let way = 1e-4 * f64::from(step);
            match watch.clear(&config, &n, way, &force_at(way), 10.0, 0.01) {
                Leaving::Going => {}
                ended => return (ended, way),
            }
        }
        (Leaving::Going, 0.05)
    }

    #[test]
    fn what_presses_lets_go_and_then_the_way_is_free() {
        for stiffness in [500.0, 2e3, 2e4] {
            // With a zero that hides all of the force, or none.
            for hidden in [0.0, 6.0, 60.0] {
                let (ended, way) =
                    clear(|way| Vector3::z() * ((6.0 - stiffness * way).max(0.0) - hidden));
                assert_eq!(ended, Leaving::Free);
                assert!(
                    way >= 6.0 / stiffness - 0.002 && way < 6.0 / stiffness + 0.007,
                    "{way}"
                );
            }
        }
    }

    #[test]
    fn the_wrong_way_and_a_wall_behind_are_noticed() {
        let pressed_in = clear(|way| Vector3::z() * 5000.0 * way);
        assert_eq!(pressed_in.0, Leaving::Opposed);
        assert!(pressed_in.1 < 0.001);
        let wall = clear(|way| Vector3::z() * -(5000.0 * (way - 0.004)).max(0.0));
        assert_eq!(wall.0, Leaving::Opposed);
        let along_a_flank = clear(|way| Vector3::x() * 5000.0 * way);
        assert_eq!(along_a_flank.0, Leaving::Opposed);
    }

    #[test]
    fn a_tool_that_still_moves_in_may_turn_around_before_it_moves_off() {
        // A touch at 3 mm/s that is left at once: 40 ms until the arm turns around, at 30 kN/m,
        // with a reading that lags by 10 ms.
        let (config, n) = (LeaveConfig::default(), Vector3::z());
        let way = |t: f64| 0.0375 * t * t - 0.003 * t;
        let force = |t: f64| (-3e4 * way((t - 0.01).max(0.0))).max(0.0);
        let mut watch = LeaveWatch::default();
        let ended = (0..1000).find_map(|k| {
            let t = 2e-3 * f64::from(k);
            let left = watch.clear(&config, &n, way(t), &(n * force(t)), 10.0, 2e-3);
            (left != Leaving::Going).then_some(left)
        });
        assert_eq!(ended, Some(Leaving::Free));
        // One that is pushed in meets a rising force, which its own motion explains for a while
        // only.
        let mut watch = LeaveWatch::default();
        let ended = (0..1000).find_map(|k| {
            let t = 2e-3 * f64::from(k);
            let left = watch.clear(&config, &n, -0.003 * t, &(n * 90.0 * t), 10.0, 2e-3);
            (left != Leaving::Going).then_some((left, t))
        });
        assert!(
            ended.is_some_and(|(left, t)| left == Leaving::Opposed && t < 0.2),
            "{ended:?}"
        );
    }

    /// A retraction at 20 mm/s and 1 kHz; the distance at which it was opposed, m, if it was.
    fn opposed_m(
        way: impl Fn(f64) -> f64,
        force_at: impl Fn(f64) -> f64,
        zeroed: bool,
    ) -> Option<f64> {
        let force = |way_m: f64, _: f64| Vector3::z() * force_at(way_m);
        opposed_sliding_m(way, |_| 0.0, force, zeroed)
    }

    /// As `opposed_m`, for a tool that slides on along x meanwhile.
    fn opposed_sliding_m(
        way: impl Fn(f64) -> f64,
        slides: impl Fn(f64) -> f64,
        force_at: impl Fn(f64, f64) -> Vector3<f64>,
        zeroed: bool,
    ) -> Option<f64> {
        let (config, mut watch) = (LeaveConfig::default(), LeaveWatch::default());
        let ceiling = Ceiling {
            force_n: 40.0,
            torque_nm: 5.0,
        };
        (0..2000).find_map(|k| {
            let t = 1e-3 * f64::from(k);
            let (way_m, slid_m) = (way(t), slides(t));
            let met = Met {
                along: Vector3::z(),
                position: Vector3::new(slid_m, 0.0, way_m),
                force: force_at(way_m, slid_m),
                torque_nm: 0.0,
                hidden: false,
                zeroed,
                dt_s: 1e-3,
            };
            (watch.retract(&config, &ceiling, &met) == Leaving::Opposed).then_some(way_m)
        })
    }

    #[test]
    fn a_retraction_that_presses_harder_is_opposed_from_its_start() {
        let away = |t: f64| 0.02 * t;
        for stiffness in [5e3, 5e4] {
            let into = |way: f64| 3.0 + stiffness * way;
            let gone = opposed_m(away, into, true).unwrap();
            assert!(gone < 5.0 / stiffness + 3e-5, "{gone}");
            let off = |way: f64| (3.0 - stiffness * way).max(0.0);
            assert_eq!(opposed_m(away, off, true), None);
        }
        // Six newtons that the zero hides come to light: no obstacle if the zero is known to be
        // wrong.
        let hides = |way: f64| -6.0 * (way / 5e-4).min(1.0);
        assert!(opposed_m(away, hides, true).is_some());
        assert_eq!(opposed_m(away, hides, false), None);
        // The limit still applies.
        let wall = |way: f64| -6.0 - 1e5 * way;
        assert!(opposed_m(away, wall, false).unwrap() < 4e-4);
    }

    #[test]
    fn an_arm_that_still_moves_in_may_turn_around() {
        // 20 mm/s inwards, stopped within 40 ms.
        let turns = |t: f64| {
            if t < 0.04 {
                -0.02 * t + 0.25 * t * t
            } else {
                -4e-4 + 0.02 * (t - 0.04)
            }
        };
        let pressed = |way: f64| (3.0 - 2.5e4 * way).max(0.0);
        assert_eq!(opposed_m(turns, pressed, true), None);
    }

    #[test]
    fn a_tool_that_has_slid_into_a_wall_may_come_to_rest_there() {
        // 50 mm/s, at rest after 40 ms; the wall of 20 kN/m is 1.5 mm high.
        let slides = |t: f64| {
            let t = t.min(0.04);
            0.05 * t - 0.625 * t * t
        };
        let away = |t: f64| 0.02 * t;
        let wall = |way_m: f64, slid_m: f64| {
            let against = if way_m < 1.5e-3 {
                30.0 + 2e4 * slid_m
            } else {
                0.0
            };
            Vector3::new(-against, 0.0, 5.0)
        };
        assert_eq!(opposed_sliding_m(away, slides, wall, true), None);
        // Something above the tool still stops it, while it slides and afterwards.
        let roof = |way_m: f64, slid_m: f64| wall(way_m, slid_m) - Vector3::z() * 5e4 * way_m;
        for gone in [
            opposed_sliding_m(away, |_| 0.0, roof, true),
            opposed_sliding_m(away, slides, roof, true),
        ] {
            assert!(gone.is_some_and(|gone| gone < 2e-3), "{gone:?}");
        }
    }
}

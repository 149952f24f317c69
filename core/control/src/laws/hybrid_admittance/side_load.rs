//! Answer to a load along the surface that friction does not explain: a ledge in the way, or a
//! person who pushes the tool aside. The path slows, then stops, and the tool gives way.
//!
//! Friction opposes the sliding by a share of the pressing force that the contact has shown so far.
//! A load beyond that share slows the path's clock at once: before a ledge, the time that is left
//! until the load is too large counts; on a rougher spot, the share is learnt anew, and the path
//! speeds up again. A load that no friction explains stops the clock, and the tool moves with it as
//! the force law moves along the normal: by the excess over the damping. The path's own feedback
//! holds against it, like a spring, and brings the tool back afterwards.
//!
//! Called by the motion of the pressing phases.

use nalgebra::Vector3;

use super::config::PaceConfig;

/// Time constant over which the share of friction is learnt while the tool slides, s.
const LEARNT_S: f64 = 0.5;
/// Load along the surface that slows the path: this factor times what the learnt share explains,
/// with a least share, a pressing force up to this many references, and half of the load that may
/// always be.
const SLOW_FACTOR: f64 = 1.3;
const SLOW_SHARE_LEAST: f64 = 0.2;
const SLOW_PRESSING_MAX: f64 = 1.2;
const SLOW_LEAST: f64 = 0.5;
/// Share of the path's speed that is left from this many times that load on.
const SLOW: f64 = 0.1;
const SLOW_FROM: f64 = 1.1;
/// The load along the surface may exceed what the learnt share explains by this factor before the
/// tool gives way.
const FACTOR: f64 = 1.5;
/// Share before it was learnt, with an undetected slope, and the least to which the tool gives way:
/// friction that was not there before is no ledge.
const SHARE_AT_FIRST: f64 = 1.0;
const SHARE_LEAST: f64 = 0.5;
/// Reference, N, below which less of a load may always be, and how much at least.
const WEAK_N: f64 = 5.0;
const WEAK_LEAST: f64 = 0.5;
/// A pressing force up to this many references explains friction: beyond, something else presses.
const PRESSING_MAX: f64 = 1.5;
/// The path stands when the load has reached this many times the one to which the tool gives way.
const STAND: f64 = 1.5;
/// Speed above which the tool slides, m/s.
const SLIDES_M_PER_S: f64 = 1e-3;
/// Highest speed with which the tool gives way, m/s.
const SPEED_MAX_M_PER_S: f64 = 0.05;

/// Measurements of one cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sideways {
    /// Force on the tool along the surface, base axes, N.
    pub aside: Vector3<f64>,
    /// Pressing force, N.
    pub pressing_n: f64,
    /// Its reference, N.
    pub reference_n: f64,
    /// Speed of the tool along the surface, m/s.
    pub speed_m_per_s: f64,
    /// Damping of the force law, Ns/m.
    pub damping_n_s_per_m: f64,
    /// Period, s.
    pub dt_s: f64,
}

/// What the tool does about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GiveWay {
    /// Share of the path's speed that is left, 0 to 1.
    pub speed_share: f64,
    /// Whether the tool gives way, and its velocity then, base axes, m/s.
    pub gives_way: bool,
    pub velocity: Vector3<f64>,
}

impl GiveWay {
    /// Nothing stands in the way.
    pub const NOTHING: Self = Self {
        speed_share: 1.0,
        gives_way: false,
        velocity: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// What one contact has shown of its friction. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SideLoad {
    /// Share of the pressing force that acts along the surface.
    share: f64,
    /// Share of the pressing force that acts along the surface, also while a load slows the tool:
    /// it may be that of a ledge.
    share_slow: f64,
}

impl Default for SideLoad {
    fn default() -> Self {
        Self {
            share: SHARE_AT_FIRST,
            share_slow: SHARE_AT_FIRST,
        }
    }
}

impl SideLoad {
    /// Processes one cycle in which the tool presses.
    pub fn step(&mut self, config: &PaceConfig, now: &Sideways) -> GiveWay {
        if config.side_least_n <= 0.0 {
            return GiveWay::NOTHING;
        }
        let aside_n = now.aside.norm();
        let pressing_n = |most: f64| {
            now.pressing_n
                .clamp(now.reference_n, most * now.reference_n)
        };
        let explained_n = self.share.max(SHARE_LEAST) * pressing_n(PRESSING_MAX);
        let weak = (now.reference_n / WEAK_N).clamp(WEAK_LEAST, 1.0);
        let allowed_n = weak * config.side_least_n + FACTOR * explained_n;
        let excess_n = aside_n - allowed_n;
        if excess_n > 0.0 {
            let speed = (excess_n / now.damping_n_s_per_m).min(SPEED_MAX_M_PER_S);
            return GiveWay {
                speed_share: SLOW * (1.0 - excess_n / ((STAND - 1.0) * allowed_n)).max(0.0),
                gives_way: true,
                velocity: now.aside * (speed / aside_n),
            };
        }
        let explained_n = self.share_slow.max(SLOW_SHARE_LEAST) * pressing_n(SLOW_PRESSING_MAX);
        let free_n = SLOW_LEAST * config.side_least_n + SLOW_FACTOR * explained_n;
        let slow = (aside_n - free_n) / ((SLOW_FROM - 1.0) * free_n);
        let slides = now.speed_m_per_s > SLIDES_M_PER_S || slow > 0.0;
        if slides && now.pressing_n > 0.5 * now.reference_n {
            let share = aside_n / now.pressing_n;
            let gain = (now.dt_s / LEARNT_S).min(1.0);
            self.share_slow += (share - self.share_slow) * gain;
            self.share_slow = self.share_slow.min(SHARE_AT_FIRST);
            if slow <= 0.0 {
                self.share += (share - self.share) * gain;
            }
        }
        GiveWay {
            speed_share: (1.0 - slow.max(0.0)).max(SLOW),
            ..GiveWay::NOTHING
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sliding(aside_n: f64, pressing_n: f64) -> Sideways {
        Sideways {
            aside: Vector3::new(-aside_n, 0.0, 0.0),
            pressing_n,
            reference_n: 5.0,
            speed_m_per_s: 0.02,
            damping_n_s_per_m: 1000.0,
            dt_s: 0.008,
        }
    }

    /// After sliding with a friction of 0.2 under 5 N.
    fn slid() -> SideLoad {
        let mut side = SideLoad::default();
        for _ in 0..500 {
            side.step(&PaceConfig::default(), &sliding(1.0, 5.0));
        }
        side
    }

    #[test]
    fn friction_is_no_reason_to_stop_even_if_it_varies() {
        let config = PaceConfig::default();
        let mut side = SideLoad::default();
        for k in 0..2000 {
            let friction = 0.9 * (1.0 + 0.2 * (0.01 * f64::from(k)).sin());
            let pressing_n = 5.0 * (1.0 + 0.3 * (0.03 * f64::from(k)).cos());
            let found = side.step(&config, &sliding(friction * pressing_n, pressing_n));
            assert_eq!(found, GiveWay::NOTHING, "cycle {k}");
        }
    }

    #[test]
    fn a_ledge_stops_the_path_and_the_tool_gives_way() {
        let (config, mut side) = (PaceConfig::default(), slid());
        let met = side.step(&config, &sliding(13.0, 6.0));
        assert_eq!(met.speed_share, 0.0);
        // 13 N, of which 4.5 N may be friction, and 2 N are always allowed.
        assert!(met.gives_way && (met.velocity.x + 0.0065).abs() < 1e-9);
        // It stays so: what stands in the way is not learnt as friction.
        for _ in 0..2000 {
            assert!(side.step(&config, &sliding(13.0, 6.0)).speed_share == 0.0);
        }
        assert_eq!(side.step(&config, &sliding(1.0, 5.0)), GiveWay::NOTHING);
    }

    /// Share of the path's speed at a load of `aside_n`, cycle by cycle, after sliding with a
    /// friction of 0.2 under 5 N.
    fn at_a_load(aside_n: f64, cycles: usize) -> Vec<GiveWay> {
        let (config, mut side) = (PaceConfig::default(), slid());
        let load = sliding(aside_n, 5.0);
        (0..cycles).map(|_| side.step(&config, &load)).collect()
    }

    #[test]
    fn a_load_that_friction_did_not_explain_so_far_slows_the_path_before_it_stops() {
        let shares: Vec<f64> = [2.0, 2.4, 3.0, 5.5]
            .map(|aside_n| at_a_load(aside_n, 1)[0].speed_share)
            .into();
        assert_eq!(shares[0], 1.0);
        assert!(shares[1] < 1.0 && shares[1] > SLOW, "{shares:?}");
        assert_eq!(shares[2..], [SLOW, SLOW]);
        assert!(!at_a_load(5.5, 1)[0].gives_way);
        let beyond = at_a_load(7.0, 1)[0];
        assert!(beyond.gives_way && beyond.speed_share < SLOW);
    }

    #[test]
    fn a_rougher_spot_is_learnt_and_the_path_goes_on() {
        // From 0.2 to 0.8.
        let found = at_a_load(4.0, 200);
        assert!(found.iter().all(|way| !way.gives_way));
        let speeds_up = found.iter().position(|way| way.speed_share == 1.0);
        assert!(
            speeds_up.is_some_and(|k| (20..130).contains(&k)),
            "{speeds_up:?}"
        );
    }

    #[test]
    fn a_ledge_that_the_tool_creeps_into_is_not_learnt() {
        // 2 mm/s into 5 kN/m.
        let (config, mut side) = (PaceConfig::default(), slid());
        let gives_way_n = (0..1000)
            .map(|k| 1.0 + 0.08 * f64::from(k))
            .find(|aside_n| side.step(&config, &sliding(*aside_n, 5.0)).gives_way);
        assert!(gives_way_n.is_some_and(|n| n < 6.0), "{gives_way_n:?}");
    }

    #[test]
    fn a_weak_force_gives_way_before_the_load_is_a_fault() {
        let config = PaceConfig::default();
        let mut side = SideLoad::default();
        let weak = |aside_n: f64| Sideways {
            reference_n: 1.1,
            ..sliding(aside_n, 1.1)
        };
        for _ in 0..500 {
            side.step(&config, &weak(0.3));
        }
        assert!(!side.step(&config, &weak(1.5)).gives_way);
        assert!(side.step(&config, &weak(2.0)).gives_way);
    }

    #[test]
    fn it_can_be_switched_off() {
        let config = PaceConfig {
            side_least_n: 0.0,
            ..PaceConfig::default()
        };
        let found = SideLoad::default().step(&config, &sliding(100.0, 5.0));
        assert_eq!(found, GiveWay::NOTHING);
    }
}

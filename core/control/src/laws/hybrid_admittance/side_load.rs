//! Answer to a load along the surface that friction does not explain: a ledge in the way, or a
//! person who pushes the tool aside. The path stops and the tool gives way.
//!
//! Friction opposes the sliding by a share of the pressing force that the contact has shown so far.
//! A load beyond that share stops the path's clock, and the tool moves with it as the force law
//! moves along the normal: by the excess over the damping. The path's own feedback holds against
//! it, like a spring, and brings the tool back afterwards.
//!
//! Called by the motion of the pressing phases.

use nalgebra::Vector3;

use super::config::PaceConfig;

/// Time constant over which the share of friction is learnt while the tool slides, s.
const LEARNT_S: f64 = 0.5;
/// The load along the surface may exceed what the learnt share explains by this factor.
const FACTOR: f64 = 1.5;
/// Share before it was learnt, with an undetected slope, and the least: a load as large as the
/// pressing force harms nothing that this force does not.
const SHARE_AT_FIRST: f64 = 1.0;
const SHARE_LEAST: f64 = 1.0 / FACTOR;
/// A pressing force up to this many references explains friction: beyond, something else presses.
const PRESSING_MAX: f64 = 1.5;
/// The path stands when the load has reached this many times the one that begins to slow it.
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
    /// Velocity with which the tool gives way, base axes, m/s.
    pub velocity: Vector3<f64>,
}

impl GiveWay {
    /// Nothing stands in the way.
    pub const NOTHING: Self = Self {
        speed_share: 1.0,
        velocity: Vector3::new(0.0, 0.0, 0.0),
    };
}

/// What one contact has shown of its friction. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SideLoad {
    /// Share of the pressing force that acts along the surface.
    share: f64,
}

impl Default for SideLoad {
    fn default() -> Self {
        Self {
            share: SHARE_AT_FIRST,
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
        let pressing_n = now
            .pressing_n
            .clamp(now.reference_n, PRESSING_MAX * now.reference_n);
        let allowed_n = config.side_least_n + FACTOR * self.share.max(SHARE_LEAST) * pressing_n;
        let excess_n = aside_n - allowed_n;
        if excess_n > 0.0 {
            let speed = (excess_n / now.damping_n_s_per_m).min(SPEED_MAX_M_PER_S);
            return GiveWay {
                speed_share: (1.0 - excess_n / ((STAND - 1.0) * allowed_n)).max(0.0),
                velocity: now.aside * (speed / aside_n),
            };
        }
        if now.speed_m_per_s > SLIDES_M_PER_S && now.pressing_n > 0.5 * now.reference_n {
            let share = aside_n / now.pressing_n;
            self.share += (share - self.share) * (now.dt_s / LEARNT_S).min(1.0);
        }
        GiveWay::NOTHING
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
        let config = PaceConfig::default();
        let mut side = SideLoad::default();
        for _ in 0..500 {
            side.step(&config, &sliding(1.0, 5.0));
        }
        let met = side.step(&config, &sliding(13.0, 6.0));
        assert_eq!(met.speed_share, 0.0);
        // 13 N, of which 6 N are as much as presses, and 2 N are always allowed.
        assert!((met.velocity.x + 0.005).abs() < 1e-9, "{}", met.velocity);
        // It stays so: what stands in the way is not learnt as friction.
        for _ in 0..2000 {
            assert!(side.step(&config, &sliding(13.0, 6.0)).speed_share == 0.0);
        }
        assert_eq!(side.step(&config, &sliding(1.0, 5.0)), GiveWay::NOTHING);
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

//! Speed of the path by the certainty of the normal, and the exploration before it.
//!
//! While the normal in use is wrong by a slope `s` along the path, the tool moves into or off the
//! surface at `s v`. The force loop, whose crossover is `delay_margin / T`, answers with a force
//! error of `s v k T / delay_margin`. That may take a share of the reference, or what the zero of a
//! sensor drifts by anyway: `v ≤ max(share F, 0.3 N) / (k T s)`.
//!
//! Nobody knows what stands in the way of a tool on a surface that nobody has modelled. A ledge is
//! felt one delay `T` late, with `v k T` more force: the speed stays below that which would reach
//! the limit of the force.
//!
//! Whatever the reason, a force far off its reference says that the surface is not where the normal
//! in use expects it: the path slows down until the force is back.
//!
//! Called by the motion of the sliding phase.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::config::PaceConfig;

/// The slope expected is this many standard deviations of the normal.
const SLOPE_SD: f64 = 2.0;
/// Distance assumed between the contact and the tool's origin while the tool turns, m: of a round
/// tip that is not aligned, and of a stated origin that is not the true one.
const LEVER_M: f64 = 0.004;
/// Share of the reference that is left at least, for the turn rate.
const LEFT_SHARE: f64 = 0.3;
/// Lowest turn rate for that reason, rad/s.
const TURN_MIN_RAD_PER_S: f64 = 0.05;
/// The path stands when the force error is this many times the one that begins to slow it.
const STAND_SHARES: f64 = 2.5;
/// Share of the speed that is left whatever the force.
const EXCESS_LEAST: f64 = 0.2;
/// Without an estimate, the tool stands up to the first share of the reference, and moves as fast
/// as it may from the second.
const BLIND_SHARES: [f64; 2] = [0.55, 0.8];
/// Force up to which it stands, N, up to the second share: an estimator takes 0.6 N for a contact,
/// and may have another zero.
const BLIND_N: f64 = 0.8;
/// Share of the reference from which it moves at full speed in any case.
const BLIND_ALL: f64 = 0.95;
/// A lower reference than this is judged like this one, N: noise is no reason to wait.
const REFERENCE_MIN_N: f64 = 1.5;
/// Force error by a slope that is no reason to go more slowly, N: a sensor's zero drifts by as
/// much. Of a weak reference it is this share at most.
const SLOPE_LEAST_N: f64 = 0.3;
const SLOPE_MOST_SHARE: f64 = 1.0 / 3.0;
/// Largest radius of the first circle, m.
const RADIUS_MAX_M: f64 = 0.005;
/// Speed of the exploration, m/s, up to a reference, N. Above that it grows with the reference, up
/// to a factor: the direction of a stronger force shows the normal in less time.
const EXPLORE_SPEED_M_PER_S: f64 = 0.008;
const EXPLORE_SPEED_UP_TO_N: f64 = 6.0;
const EXPLORE_SPEED_FACTOR_MAX: f64 = 2.0;
/// Shortest time on the path before it is explored again, s. It doubles with every circle since the
/// touch, up to the second value: over waves, what a circle shows is soon out of date.
const AGAIN_AFTER_S: [f64; 2] = [2.0, 16.0];

/// What the force loop makes of a slope.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ForceLoop {
    /// Reference, N.
    pub reference_n: f64,
    /// Stiffness of the contact, N/m.
    pub stiffness_n_per_m: f64,
    /// Delay of the loop, s.
    pub delay_s: f64,
}

impl ForceLoop {
    /// Force that a speed into the surface adds until the loop answers, `k T`, N s/m.
    fn rise_n_s_per_m(&self) -> f64 {
        self.stiffness_n_per_m * self.delay_s
    }
}

/// Force error that an unknown slope may take of a force, N.
fn slope_error_n(config: &PaceConfig, force_n: f64) -> f64 {
    let least_n = SLOPE_LEAST_N.min(SLOPE_MOST_SHARE * force_n);
    (config.slope_share * force_n).max(least_n)
}

/// Highest speed in a direction in which the normal has this standard deviation, m/s.
pub(crate) fn speed_bound(config: &PaceConfig, deviation_rad: f64, force: &ForceLoop) -> f64 {
    if config.slope_share <= 0.0 {
        return f64::INFINITY;
    }
    let slope = SLOPE_SD * deviation_rad;
    let give = force.rise_n_s_per_m() * slope;
    let bound = slope_error_n(config, force.reference_n) / give.max(f64::MIN_POSITIVE);
    bound.max(config.speed_min_m_per_s)
}

/// Highest speed, m/s, at which something in the way takes no more than `hit_share` of the force
/// from the reference to the limit `force_max_n`, until the arm answers: it moves on at this speed
/// for one delay of the loop.
pub(crate) fn obstacle_bound(config: &PaceConfig, force_max_n: f64, force: &ForceLoop) -> f64 {
    if config.hit_share <= 0.0 {
        return f64::INFINITY;
    }
    let room_n = config.hit_share * (force_max_n - force.reference_n).max(0.0);
    let bound = room_n / force.rise_n_s_per_m();
    bound.max(config.speed_min_m_per_s)
}

/// Share of the path's speed that a force leaves which is off its reference by `error_n`: all of it
/// up to `force_share` of the reference, none from [`STAND_SHARES`] times that.
pub(crate) fn force_factor(config: &PaceConfig, error_n: f64, reference_n: f64) -> f64 {
    if config.force_share <= 0.0 {
        return 1.0;
    }
    speed_left(error_n.abs(), reference_n, config.force_share).max(0.0)
}

/// Share of the path's speed that a force leaves which is above its reference by `error_n`: a
/// surface that rises faster than the force law gives way is slid up more slowly. Never less than
/// [`EXCESS_LEAST`], so that a tool gets over a ledge.
pub(crate) fn excess_factor(config: &PaceConfig, error_n: f64, reference_n: f64) -> f64 {
    if config.excess_share <= 0.0 {
        return 1.0;
    }
    speed_left(error_n, reference_n, config.excess_share).max(EXCESS_LEAST)
}

/// Share of the path's speed, without an estimate, that a force leaves which is off its reference
/// by `error_n`: a tool that the last normal leads off the surface waits.
pub(crate) fn blind_factor(config: &PaceConfig, error_n: f64, reference_n: f64) -> f64 {
    if config.slope_share <= 0.0 {
        return 1.0;
    }
    let [least, most] = BLIND_SHARES;
    let stands = (BLIND_N / reference_n).clamp(least, most);
    let rise = (most - least).min(BLIND_ALL - stands);
    let share = 1.0 + error_n / reference_n;
    ((share - stands) / rise).clamp(0.0, 1.0)
}

/// Share of a speed that is left by an error of the force: 1 up to the share `from` of the
/// reference, 0 at [`STAND_SHARES`] times that, and negative beyond.
fn speed_left(error_n: f64, reference_n: f64, from: f64) -> f64 {
    let share = error_n / reference_n.max(REFERENCE_MIN_N) / from;
    ((STAND_SHARES - share) / (STAND_SHARES - 1.0)).min(1.0)
}

/// Highest turn rate of the tool about its origin, rad/s, so that a contact [`LEVER_M`] beside that
/// origin moves along the normal no faster than the loop can follow; `force_n` is measured.
pub(crate) fn turn_bound(config: &PaceConfig, force_n: f64, force: &ForceLoop) -> f64 {
    if config.slope_share <= 0.0 {
        return f64::INFINITY;
    }
    // A tool that hardly presses loses contact sooner.
    let left_n = force_n.clamp(LEFT_SHARE * force.reference_n, force.reference_n);
    let speed = slope_error_n(config, left_n) / force.rise_n_s_per_m();
    (speed / LEVER_M).max(TURN_MIN_RAD_PER_S)
}

/// Standard deviation of a normal with this covariance (rad²) in the direction `along` (unit), rad.
pub(crate) fn deviation_along_rad(covariance: &Matrix3<f64>, along: &Vector3<f64>) -> f64 {
    along.dot(&(covariance * along)).max(0.0).sqrt()
}

/// Largest standard deviation of a normal with this covariance (rad²) in any direction, rad.
pub(crate) fn deviation_max_rad(covariance: &Matrix3<f64>) -> f64 {
    covariance.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// Highest speed of an exploration with this reference, m/s.
pub(crate) fn explore_speed_max(reference_n: f64) -> f64 {
    let factor = reference_n / EXPLORE_SPEED_UP_TO_N;
    EXPLORE_SPEED_M_PER_S * factor.clamp(1.0, EXPLORE_SPEED_FACTOR_MAX)
}

/// Number and size of the circles of one exploration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Circles {
    /// Most circles; each has a larger radius than the one before.
    most: u32,
    /// Radius of the first, as a share of the one that is set.
    share: f64,
}

impl Circles {
    /// After a touch.
    pub const AT_TOUCH: Self = Self {
        most: 2,
        share: 1.0,
    };
    /// After a touch where what the tool does to the surface adds up to a dose.
    pub const WITH_DOSE: Self = Self {
        most: 1,
        share: 1.0,
    };
    /// On the path: the tool stays near it.
    pub const ON_PATH: Self = Self {
        most: 1,
        share: 0.5,
    };
}

/// Small circles on the surface before the path, and on it where the normal has become uncertain: a
/// stroke shows little of the slope across it, a circle shows both.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Exploration {
    /// Angle on the present circle, rad; `None` if there is none.
    angle_rad: Option<f64>,
    radius_m: f64,
    turns: u32,
    circles: Circles,
    /// Time on the path since the last circle, s.
    rested_s: f64,
    /// Circles on the path since the touch.
    again: u32,
}

impl Exploration {
    /// An exploration with these circles may begin with the next step.
    pub fn offer(&mut self, circles: Circles) {
        *self = Self {
            angle_rad: Some(0.0),
            circles,
            ..Self::default()
        };
    }

    /// Offers another circle to a tool that follows its path, where the normal is less certain than
    /// that asks for.
    pub fn offer_again(&mut self, config: &PaceConfig, deviation_rad: f64, dt_s: f64) {
        if self.is_open() {
            return;
        }
        self.rested_s += dt_s;
        let unsure = config.explore_again_rad > 0.0 && deviation_rad > config.explore_again_rad;
        let [first_s, most_s] = AGAIN_AFTER_S;
        if unsure && self.rested_s > (first_s * f64::from(self.again).exp2()).min(most_s) {
            let again = self.again + 1;
            self.offer(Circles::ON_PATH);
            self.again = again;
        }
    }

    /// Whether the tool explores, or may begin to.
    pub fn is_open(&self) -> bool {
        self.angle_rad.is_some()
    }

    /// Whether the tool moves on a circle, or has.
    pub fn has_begun(&self) -> bool {
        self.radius_m > 0.0
    }

    /// Next displacement in the plane of the path, m, at `speed_m_per_s`; `None` at the end, with
    /// the tool where it began. `bend_m` is the distance by which friction may bend the tool.
    pub fn step(
        &mut self,
        config: &PaceConfig,
        bend_m: f64,
        deviation_rad: f64,
        speed_m_per_s: f64,
        dt_s: f64,
    ) -> Option<Vector2<f64>> {
        let angle = self.angle_rad?;
        let begins = angle == 0.0;
        let sure = deviation_rad <= config.explore_above_rad;
        if config.explore_radius_m <= 0.0 || begins && (sure || self.turns >= self.circles.most) {
            self.angle_rad = None;
            return None;
        }
        if begins && self.turns == 0 {
            // A tool that bends further sideways than the circle is wide sticks on the surface.
            self.radius_m =
                self.circles.share * config.explore_radius_m.max(bend_m.min(RADIUS_MAX_M));
        }
        let radius_m = self.radius_m * f64::from(1 + self.turns);
        let next = angle + speed_m_per_s * dt_s / radius_m;
        let closed = next >= std::f64::consts::TAU;
        let next = if closed { std::f64::consts::TAU } else { next };
        let at = |angle: f64| Vector2::new(1.0 - angle.cos(), angle.sin()) * radius_m;
        self.angle_rad = Some(if closed { 0.0 } else { next });
        self.turns += u32::from(closed);
        Some(at(next) - at(angle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORCE: ForceLoop = ForceLoop {
        reference_n: 3.0,
        stiffness_n_per_m: 50_000.0,
        delay_s: 0.04,
    };

    #[test]
    fn an_uncertain_normal_slows_the_path_in_its_own_direction_only() {
        let config = PaceConfig::default();
        // 10 degrees along x, 0.1 degrees along y.
        let covariance =
            Matrix3::from_diagonal(&Vector3::new(0.175f64.powi(2), 0.00175f64.powi(2), 0.0));
        let along =
            |v: Vector3<f64>| speed_bound(&config, deviation_along_rad(&covariance, &v), &FORCE);
        assert_eq!(along(Vector3::x()), config.speed_min_m_per_s);
        assert!(along(Vector3::y()) > 0.1);
        let off = PaceConfig {
            slope_share: 0.0,
            ..config
        };
        assert_eq!(speed_bound(&off, 0.175, &FORCE), f64::INFINITY);
    }

    #[test]
    fn a_weak_force_is_not_held_better_than_a_zero_drifts() {
        let config = PaceConfig {
            slope_share: 0.1,
            ..PaceConfig::default()
        };
        let bound = |reference_n| {
            let force = ForceLoop {
                reference_n,
                stiffness_n_per_m: 5_000.0,
                ..FORCE
            };
            let per_newton = 1.0 / (force.rise_n_s_per_m() * SLOPE_SD * 0.05);
            speed_bound(&config, 0.05, &force) / per_newton
        };
        for (reference_n, error_n) in [(0.6, 0.2), (1.0, 0.3), (2.5, 0.3), (10.0, 1.0)] {
            assert!((bound(reference_n) - error_n).abs() < 1e-9, "{reference_n}");
        }
    }

    #[test]
    fn a_tool_without_an_estimate_waits_for_a_force_that_an_estimator_feels() {
        let config = PaceConfig::default();
        let factor =
            |force_n: f64, reference_n| blind_factor(&config, force_n - reference_n, reference_n);
        for reference_n in [0.6, 0.8, 1.0, 1.2, 3.0, 20.0] {
            let stands_n = (0.8f64.min(0.8 * reference_n)).max(0.55 * reference_n);
            assert_eq!(factor(0.99 * stands_n, reference_n), 0.0);
            assert!(factor(1.03 * stands_n, reference_n) > 0.0);
            assert_eq!(factor(0.96 * reference_n, reference_n), 1.0);
        }
        assert_eq!(factor(8.1, 10.0), 1.0);
    }

    #[test]
    fn a_ledge_on_a_stiff_surface_stays_below_the_limit_of_the_force() {
        let config = PaceConfig::default();
        let bound = |force| obstacle_bound(&config, 43.0, force);
        // 40 N on 50 kN/m are 0.8 mm, in 40 ms.
        assert!((bound(&FORCE) / config.hit_share - 0.02).abs() < 1e-12);
        let soft = ForceLoop {
            stiffness_n_per_m: 1000.0,
            ..FORCE
        };
        assert!(bound(&soft) > 0.1);
        let at_the_limit = ForceLoop {
            reference_n: 50.0,
            ..FORCE
        };
        assert_eq!(bound(&at_the_limit), config.speed_min_m_per_s);
        let off = PaceConfig {
            hit_share: 0.0,
            ..config
        };
        assert_eq!(obstacle_bound(&off, 43.0, &FORCE), f64::INFINITY);
    }

    #[test]
    fn too_high_a_force_slows_the_path_and_too_low_a_force_does_not() {
        let config = PaceConfig::default();
        let factor = |error_n| excess_factor(&config, error_n, 10.0);
        assert_eq!(factor(-9.0), 1.0);
        assert_eq!(factor(3.0), 1.0);
        assert!(factor(7.0) < 0.6);
        assert_eq!(factor(100.0), EXCESS_LEAST);
        let off = PaceConfig {
            excess_share: 0.0,
            ..config
        };
        assert_eq!(excess_factor(&off, 100.0, 10.0), 1.0);
    }

    #[test]
    fn a_tool_without_an_estimate_stands_until_it_presses() {
        let config = PaceConfig::default();
        let factor = |error_n| blind_factor(&config, error_n, 2.0);
        assert_eq!([factor(-2.0), factor(-1.0)], [0.0, 0.0]);
        assert!((factor(-0.65) - 0.5).abs() < 1e-9);
        assert_eq!([factor(-0.3), factor(3.0)], [1.0, 1.0]);
        let off = PaceConfig {
            slope_share: 0.0,
            ..config
        };
        assert_eq!(blind_factor(&off, -2.0, 2.0), 1.0);
    }

    #[test]
    fn an_exploration_ends_where_it_began() {
        let config = PaceConfig::default();
        let mut exploration = Exploration::default();
        assert_eq!(exploration.step(&config, 0.0, 1.0, 0.01, 0.008), None);
        exploration.offer(Circles::AT_TOUCH);
        let (mut at, mut way, mut cycles) = (Vector2::zeros(), 0.0, 0);
        while let Some(step) = exploration.step(&config, 0.0, 1.0, 0.01, 0.008) {
            at += step;
            way += step.norm();
            cycles += 1;
            assert!(cycles < 10_000);
        }
        assert!(at.norm() < 1e-12, "{at}");
        let circles = std::f64::consts::TAU * config.explore_radius_m * 3.0;
        assert!((way / circles - 1.0).abs() < 0.01, "{way} {circles}");
        assert!(!exploration.is_open());
    }

    #[test]
    fn a_normal_that_becomes_uncertain_on_the_path_gets_one_small_circle() {
        let config = PaceConfig::default();
        let (sure, unsure) = (
            0.9 * config.explore_again_rad,
            1.1 * config.explore_again_rad,
        );
        let dt_s = 0.008;
        // Time on the path until a circle is offered, s, with this deviation.
        let offered_s = |config: &PaceConfig, deviation_rad: f64| {
            let mut exploration = Exploration::default();
            (0..1000).find_map(|k| {
                exploration.offer_again(config, deviation_rad, dt_s);
                exploration.is_open().then(|| f64::from(k + 1) * dt_s)
            })
        };
        assert_eq!(offered_s(&config, sure), None);
        let offered = offered_s(&config, unsure).unwrap();
        assert!((offered - AGAIN_AFTER_S[0]).abs() < 2.0 * dt_s, "{offered}");
        let never = PaceConfig {
            explore_again_rad: 0.0,
            ..config
        };
        assert_eq!(offered_s(&never, 1.0), None);

        // The circle is closed, and the time that the path goes on before the next one doubles.
        let mut exploration = Exploration::default();
        for expected_s in [2.0, 4.0, 8.0, 16.0, 16.0] {
            let mut path_s = 0.0;
            while !exploration.is_open() {
                exploration.offer_again(&config, unsure, dt_s);
                path_s += dt_s;
            }
            assert!((path_s - expected_s).abs() < 2.0 * dt_s, "{path_s}");
            let (mut at, mut farthest) = (Vector2::zeros(), 0.0f64);
            while let Some(step) = exploration.step(&config, 0.0, 1.0, 0.01, dt_s) {
                exploration.offer_again(&config, 1.0, dt_s);
                at += step;
                farthest = farthest.max(at.norm());
            }
            assert!(at.norm() < 1e-12, "{at}");
            assert!((farthest - config.explore_radius_m).abs() < 1e-5);
        }
    }

    #[test]
    fn a_stronger_force_is_explored_with_faster() {
        assert_eq!(explore_speed_max(1.0), explore_speed_max(5.0));
        assert!(explore_speed_max(9.0) > 1.4 * explore_speed_max(5.0));
        assert_eq!(explore_speed_max(30.0), explore_speed_max(15.0));
    }

    #[test]
    fn a_sure_normal_needs_no_exploration() {
        let config = PaceConfig::default();
        let mut exploration = Exploration::default();
        exploration.offer(Circles::AT_TOUCH);
        assert_eq!(exploration.step(&config, 0.0, 0.01, 0.01, 0.008), None);
    }
}

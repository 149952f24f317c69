//! Whether the tool is out of contact: what is known when a task starts, and how a motion away from
//! the surface shows it.
//!
//! A zero taken while the tool presses hides that force from every later reading. Each law
//! therefore keeps a [`Clearance`] across its tasks, and the service keeps it across restarts. If
//! contact is possible, a start first moves away from the surface
//! ([`Phase::Clear`](crate::phase_machine::Phase::Clear)).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_sensing::TareGround;

use crate::contact::alignment::tangential;
use crate::error::ControlError;
use crate::limits::Limits;

/// Whether the tool may touch something.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Clearance {
    /// Assumed free: nothing was touched yet, or a person confirmed it. No motion has shown it.
    #[default]
    Assumed,
    /// A motion away from the surface has shown that the tool is free.
    Free,
    /// Contact is possible: a task left its start, and no retraction has ended in free space since.
    Possible {
        /// Direction away from the surface: unit, base axes.
        normal: Vector3<f64>,
        /// Last position of the tool's origin, base axes, m.
        position: Vector3<f64>,
    },
    /// Contact is possible, and the direction away from the surface is not known.
    Unknown,
}

impl Clearance {
    /// Whether the tool counts as free.
    pub fn is_free(&self) -> bool {
        matches!(self, Self::Assumed | Self::Free)
    }

    /// How far a zero that is taken now can be trusted.
    pub fn tare_ground(&self) -> TareGround {
        match self {
            Self::Free => TareGround::Shown,
            _ => TareGround::Assumed,
        }
    }

    /// Whether a task may start with the tool at `position` (base axes, m): `None` if the tool is
    /// free, else the direction in which it must first move away.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if contact is possible and the direction away is not known.
    pub fn way_out(
        &self,
        config: &LeaveConfig,
        position: &Vector3<f64>,
    ) -> Result<Option<Vector3<f64>>, ControlError> {
        match self {
            Self::Assumed | Self::Free => Ok(None),
            Self::Unknown => Err(ControlError::MayTouch { moved_m: None }),
            Self::Possible {
                normal,
                position: last,
            } => {
                let moved_m = (position - last).norm();
                // Written so that NaN is refused.
                if moved_m <= config.near_m {
                    return Ok(Some(*normal));
                }
                Err(ControlError::MayTouch {
                    moved_m: Some(moved_m),
                })
            }
        }
    }
}

/// How the tool leaves a surface, and how it is shown to be free.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LeaveConfig {
    /// Speed in phase `clear`, m/s.
    pub speed_m_per_s: f64,
    /// Distance over which the force must be steady for the tool to count as free, m.
    pub free_m: f64,
    /// Change of the force within that distance that still counts as steady, N.
    pub steady_n: f64,
    /// Maximum distance in phase `clear`, m.
    pub distance_max_m: f64,
    /// Increase of the force against or across the motion, relative to the start of phase `clear`,
    /// that is tolerated in that phase, N.
    pub grow_n: f64,
    /// Increase of the force above the minimum since the start of a retraction that is tolerated,
    /// N.
    pub opposed_n: f64,
    /// Increase of the torque above the minimum since the start of a retraction that is tolerated,
    /// Nm.
    pub opposed_nm: f64,
    /// Highest speed of a retraction without a usable wrench, m/s.
    pub blind_speed_m_per_s: f64,
    /// Maximum distance of the tool from the place of the last known normal at which that normal is
    /// still used, m.
    pub near_m: f64,
    /// A touch within this distance of the place of the tare means that the tare was taken in
    /// contact, m.
    pub touch_at_once_m: f64,
}

impl Default for LeaveConfig {
    fn default() -> Self {
        Self {
            speed_m_per_s: 0.01,
            free_m: 0.005,
            steady_n: 0.5,
            distance_max_m: 0.05,
            grow_n: 2.0,
            opposed_n: 5.0,
            opposed_nm: 1.0,
            blind_speed_m_per_s: 0.01,
            near_m: 0.02,
            touch_at_once_m: 0.0005,
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

/// Distance from which the minimum force of a retraction counts if the zero cannot be trusted, m:
/// over the first part the contact may release a force that the zero hides.
const LET_GO_M: f64 = 0.001;
/// Maximum time for an arm that still moves in to reverse, s: its own lag plus the lag of the
/// reading. A force that increases during this time is no obstacle.
const TURN_S: f64 = 0.15;
/// Lag of the reading, s: a force that rises for so long after the tool's last motion across the
/// retraction comes from that motion.
const READ_S: f64 = 0.03;
/// Distance against the retraction, or into what pressed when it began, that shows that the arm
/// still moves in, m: above a joint encoder's noise at the tool.
const STILL_IN_M: f64 = 2e-5;
/// Time constant of the average of the force before the test for steadiness, s: the sensor's noise
/// must not look like a touch.
const STEADY_S: f64 = 0.02;

/// Measurements of one cycle of a retraction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Met {
    /// Direction of the retraction (unit), and the position of the tool, m; axes of the force.
    pub along: Vector3<f64>,
    pub position: Vector3<f64>,
    /// Force on the tool, base axes, N.
    pub force: Vector3<f64>,
    /// Torque on the tool, Nm.
    pub torque_nm: f64,
    /// Whether the untared reading is beyond its limit.
    pub hidden: bool,
    /// Whether the zero can be trusted: neither lost nor taken in contact.
    pub zeroed: bool,
    /// Time since the last cycle, s.
    pub dt_s: f64,
}

/// Loads at which a retraction stops, regardless of the load at its start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ceiling {
    /// Force, N.
    pub force_n: f64,
    /// Torque, Nm.
    pub torque_nm: f64,
}

impl Ceiling {
    /// From the cell's limits.
    pub fn of(limits: &Limits) -> Self {
        Self {
            force_n: limits.force_max_n,
            torque_nm: limits.torque_max_nm,
        }
    }
}

/// Loads against which a retraction is judged.
#[derive(Clone, Copy, Debug)]
struct Retreat {
    /// Position at the start, m, and the lowest place along the retraction relative to it (0 or
    /// negative), m.
    from: Vector3<f64>,
    lowest_m: f64,
    /// Direction of the force at the start, across the retraction.
    out: Vector3<f64>,
    /// Largest force in that direction while the tool slid on, N.
    aside_n: f64,
    /// Farthest position against `out`, m, and when it was reached, s.
    deepest_m: f64,
    deepest_s: f64,
    elapsed_s: f64,
    /// Force and torque at the start: N, Nm.
    first: (f64, f64),
    /// Minimum force and torque since: N, Nm.
    least: (f64, f64),
    hidden: bool,
    zeroed: bool,
}

impl Retreat {
    fn begin(met: &Met) -> Self {
        let across = tangential(&met.force, &met.along);
        let load = (met.force.dot(&met.along).abs(), met.torque_nm);
        Self {
            from: met.position,
            lowest_m: 0.0,
            out: across.try_normalize(1e-9).unwrap_or_default(),
            aside_n: across.norm(),
            deepest_m: 0.0,
            deepest_s: f64::NEG_INFINITY,
            elapsed_s: 0.0,
            first: load,
            least: load,
            hidden: met.hidden,
            zeroed: met.zeroed,
        }
    }

    /// Processes one cycle; returns whether an obstacle opposes the motion.
    fn is_opposed(&mut self, config: &LeaveConfig, ceiling: &Ceiling, met: &Met) -> bool {
        let torque_nm = met.torque_nm;
        let gone = met.position - self.from;
        let gone_m = gone.dot(&met.along);
        self.elapsed_s += met.dt_s;
        self.lowest_m = self.lowest_m.min(gone_m);
        // A tool that has slid into something still moves on, across the retraction: what stands
        // there pushes harder until the tool is at rest. That part of the force is no obstacle.
        let out_m = gone.dot(&self.out);
        if out_m < self.deepest_m - STILL_IN_M {
            (self.deepest_m, self.deepest_s) = (out_m, self.elapsed_s);
        }
        let slides_on = self.elapsed_s <= TURN_S.min(self.deepest_s + READ_S);
        let aside_n = met.force.dot(&self.out).max(0.0);
        if slides_on {
            self.aside_n = self.aside_n.max(aside_n);
        }
        let force_n = (met.force - self.out * aside_n.min(self.aside_n)).norm();
        // Once the tool moves out again, the contact releases: a force that increases from there
        // comes from an obstacle.
        let moves_in = self.elapsed_s <= TURN_S
            && self.lowest_m < -STILL_IN_M
            && gone_m <= self.lowest_m + STILL_IN_M;
        if moves_in {
            self.first.0 = self.first.0.max(force_n);
            self.least.0 = force_n;
        }
        if moves_in || slides_on {
            self.first.1 = self.first.1.max(torque_nm);
            self.least.1 = torque_nm;
        }
        // The zero is not trusted: it is only assumed that the first millimetre releases the
        // contact.
        if self.zeroed || gone_m >= LET_GO_M {
            self.least = (self.least.0.min(force_n), self.least.1.min(torque_nm));
        } else {
            self.least = (force_n, torque_nm);
        }
        let (opposed_n, opposed_nm) = (config.opposed_n, config.opposed_nm);
        force_n > self.least.0 + opposed_n
            || torque_nm > self.least.1 + opposed_nm
            || force_n > ceiling.force_n.max(self.first.0 + opposed_n)
            || torque_nm > ceiling.torque_nm.max(self.first.1 + opposed_nm)
            || (met.hidden && !self.hidden)
    }
}

/// Monitors the force while the tool moves away. Only differences count, so that any zero will do.
/// Each motion needs a new monitor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LeaveWatch {
    /// Force at the start, base axes, N.
    first: Option<Vector3<f64>>,
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
        let first = *self.first.get_or_insert(*force);
        let change = force - first;
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

    #[test]
    fn a_place_that_is_not_the_stored_one_gives_no_way_out() {
        let config = LeaveConfig::default();
        let doubt = Clearance::Possible {
            normal: Vector3::z(),
            position: Vector3::new(0.4, 0.0, 0.2),
        };
        let near = doubt.way_out(&config, &Vector3::new(0.4, 0.01, 0.2));
        assert_eq!(near, Ok(Some(Vector3::z())));
        for away in [Vector3::new(0.4, 0.05, 0.2), Vector3::repeat(f64::NAN)] {
            let error = doubt.way_out(&config, &away).unwrap_err().to_string();
            assert!(error.contains("--clear"), "{error}");
        }
        assert!(
            Clearance::Unknown
                .way_out(&config, &Vector3::zeros())
                .is_err()
        );
        assert_eq!(
            Clearance::Free.way_out(&config, &Vector3::zeros()),
            Ok(None)
        );
    }
}

//! Whether the tool hangs free: what is known of it when a task starts, and how a motion away from the surface shows it.
//!
//! A zero that is taken while the tool presses hides that force from everything that follows. So each law keeps a [`Clearance`]
//! over its tasks, the service keeps it over restarts, and a start in doubt moves away first ([`crate::Phase::Clear`]).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::ControlError;

/// Whether the tool may touch something.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Clearance {
    /// It hangs free: the last retraction ended in free space, a person said so, or nothing was ever touched.
    #[default]
    Free,
    /// It may touch: a task left its start and no retraction has ended in free space since.
    Possible {
        /// Away from the surface: unit, base axes.
        normal: Vector3<f64>,
        /// Where the tool's origin was last, base axes, m.
        position: Vector3<f64>,
    },
    /// It may touch, and which way is away is not known.
    Unknown,
}

impl Clearance {
    /// Nothing touches.
    pub fn is_free(&self) -> bool {
        matches!(self, Self::Free)
    }

    /// Whether a task may start with the tool at `position` (base axes, m): none if it hangs free, else the direction to move away
    /// in first.
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] where it may touch and the way out is not known.
    pub fn way_out(
        &self,
        config: &LeaveConfig,
        position: &Vector3<f64>,
    ) -> Result<Option<Vector3<f64>>, ControlError> {
        match self {
            Self::Free => Ok(None),
            Self::Unknown => Err(ControlError::MayTouch { moved_m: None }),
            Self::Possible {
                normal,
                position: last,
            } => {
                let moved_m = (position - last).norm();
                // Written so that a NaN refuses.
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

/// How the tool leaves a surface, and what shows that it did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LeaveConfig {
    /// Speed in phase `clear`, m/s.
    pub speed_m_per_s: f64,
    /// Way over which the force has to be steady for the tool to count as free, m.
    pub free_m: f64,
    /// Change of the force within that way that still counts as steady, N.
    pub steady_n: f64,
    /// Longest way in phase `clear`, m.
    pub distance_max_m: f64,
    /// Force against the motion, or across it, that phase `clear` may meet beyond that at its start, N.
    pub grow_n: f64,
    /// Force beyond the least one since its start that a retraction may meet, N.
    pub opposed_n: f64,
    /// Torque beyond the least one since its start that a retraction may meet, Nm.
    pub opposed_nm: f64,
    /// Highest speed of a retraction without a usable wrench, m/s.
    pub blind_speed_m_per_s: f64,
    /// The last known normal counts within this distance of the place it belongs to, m.
    pub near_m: f64,
    /// A touch within this distance of the place of the tare says that the tare was taken in contact, m.
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

/// What the force says of a motion away from the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Leaving {
    /// Not known yet.
    #[default]
    Going,
    /// The force has been steady over the way that shows it: the tool hangs free.
    Free,
    /// Something is in the way.
    Opposed,
}

/// Way from which on the least force of a retraction counts, m: before, the arm still turns around.
const TURNED_M: f64 = 0.001;

/// Watches the force while the tool moves away. Only differences count, so that any zero will do. A new one for each motion.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LeaveWatch {
    /// Force at the start, base axes.
    first: Option<Vector3<f64>>,
    /// Where the force began to be as it is, and what it was.
    steady: Option<(f64, Vector3<f64>)>,
    least_n: Option<f64>,
    least_nm: Option<f64>,
}

impl LeaveWatch {
    /// One cycle of phase `clear`, `way_m` along `normal` (unit) from its start, with the force on the tool in the same axes.
    /// `release_max_n`: more than that nothing can have pressed.
    pub fn clear(
        &mut self,
        config: &LeaveConfig,
        normal: &Vector3<f64>,
        way_m: f64,
        force: &Vector3<f64>,
        release_max_n: f64,
    ) -> Leaving {
        let first = *self.first.get_or_insert(*force);
        let change = force - first;
        let along = change.dot(normal);
        let across = (change - normal * along).norm();
        // What pressed against the normal lets go; what is met on the way pushes back the same way, and further.
        if along > config.grow_n
            || along < -(release_max_n + config.grow_n)
            || across > release_max_n + config.grow_n
        {
            return Leaving::Opposed;
        }
        self.steadiness(config, way_m, force)
    }

    /// One cycle of a retraction.
    pub fn retract(
        &mut self,
        config: &LeaveConfig,
        way_m: f64,
        force: &Vector3<f64>,
        torque_nm: f64,
    ) -> Leaving {
        if way_m >= TURNED_M {
            let least_n = self.least_n.unwrap_or(f64::INFINITY).min(force.norm());
            let least_nm = self.least_nm.unwrap_or(f64::INFINITY).min(torque_nm);
            (self.least_n, self.least_nm) = (Some(least_n), Some(least_nm));
            if force.norm() > least_n + config.opposed_n || torque_nm > least_nm + config.opposed_nm
            {
                return Leaving::Opposed;
            }
        }
        self.steadiness(config, way_m, force)
    }

    /// No wrench in this cycle: what was steady before says nothing any more.
    pub fn blind(&mut self) {
        self.steady = None;
    }

    fn steadiness(&mut self, config: &LeaveConfig, way_m: f64, force: &Vector3<f64>) -> Leaving {
        let (from, since) = *self.steady.get_or_insert((way_m, *force));
        if (force - since).norm() > config.steady_n || way_m < from {
            self.steady = Some((way_m, *force));
            return Leaving::Going;
        }
        if way_m - from >= config.free_m {
            Leaving::Free
        } else {
            Leaving::Going
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moves away from where `force_at` presses; how it ended, and the way gone, m.
    fn clear(force_at: impl Fn(f64) -> Vector3<f64>) -> (Leaving, f64) {
        let (config, mut watch) = (LeaveConfig::default(), LeaveWatch::default());
        let n = Vector3::z();
        for step in 0..500 {
            let way = 1e-4 * f64::from(step);
            match watch.clear(&config, &n, way, &force_at(way), 10.0) {
                Leaving::Going => {}
                ended => return (ended, way),
            }
        }
        (Leaving::Going, 0.05)
    }

    #[test]
    fn what_presses_lets_go_and_then_the_way_is_free() {
        for stiffness in [500.0, 2e3, 2e4] {
            // With a zero that hides all of it, or none.
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

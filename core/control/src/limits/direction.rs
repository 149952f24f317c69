//! Whether the measured force points where a contact can press.
//!
//! Called by `response_guard` in each cycle in which the tool presses. Friction tilts a force by at
//! most the friction angle, and the normal in use has a bounded error. A force that points further
//! aside for a while comes from a sensor whose zero has jumped or whose axes are exchanged, or the
//! normal in use is wrong. In each case the force along that normal says little about the true one.

use nalgebra::Vector3;

/// Time constant over which the force is averaged, s.
const MEAN_S: f64 = 0.02;
/// Cosine of the largest angle between force and normal, 70 degrees: friction with a coefficient of
/// 1.2, and an error of the normal of 20 degrees. Beyond it, a force is three times as large as its
/// part along the normal.
const COS_MIN: f64 = 0.342;
/// Force that is judged, N, and as a share of the reference. A weaker one may be an error of the
/// zero.
const STRONG_N: f64 = 2.0;
const STRONG_SHARE: f64 = 0.6;
/// Shortest time, s, and distance of the tool, m, for which the force points aside before it is a
/// fault; without motion, the longest time, s.
const SHORT_S: f64 = 0.03;
const WAY_M: f64 = 1e-3;
const LONG_S: f64 = 0.1;

/// Measurements of one cycle in which the tool presses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aimed {
    /// Force, N, in any axes that turn slowly.
    pub force: Vector3<f64>,
    /// Its part along the normal in use, N.
    pub pressing_n: f64,
    /// Reference of the pressing force, N.
    pub reference_n: f64,
    /// Distance of the tool since the last cycle, m.
    pub way_m: f64,
    /// Period, s.
    pub dt_s: f64,
}

/// State for one contact. A new one is the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Direction {
    force: Vector3<f64>,
    pressing_n: f64,
    aside_s: f64,
    aside_m: f64,
}

impl Direction {
    pub fn new(aimed: &Aimed) -> Self {
        Self {
            force: aimed.force,
            pressing_n: aimed.pressing_n,
            aside_s: 0.0,
            aside_m: 0.0,
        }
    }

    /// Processes one cycle; returns whether the force has pointed aside for too long.
    pub fn is_aside(&mut self, aimed: &Aimed) -> bool {
        let share = aimed.dt_s / (aimed.dt_s + MEAN_S);
        self.force += (aimed.force - self.force) * share;
        self.pressing_n += (aimed.pressing_n - self.pressing_n) * share;
        let force_n = self.force.norm();
        let strong_n = STRONG_N.max(STRONG_SHARE * aimed.reference_n);
        if force_n < strong_n || self.pressing_n >= COS_MIN * force_n {
            (self.aside_s, self.aside_m) = (0.0, 0.0);
            return false;
        }
        self.aside_s += aimed.dt_s;
        self.aside_m += aimed.way_m;
        self.aside_s >= LONG_S || (self.aside_s >= SHORT_S && self.aside_m >= WAY_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Time, s, after which a force at `angle` (degrees) from the normal is a fault, if it is.
    fn noticed_s(force_n: f64, angle: f64, speed: f64, dt_s: f64) -> Option<f64> {
        let (sin, cos) = angle.to_radians().sin_cos();
        let aimed = |force_n: f64, sin: f64, cos: f64| Aimed {
            force: Vector3::new(sin, 0.0, cos) * force_n,
            pressing_n: cos * force_n,
            reference_n: 3.0,
            way_m: speed * dt_s,
            dt_s,
        };
        let mut direction = Direction::new(&aimed(3.0, 0.0, 1.0));
        (1..5000).find_map(|k| {
            direction
                .is_aside(&aimed(force_n, sin, cos))
                .then_some(f64::from(k) * dt_s)
        })
    }

    #[test]
    fn a_force_along_the_surface_is_noticed_within_two_millimetres() {
        for dt_s in [0.001, 0.002, 0.008] {
            let sliding_s = noticed_s(4.0, 85.0, 0.02, dt_s).unwrap();
            assert!(0.02 * sliding_s <= 2e-3, "{sliding_s} s");
            let resting_s = noticed_s(4.0, 85.0, 0.0, dt_s).unwrap();
            assert!(resting_s <= 0.15, "{resting_s} s");
        }
    }

    #[test]
    fn friction_on_a_surface_landed_on_at_an_angle_is_no_fault() {
        // A coefficient of 0.9, and 25 degrees of undetected error.
        assert_eq!(noticed_s(5.0, 67.0, 0.02, 0.008), None);
        // An error of the zero without contact.
        assert_eq!(noticed_s(1.0, 90.0, 0.02, 0.008), None);
    }
}

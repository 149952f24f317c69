//! Viscous and Coulomb friction in the joints, smooth at zero speed. The simulated arm has it, and
//! a torque law compensates it.

use nalgebra::SVector;

use crate::Joints;

/// Friction of each joint.
///
/// ```
/// use tangent_mechanics::{JointFriction, Joints};
/// let friction = JointFriction::<2>::from_lists(&[2.0], &[5.0, 1.0], 0.01);
/// let torque = friction.torque(&Joints::<2>::new(1.0, 0.0));
/// assert!((torque[0] - 7.0).abs() < 1e-3);
/// assert_eq!(torque[1], 0.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFriction<const N: usize> {
    /// Viscous friction, Nm s/rad.
    pub viscous: Joints<N>,
    /// Coulomb friction, Nm.
    pub coulomb: Joints<N>,
    /// Speed at which Coulomb friction has reached 71 % of its value, rad/s.
    pub speed: f64,
}

impl<const N: usize> JointFriction<N> {
    /// Friction from lists with one entry per joint, base to flange. The last entry of a shorter
    /// list holds for the remaining joints; an empty list means no friction.
    pub fn from_lists(viscous: &[f64], coulomb: &[f64], speed: f64) -> Self {
        let per_joint = |values: &[f64]| {
            SVector::from_fn(|i, _| values.get(i).or(values.last()).copied().unwrap_or(0.0))
        };
        Self {
            viscous: per_joint(viscous),
            coulomb: per_joint(coulomb),
            speed,
        }
    }

    /// Friction torque divided by speed, Nm s/rad. It is never negative, so friction never adds
    /// energy.
    pub fn slope(&self, qd: &Joints<N>) -> Joints<N> {
        Joints::from_fn(|i, _| {
            self.viscous[i] + self.coulomb[i] / (qd[i] * qd[i] + self.speed * self.speed).sqrt()
        })
    }

    /// Motor torque that balances the friction, Nm.
    pub fn torque(&self, qd: &Joints<N>) -> Joints<N> {
        self.slope(qd).component_mul(qd)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_filled_up_and_fast_sliding_gives_the_stated_torque() {
        let friction = JointFriction::<3>::from_lists(&[2.0], &[5.0, 1.0], 0.01);
        assert_eq!(friction.viscous, Joints::<3>::repeat(2.0));
        assert_eq!(friction.coulomb, Joints::<3>::new(5.0, 1.0, 1.0));
        let torque = friction.torque(&Joints::<3>::new(1.0, -1.0, 0.0));
        assert!((torque[0] - 7.0).abs() < 1e-3 && (torque[1] + 3.0).abs() < 1e-3);
        assert_eq!(torque[2], 0.0);
        let none = JointFriction::<3>::from_lists(&[], &[], 0.01);
        assert_eq!(none.torque(&Joints::<3>::repeat(1.0)), Joints::<3>::zeros());
    }
}

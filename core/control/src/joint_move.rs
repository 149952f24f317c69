//! A motion of the arm to given joint positions, straight in joint space.
//!
//! Called by a velocity-controlled law in phase `travel`. Each cycle aims from the measured
//! positions at the target, so that the way stays straight from wherever the arm stands; all joints
//! arrive together. No inverse kinematics is involved, so singularities do not matter.

use nalgebra::SMatrix;
use tangent_mechanics::Joints;

/// Speed of the joint that is furthest from its target, per radian left, 1/s: low enough for an arm
/// that follows a tenth of a second late.
const GAIN_PER_S: f64 = 2.0;

/// Limits of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JointMoveLimits<const N: usize> {
    /// Joint speed, rad/s.
    pub speed_rad_per_s: Joints<N>,
    /// Joint acceleration, rad/s².
    pub acceleration_rad_per_s2: f64,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_m_per_s: f64,
    /// Angular speed of the tool, rad/s.
    pub tool_turn_rate_rad_per_s: f64,
}

/// Distance of the joint that is furthest from its target, rad.
pub(crate) fn left_rad<const N: usize>(q: &Joints<N>, target: &Joints<N>) -> f64 {
    (target - q).amax()
}

/// Joint velocities of the next cycle, rad/s, from those of the last one. `target`: `None` slows
/// down and stands. `jacobian` is that of the tool's origin at `q`.
pub(crate) fn step<const N: usize>(
    limits: &JointMoveLimits<N>,
    last: &Joints<N>,
    q: &Joints<N>,
    target: Option<&Joints<N>>,
    jacobian: &SMatrix<f64, 6, N>,
    dt_s: f64,
) -> Joints<N> {
    let wanted = target.map_or_else(Joints::zeros, |target| {
        let way = target - q;
        let left = way.amax();
        // Half of the acceleration leaves room for the arm's delay.
        let speed = (GAIN_PER_S * left).min((limits.acceleration_rad_per_s2 * left).sqrt());
        let qd = way * (speed / left.max(f64::MIN_POSITIVE));
        qd * share_within(limits, &qd, jacobian)
    });
    let change = wanted - last;
    let most = limits.acceleration_rad_per_s2 * dt_s;
    last + change * (most / change.amax().max(f64::MIN_POSITIVE)).min(1.0)
}

/// Largest share of `qd`, 0 to 1, within the speed limits of the joints and of the tool.
fn share_within<const N: usize>(
    limits: &JointMoveLimits<N>,
    qd: &Joints<N>,
    jacobian: &SMatrix<f64, 6, N>,
) -> f64 {
    let twist = jacobian * qd;
    let tool = [
        (twist.fixed_rows::<3>(0).norm(), limits.tool_speed_m_per_s),
        (
            twist.fixed_rows::<3>(3).norm(),
            limits.tool_turn_rate_rad_per_s,
        ),
    ];
    let joints = (0..N).map(|i| (qd[i].abs(), limits.speed_rad_per_s[i]));
    joints.chain(tool).fold(1.0, |share: f64, (value, limit)| {
        if value > limit {
            share.min(limit / value)
        } else {
            share
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::{Arm, Flange, ModelData, Pose, Tool};

    const DT_S: f64 = 0.008;

    fn limits() -> JointMoveLimits<6> {
        JointMoveLimits {
            speed_rad_per_s: Joints::<6>::repeat(0.2),
            acceleration_rad_per_s2: 0.5,
            tool_speed_m_per_s: 0.1,
            tool_turn_rate_rad_per_s: 0.3,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// From any pose to any other: every limit holds in every cycle, the way is straight, and
        /// it ends at the target.
        #[test]
        fn the_way_is_straight_within_all_limits_and_arrives(from in prop::array::uniform6(-3.0f64..3.0), to in prop::array::uniform6(-3.0f64..3.0)) {
            let arm = Arm::<6>::new(&ModelData::builtin("ur5").unwrap()).unwrap();
            let (limits, tool) = (limits(), Pose::<Flange, Tool>::identity());
            let (start, target) = (Joints::from(from), Joints::from(to));
            let along = (target - start).normalize();
            let (mut q, mut qd) = (start, Joints::zeros());
            let mut cycles = 0;
            while left_rad(&q, &target) > 1e-3 {
                let jacobian = arm.jacobian_at(&q, &tool);
                let next = step(&limits, &qd, &q, Some(&target), &jacobian, DT_S);
                prop_assert!((next - qd).amax() <= limits.acceleration_rad_per_s2 * DT_S + 1e-12);
                prop_assert!(next.amax() <= 0.2 + 1e-12);
                let twist = jacobian * next;
                // The acceleration limit may delay a slow-down that the tool's limit asks for.
                prop_assert!(twist.fixed_rows::<3>(0).norm() <= 0.1 * 1.05, "{}", twist.fixed_rows::<3>(0).norm());
                qd = next;
                q += qd * DT_S;
                let aside = (q - start) - along * (q - start).dot(&along);
                prop_assert!(aside.amax() < 1e-6, "{aside}");
                cycles += 1;
                prop_assert!(cycles < 60_000);
            }
            prop_assert!(left_rad(&start, &target) < 1e-3 || cycles > 0);
        }
    }

    #[test]
    fn without_a_target_it_comes_to_rest_within_the_acceleration_limit() {
        let (limits, jacobian) = (limits(), SMatrix::<f64, 6, 6>::zeros());
        let (mut qd, q) = (Joints::<6>::repeat(0.2), Joints::zeros());
        let mut cycles = 0;
        while qd != Joints::<6>::zeros() {
            let next = step(&limits, &qd, &q, None, &jacobian, DT_S);
            assert!((next - qd).amax() <= 0.5 * DT_S + 1e-12);
            qd = next;
            cycles += 1;
            assert!(cycles <= 51);
        }
        assert!(cycles >= 49);
    }
}

//! Joint and torque limits of a torque law: accelerations that keep the joints away from their end
//! stops, and torques that the motors can produce.

use tangent_mechanics::{Joints, Limits as ArmLimits};

use crate::limits::Limits;

/// Time in which a joint that is too fast, or too near its end stop for its speed, is brought back,
/// s.
const BRAKING_S: f64 = 0.02;

/// Accelerations (rad/s²) nearest to `wanted` that keep every joint within its speed limit and able
/// to stop before its end stop. The flag is true if anything was limited.
pub(crate) fn bounded_acceleration<const N: usize>(
    arm: &ArmLimits<N>,
    cell: &Limits,
    q: &Joints<N>,
    qd: &Joints<N>,
    wanted: &Joints<N>,
) -> (Joints<N>, bool) {
    let mut cut = false;
    let brake = cell.joint_acceleration_max_rad_per_s2;
    let bounded = Joints::<N>::from_fn(|i, _| {
        let top = arm.velocity[i] * cell.joint_speed_share;
        let speed_up = |room: f64| {
            if room > 0.0 {
                (2.0 * brake * room).sqrt().min(top)
            } else {
                0.0
            }
        };
        let upwards = speed_up(arm.position_upper[i] - cell.joint_margin_rad - q[i]);
        let downwards = -speed_up(q[i] - arm.position_lower[i] - cell.joint_margin_rad);
        let (low, high) = (
            (downwards - qd[i]) / BRAKING_S,
            (upwards - qd[i]) / BRAKING_S,
        );
        // `min` and `max` instead of `clamp`: a joint outside both bounds must not panic.
        let value = wanted[i].min(high).max(low);
        cut |= value != wanted[i];
        value
    });
    (bounded, cut)
}

/// `needed` plus as much of `wanted` (Nm) as the motors can produce. The torques that hold the arm
/// come first; those that move it are scaled together, so that they keep their direction. Also
/// returns the remaining share of `wanted`. NaN stays NaN, so that the caller sees it.
pub(crate) fn bounded_torque<const N: usize>(
    arm: &ArmLimits<N>,
    needed: &Joints<N>,
    wanted: &Joints<N>,
) -> (Joints<N>, f64) {
    let Some(effort) = arm.effort else {
        return (needed + wanted, 1.0);
    };
    let mut share = 1.0_f64;
    for i in 0..N {
        let room = if wanted[i] > 0.0 {
            effort[i] - needed[i]
        } else {
            effort[i] + needed[i]
        };
        if wanted[i].abs() > room.max(0.0) {
            share = share.min(room.max(0.0) / wanted[i].abs());
        }
    }
    let torque = needed + wanted * share;
    (
        Joints::from_fn(|i, _| {
            if torque[i].is_nan() {
                torque[i]
            } else {
                torque[i].min(effort[i]).max(-effort[i])
            }
        }),
        share,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::{Arm, ModelData};

    fn arm() -> Arm<6> {
        Arm::new(&ModelData::builtin("smart3s_substitute").unwrap()).unwrap()
    }

    proptest! {
        #[test]
        fn a_joint_driven_at_its_stop_stays_off_it(push in prop::array::uniform6(-60.0f64..60.0), at in prop::array::uniform6(0.1f64..0.9)) {
            let (arm, cell) = (arm(), Limits::default());
            let limits = arm.limits();
            let mut q = Joints::<6>::from_fn(|i, _| limits.position_lower[i] + at[i] * (limits.position_upper[i] - limits.position_lower[i]));
            let mut qd = Joints::<6>::zeros();
            for _ in 0..20_000 {
                let (qdd, _) = bounded_acceleration(limits, &cell, &q, &qd, &push.into());
                qd += qdd * 1e-3;
                q += qd * 1e-3;
                for i in 0..6 {
                    prop_assert!(qd[i].abs() <= limits.velocity[i] * cell.joint_speed_share + 0.2);
                }
            }
            prop_assert!(limits.contains(&q), "{q}");
        }

        #[test]
        fn torques_stay_within_the_effort(needed in prop::array::uniform6(-3000.0f64..3000.0), wanted in prop::array::uniform6(-1e4f64..1e4)) {
            let arm = arm();
            let (torque, _) = bounded_torque(arm.limits(), &needed.into(), &wanted.into());
            let effort = arm.limits().effort.unwrap();
            prop_assert!((0..6).all(|i| torque[i].abs() <= effort[i]));
        }
    }

    #[test]
    fn what_is_no_number_does_not_become_full_effort() {
        let arm = arm();
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let wanted = Joints::<6>::new(0.0, bad, 0.0, 0.0, 0.0, 0.0);
            let (torque, _) = bounded_torque(arm.limits(), &Joints::zeros(), &wanted);
            assert!(!torque[1].is_finite(), "{bad}: {torque}");
        }
    }

    #[test]
    fn within_the_limits_nothing_changes() {
        let arm = arm();
        let wanted = Joints::<6>::repeat(1.0);
        let rest = Joints::<6>::zeros();
        let (qdd, cut) = bounded_acceleration(
            arm.limits(),
            &Limits::default(),
            &arm.home(),
            &rest,
            &wanted,
        );
        assert_eq!((qdd, cut), (wanted, false));
        let (torque, share) = bounded_torque(arm.limits(), &arm.gravity(&arm.home()), &wanted);
        assert_eq!((torque, share), (arm.gravity(&arm.home()) + wanted, 1.0));
    }
}

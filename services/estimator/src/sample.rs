//! Converts bus messages to estimator input: one contact sample per arm state.

use std::time::Duration;

use tangent_estimation::ContactSample;
use tangent_mechanics::{Aligned, Arm, Base, Flange, Joints, ModelData, Pose, Tool, Twist, Wrench};
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::{ArmState, WrenchStatus};
use tangent_sensing::Validity;

use crate::EstimatorError;

/// Largest time between a status and a wrench that belong together, s.
const PAIR_MAX_S: f64 = 0.05;
/// A step of the robot's clock beyond this, s, means a restart or a long interruption.
const JUMP_MAX_S: f64 = 1.0;

/// Converts commanded joint velocities to a twist; `None` if the number of joints does not match
/// the arm.
pub(crate) type CommandedTwist =
    Box<dyn Fn(&[f64], &[f64]) -> Option<Twist<Aligned<Tool, Base>>> + Send>;

/// For the arm of `model`, at the tool.
pub(crate) fn commanded_twist(
    model: &ModelData,
    flange_from_tool: Pose<Flange, Tool>,
) -> Result<CommandedTwist, EstimatorError> {
    match model.dof {
        6 => of_arm(Arm::<6>::new(model)?, flange_from_tool),
        7 => of_arm(Arm::<7>::new(model)?, flange_from_tool),
        dof => Err(EstimatorError::Joints {
            name: model.name.clone(),
            dof,
        }),
    }
}

fn of_arm<const N: usize>(
    arm: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
) -> Result<CommandedTwist, EstimatorError> {
    Ok(Box::new(move |q, qd| {
        if q.len() != N || qd.len() != N {
            return None;
        }
        let (q, qd) = (
            Joints::<N>::from_column_slice(q),
            Joints::<N>::from_column_slice(qd),
        );
        let twist = arm.jacobian_at(&q, &flange_from_tool) * qd;
        Some(Twist::from_vector(&twist))
    }))
}

/// The newest wrench, with the time since its arrival.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewestWrench<'a> {
    pub wrench: &'a WrenchStamped,
    pub status: &'a WrenchStatus,
    /// Time since it was received.
    pub age: Duration,
}

/// Joins arm states and wrenches, and provides a time that never jumps.
#[derive(Default)]
pub(crate) struct SampleBuilder {
    robot_time_s: Option<f64>,
    time_s: f64,
}

/// A sample, and whether the robot's clock restarted before it.
pub(crate) struct BuiltSample {
    pub sample: ContactSample,
    pub restarted: bool,
}

impl SampleBuilder {
    /// Builds a sample; `None` if the arm's pose is invalid.
    pub fn build(
        &mut self,
        arm: &ArmState,
        commanded: &CommandedTwist,
        wrench: Option<NewestWrench<'_>>,
        patience: Duration,
    ) -> Option<BuiltSample> {
        let base_from_tool: Pose<Base, Tool> = (&arm.tool_pose).try_into().ok()?;
        if !arm.robot_time_s.is_finite() {
            return None;
        }
        let step = self
            .robot_time_s
            .map_or(arm.period_s, |last| arm.robot_time_s - last);
        // A repeated packet has dt = 0; the estimator refuses it, with the reason.
        let restarted = !(0.0..=JUMP_MAX_S).contains(&step);
        let dt_s = if restarted { arm.period_s } else { step };
        self.robot_time_s = Some(arm.robot_time_s);
        self.time_s += dt_s.max(0.0);
        let twist = Twist::from(&arm.tool_twist);
        let wrench_bias_age_s = wrench
            .map(|w| w.status.bias_age_s)
            .filter(|age| *age >= 0.0);
        let (wrench, wrench_delay_s, wrench_validity) = judge(arm, wrench, patience);
        Some(BuiltSample {
            sample: ContactSample {
                time_s: self.time_s,
                dt_s,
                base_from_tool,
                twist,
                twist_commanded: commanded(&arm.q, &arm.qd_target).unwrap_or(twist),
                wrench,
                wrench_delay_s,
                wrench_validity,
                wrench_bias_age_s,
                base: None,
            },
            restarted,
        })
    }
}

/// The wrench, its lag behind the arm's state, and its validity.
fn judge(
    arm: &ArmState,
    newest: Option<NewestWrench<'_>>,
    patience: Duration,
) -> (Wrench<Tool>, f64, Validity) {
    let Some(newest) = newest else {
        return (Wrench::zero(), 0.0, Validity::Missing);
    };
    let wrench = Wrench::from(&newest.wrench.wrench);
    let apart_s = |a: i64, b: i64| (i128::from(a) - i128::from(b)) as f64 * 1e-9;
    let stamp = newest.wrench.header.stamp.to_ns();
    let behind = apart_s(arm.header.stamp.to_ns(), stamp).clamp(0.0, PAIR_MAX_S);
    let delay = newest.status.filter_delay_s + behind;
    let delay = if delay.is_finite() { delay } else { behind };
    let verdict = Validity::from(newest.status.validity);
    let unpaired = apart_s(newest.status.header.stamp.to_ns(), stamp).abs() > PAIR_MAX_S;
    let validity = if newest.age > patience || unpaired {
        Validity::Stale
    } else if verdict.is_valid() && !wrench.is_finite() {
        Validity::NotFinite
    } else {
        verdict
    };
    (wrench, delay, validity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_schemas::standard::Header;

    const PATIENCE: Duration = Duration::from_millis(50);

    fn arm(robot_time_s: f64) -> ArmState {
        let mut arm = ArmState {
            header: Header::new(1_000_000_000 + (robot_time_s * 1e9) as i64, "base"),
            robot_time_s,
            period_s: 0.008,
            q: [0.1, -1.2, 1.4, -1.7, -1.5, 0.0].into_iter().collect(),
            qd_target: [0.01, 0.02, -0.03, 0.0, 0.1, 0.2].into_iter().collect(),
            ..ArmState::default()
        };
        arm.tool_pose.orientation.w = 1.0;
        arm
    }

    fn pair(stamp_s: f64, validity: u8) -> (WrenchStamped, WrenchStatus) {
        let header = Header::new(1_000_000_000 + (stamp_s * 1e9) as i64, "tool");
        let mut wrench = WrenchStamped {
            header: header.clone(),
            ..Default::default()
        };
        wrench.wrench.force.z = -3.0;
        let status = WrenchStatus {
            header,
            validity,
            filter_delay_s: 0.004,
            ..Default::default()
        };
        (wrench, status)
    }

    fn ur5() -> CommandedTwist {
        let model = ModelData::builtin("ur5").unwrap();
        commanded_twist(&model, Pose::identity()).unwrap()
    }

    fn validity(
        robot_time_s: f64,
        pair: &(WrenchStamped, WrenchStatus),
        age: Duration,
    ) -> Validity {
        let newest = NewestWrench {
            wrench: &pair.0,
            status: &pair.1,
            age,
        };
        let mut builder = SampleBuilder::default();
        let built = builder
            .build(&arm(robot_time_s), &ur5(), Some(newest), PATIENCE)
            .unwrap();
        built.sample.wrench_validity
    }

    #[test]
    fn a_wrench_is_used_only_when_fresh_paired_and_said_to_be_valid() {
        let now = Duration::ZERO;
        assert_eq!(validity(1.0, &pair(0.998, 0), now), Validity::Valid);
        assert_eq!(validity(1.0, &pair(0.998, 3), now), Validity::Saturated);
        assert_eq!(
            validity(1.0, &pair(0.998, 0), PATIENCE * 2),
            Validity::Stale
        );
        let (wrench, mut status) = pair(0.998, 0);
        status.header = Header::new(0, "tool");
        assert_eq!(
            validity(1.0, &(wrench.clone(), status), now),
            Validity::Stale
        );
        let (mut wrench, status) = pair(0.998, 0);
        wrench.wrench.torque.x = f64::NAN;
        assert_eq!(validity(1.0, &(wrench, status), now), Validity::NotFinite);
        let mut builder = SampleBuilder::default();
        let none = builder.build(&arm(1.0), &ur5(), None, PATIENCE).unwrap();
        assert_eq!(none.sample.wrench_validity, Validity::Missing);
    }

    #[test]
    fn the_delay_is_that_of_the_filter_and_of_the_wait() {
        let (wrench, status) = pair(0.998, 0);
        let newest = NewestWrench {
            wrench: &wrench,
            status: &status,
            age: Duration::ZERO,
        };
        let built = SampleBuilder::default()
            .build(&arm(1.0), &ur5(), Some(newest), PATIENCE)
            .unwrap();
        assert!((built.sample.wrench_delay_s - 0.006).abs() < 1e-9);
    }

    #[test]
    fn time_never_goes_back_and_a_restart_of_the_robot_is_noticed() {
        let mut builder = SampleBuilder::default();
        let mut last = 0.0;
        for (time, restarted, moved) in [
            (5.0, false, true),
            (5.008, false, true),
            (5.008, false, false),
            (5.016, false, true),
            (0.1, true, true),
            (0.108, false, true),
            (90.0, true, true),
        ] {
            let built = builder.build(&arm(time), &ur5(), None, PATIENCE).unwrap();
            assert_eq!(built.restarted, restarted, "at {time}");
            assert_eq!(built.sample.time_s > last, moved, "at {time}");
            assert!(built.sample.time_s >= last);
            last = built.sample.time_s;
        }
    }

    #[test]
    fn the_commanded_twist_is_that_of_the_jacobian_and_falls_back_to_the_measured_one() {
        let model = ModelData::builtin("ur5").unwrap();
        let ur5 = Arm::<6>::new(&model).unwrap();
        let state = arm(1.0);
        let built = SampleBuilder::default()
            .build(&state, &self::ur5(), None, PATIENCE)
            .unwrap();
        let q = Joints::<6>::from_column_slice(&state.q);
        let expected = ur5.jacobian(&q) * Joints::<6>::from_column_slice(&state.qd_target);
        assert!((built.sample.twist_commanded.vector() - expected).norm() < 1e-12);

        let mut short = state;
        short.qd_target.pop();
        short.tool_twist.linear.x = 0.5;
        let built = SampleBuilder::default()
            .build(&short, &self::ur5(), None, PATIENCE)
            .unwrap();
        assert_eq!(built.sample.twist_commanded.linear.x, 0.5);
    }

    #[test]
    fn an_invalid_pose_gives_no_sample() {
        let mut state = arm(1.0);
        state.tool_pose.orientation.w = 0.0;
        assert!(
            SampleBuilder::default()
                .build(&state, &ur5(), None, PATIENCE)
                .is_none()
        );
        let mut state = arm(1.0);
        state.robot_time_s = f64::NAN;
        assert!(
            SampleBuilder::default()
                .build(&state, &ur5(), None, PATIENCE)
                .is_none()
        );
    }
}

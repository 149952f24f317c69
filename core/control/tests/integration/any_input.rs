//! The composed controller with arbitrary inputs.

use crate::bench::{Bench, TASK};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use tangent_control::{ControlInput, Fault, Limits, Phase, UntaredLoad};
use tangent_mechanics::{Pose, Twist};
use tangent_sensing::{BaseMotion, Validity};

/// Arbitrary numbers: any bit pattern, and those most likely to cause errors.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -5.0f64..5.0,
        1 => -1e6f64..1e6,
        2 => any::<u64>().prop_map(f64::from_bits),
        1 => prop::sample::select(vec![
            f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 1e150, -1e150, f64::MIN_POSITIVE, 0.0, -0.0,
        ]),
    ]
}

/// Validity codes that are tried: all valid ones, and an invalid one.
const CODES: u64 = 16;
/// Number of fields of the input.
const FIELDS: u32 = 20;

/// Which fields of a cycle are replaced, one bit each, and by which numbers.
fn mess() -> impl Strategy<Value = (u32, Vec<f64>)> {
    let fields =
        prop_oneof![2 => Just(0u32), 3 => (0..FIELDS).prop_map(|i| 1 << i), 1 => any::<u32>()];
    (fields, prop::collection::vec(number(), 64))
}

/// Puts `numbers`, one after the other, into the fields of `mask`.
fn spoil(input: &mut ControlInput, mask: u32, numbers: &[f64]) {
    let mut numbers = numbers.iter().copied().cycle();
    let mut next = || numbers.next().unwrap();
    let on = |bit: u32| mask & (1 << bit) != 0;
    if on(0) {
        input.time_s = next();
    }
    if on(1) {
        input.dt_s = next();
    }
    if on(2) {
        input.q[next().to_bits() as usize % 6] = next();
    }
    if on(3) {
        input.qd[next().to_bits() as usize % 6] = next();
    }
    if on(4) {
        input.base_from_tool = pose(&mut next);
    }
    if on(5) {
        input.twist.linear = Vector3::from_fn(|_, _| next());
    }
    if on(6) {
        input.twist.angular = Vector3::from_fn(|_, _| next());
    }
    if on(7) {
        input.speed_scaling = next();
    }
    if on(8) {
        input.arm_ready = next() > -4.9;
    }
    if on(9) {
        input.wrench.force = Vector3::from_fn(|_, _| next());
    }
    if on(10) {
        input.wrench.torque = Vector3::from_fn(|_, _| next());
    }
    if on(11) {
        input.wrench_validity = Validity::from((next().to_bits() % CODES) as u8);
    }
    if on(12) {
        input.wrench_age_s = next();
    }
    if on(13) {
        input.wrench_delay_s = next();
    }
    if on(14) {
        input.bias_age_s = Some(next());
    }
    for slot in input.estimates.iter_mut().flatten() {
        if on(15) {
            slot.estimate.normal = Vector3::from_fn(|_, _| next());
            slot.estimate.point = Vector3::from_fn(|_, _| next());
        }
        if on(16) {
            slot.estimate.covariance = Matrix3::from_fn(|_, _| next());
            slot.estimate.curvature = Some(Matrix3::from_fn(|_, _| next()));
            slot.estimate.friction = Some(next());
            slot.age_s = next();
        }
    }
    if on(17) {
        input.base = Some(BaseMotion {
            world_from_base: pose(&mut next),
            twist: Twist::new(
                Vector3::from_fn(|_, _| next()),
                Vector3::from_fn(|_, _| next()),
            ),
            age_s: next(),
            trouble: None,
        });
    }
    if on(18) {
        input.zero_bound_n = Some(next());
    }
    if on(19) {
        input.untared = Some(UntaredLoad {
            beyond_reference_n: Some(next()),
            rated_share: Some(next()),
        });
    }
}

fn pose<A, B>(next: &mut impl FnMut() -> f64) -> Pose<A, B> {
    let turn = Quaternion::new(next(), next(), next(), next());
    let translation = Vector3::from_fn(|_, _| next());
    Pose::new(translation, UnitQuaternion::new_unchecked(turn))
}

/// A task that first travels to a start pose.
fn travelling() -> String {
    format!("{TASK}\n[start]\njoints_rad = [0.6, -1.5, 1.5, -1.6, -1.5, 0.4]")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// On the way to a start pose, any input leaves every joint within the speed of the task.
    #[test]
    fn no_input_leads_beyond_the_limits_on_the_way_to_the_start(messes in prop::collection::vec(mess(), 1..60), from in 0usize..200) {
        let mut bench = Bench::new(&travelling());
        bench.steps(from);
        for (mask, numbers) in messes {
            let output = bench.step(|input| spoil(input, mask, &numbers));
            if output.phase == Phase::Travel {
                prop_assert!(output.qd.amax() <= 0.2 + 1e-9);
            }
        }
    }

    /// For any input, the command stays within every limit (checked in `Bench::step`), and so does
    /// the tool's speed.
    #[test]
    fn no_input_leads_beyond_the_limits(messes in prop::collection::vec(mess(), 1..60), from in 0usize..700) {
        let mut bench = Bench::new(TASK);
        bench.steps(from);
        for (mask, numbers) in messes {
            let output = bench.step(|input| spoil(input, mask, &numbers));
            let limits = Limits::default();
            prop_assert!(output.twist_commanded.linear.norm() <= limits.speed_max_m_per_s + 1e-9);
            prop_assert!(output.twist_commanded.angular.norm() <= limits.turn_rate_max_rad_per_s + 1e-9);
            prop_assert!(output.path_reference.iter().all(|x| x.is_finite()));
            prop_assert!(output.force_n.is_none_or(f64::is_finite) && output.path_error_m.is_finite());
            prop_assert!(output.path_progress.is_finite() && output.alignment_error_rad.is_finite());
        }
        bench.steps(50);
    }

    /// Equal inputs give equal outputs, bit for bit.
    #[test]
    fn a_run_repeats_bit_for_bit(stiffness in 1e3f64..2e4) {
        let run = || {
            let mut bench = Bench::new(TASK);
            bench.stiffness = stiffness;
            let mut bits = Vec::new();
            for _ in 0..600 {
                let output = bench.step(|_| {});
                bits.extend(output.qd.iter().map(|v| v.to_bits()));
            }
            bits
        };
        prop_assert_eq!(run(), run());
    }
}

const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300];

/// With the fields of `mask` bad from now on, the task ends with a fault within `cycles`.
fn faults_within(mask: u32, bad: &[f64], cycles: usize, expected: impl Fn(Fault) -> bool) {
    for &value in bad {
        let mut bench = Bench::sliding(TASK);
        let fault = (0..cycles).find_map(|_| {
            let output = bench.step(|input| spoil(input, mask, &[value]));
            let ends = matches!(output.phase, Phase::Fault | Phase::Retract);
            output.fault.filter(|_| ends)
        });
        let fault = fault
            .unwrap_or_else(|| panic!("fields {mask:b} = {value}: no fault in {cycles} cycles"));
        assert!(expected(fault), "fields {mask:b} = {value}: {fault:?}");
    }
}

#[test]
fn every_fault_fires_within_its_bound() {
    let arm = |fault| fault == Fault::ArmState;
    let no_time = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    faults_within(1 << 0, &no_time, 1, arm);
    faults_within(1 << 1, &[0.0, -0.008, 1.0], 1, arm);
    for field in 1..=6 {
        faults_within(1 << field, &BAD, 1, arm);
    }
    faults_within(1 << 7, &no_time, 1, arm);
    for field in [9, 10] {
        faults_within(1 << field, &BAD, 2, |fault| {
            matches!(
                fault,
                Fault::Wrench(_) | Fault::ForceLimit(_) | Fault::TorqueLimit(_)
            )
        });
    }
    // A missing wrench is tolerated for 0.1 s.
    let no_age = [f64::NAN, f64::INFINITY, 1e300];
    faults_within(1 << 12, &no_age, 14, |fault| {
        fault == Fault::Wrench(Validity::Stale)
    });
    // A bad estimate is tolerated for 0.1 s, and a missing one for 1 s.
    for field in [15, 16] {
        faults_within(1 << field, &no_time, 140, |fault| {
            matches!(fault, Fault::Estimate(_))
        });
    }
}

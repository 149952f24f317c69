//! The composed controller under whatever its inputs may say.

#![allow(clippy::unwrap_used)]

mod bench;

use bench::{Bench, TASK};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use tangent_control::Limits;
use tangent_sensing::Validity;

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -5.0f64..5.0,
        1 => -1e6f64..1e6,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
    ]
}

#[derive(Clone, Debug)]
struct Mess {
    force: [f64; 3],
    validity: u8,
    age: f64,
    normal: [f64; 3],
    estimate_age: f64,
    scaling: f64,
    ready: bool,
    curvature: f64,
}

fn mess() -> impl Strategy<Value = Mess> {
    (
        prop::array::uniform3(number()),
        prop_oneof![8 => Just(0u8), 2 => 0u8..12],
        prop_oneof![5 => 0.0f64..0.02, 1 => number()],
        prop::array::uniform3(number()),
        prop_oneof![5 => 0.0f64..0.09, 1 => number()],
        prop_oneof![5 => Just(1.0), 1 => number()],
        prop::bool::weighted(0.99),
        number(),
    )
        .prop_map(
            |(force, validity, age, normal, estimate_age, scaling, ready, curvature)| Mess {
                force,
                validity,
                age,
                normal,
                estimate_age,
                scaling,
                ready,
                curvature,
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever comes in, the command stays inside every limit (checked in `Bench::step`), and the tool's speed too.
    #[test]
    fn no_input_leads_beyond_the_limits(messes in prop::collection::vec(mess(), 1..150), from in 0usize..700) {
        let mut bench = Bench::new(TASK);
        bench.steps(from);
        for m in messes {
            let output = bench.step(|input| {
                input.wrench.force = Vector3::from(m.force);
                input.wrench_validity = Validity::from(m.validity);
                input.wrench_age_s = m.age;
                input.speed_scaling = m.scaling;
                input.arm_ready = m.ready;
                for slot in input.estimates.iter_mut().flatten() {
                    slot.estimate.normal = Vector3::from(m.normal);
                    slot.estimate.curvature = Some(Matrix3::identity() * m.curvature);
                    slot.age_s = m.estimate_age;
                }
            });
            let limits = Limits::default();
            prop_assert!(output.twist_commanded.linear.norm() <= limits.speed_max_m_per_s + 1e-9);
            prop_assert!(output.twist_commanded.angular.norm() <= limits.turn_rate_max_rad_per_s + 1e-9);
            prop_assert!(output.path_reference.iter().all(|x| x.is_finite()));
        }
    }

    /// Equal input, equal output, bit for bit.
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

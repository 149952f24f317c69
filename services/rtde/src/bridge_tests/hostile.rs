//! Arbitrary bytes and numbers as input.

use proptest::prelude::*;

use super::bench::{Cell, posture};
use crate::codec::*;

proptest! {
    #[test]
    fn no_package_makes_it_panic(
        packages in prop::collection::vec((any::<u8>(), prop::collection::vec(any::<u8>(), 0..400), any::<bool>()), 1..40),
    ) {
        let mut cell = Cell::ready(Series::Cb3);
        for (kind, payload, known) in &packages {
            let kind = if *known { PackageKind::ALL[usize::from(*kind) % 8].code() } else { *kind };
            let mut out = Vec::new();
            let _ = cell.bridge.package(Package { kind, payload }, cell.now_s, &mut out);
            let posture = posture(&cell.bridge);
            let _ = cell.bridge.command(&posture, None, cell.now_s, &mut out);
            prop_assert!(out.len() < 10_000);
        }
    }

    /// For any numbers in a well-formed state, the commands stay within the limits.
    #[test]
    fn no_state_makes_it_send_nonsense(doubles in prop::collection::vec(any::<u64>(), 30), words in prop::collection::vec(any::<i32>(), 12)) {
        let mut cell = Cell::ready(Series::Cb3);
        cell.task();
        cell.until("motion", Cell::moves);
        let d = |i: usize| f64::from_bits(doubles[i]);
        let s = &mut cell.robot.sample;
        s.q = std::array::from_fn(d);
        s.qd = std::array::from_fn(|i| d(6 + i));
        s.speed_scaling = d(20);
        s.target_speed_fraction = d(21);
        s.robot_mode = words[0];
        s.safety_mode = words[1];
        s.program_state = words[2];
        s.loops = words[3];
        s.cause = words[4];
        s.sequence_used = words[5];
        for _ in 0..5 {
            if cell.step().is_err() {
                break;
            }
            for i in 4..10 {
                prop_assert!(cell.robot.registers[i].as_double().unwrap().abs() <= 1.0);
            }
        }
    }
}

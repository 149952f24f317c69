//! The composed controller on a moving base, and on a base whose motion is not known.

use crate::bench::{Bench, TASK};
use nalgebra::{UnitQuaternion, Vector3};
use tangent_control::{ControlInput, ControlOutput, Fault, Phase};
use tangent_mechanics::{Base, Pose, Twist};
use tangent_sensing::{BaseMotion, BaseTrouble, Validity};

/// A base at rest, with an optional fault of its measurement.
fn standing(trouble: Option<BaseTrouble>) -> BaseMotion {
    BaseMotion {
        age_s: 0.01,
        trouble,
        ..BaseMotion::still()
    }
}

fn long() -> String {
    TASK.replace("0.04, 0.0", "0.3, 0.0")
}

#[test]
fn a_base_that_is_known_to_stand_changes_nothing() {
    let (mut fixed, mut known) = (Bench::new(TASK), Bench::new(TASK));
    for _ in 0..2500 {
        let a = fixed.step(|_| {});
        let b = known.step(|input| input.base = Some(standing(None)));
        assert!((a.qd - b.qd).norm() < 1e-9);
        assert_eq!(a.phase, b.phase);
        assert_eq!((a.base_age_s, b.base_age_s), (-1.0, 0.01));
    }
    assert_eq!(fixed.last.unwrap().phase, Phase::Done);
}

/// The base's velocity is subtracted from the arm's motion: the tool stays at its place over the
/// floor.
#[test]
fn the_velocity_of_the_base_is_fed_forward() {
    let twist = Twist::<Base>::new(
        Vector3::new(0.01, -0.015, 0.0),
        Vector3::new(0.0, 0.0, 0.02),
    );
    let mut bench = Bench::sliding(&long());
    bench.controller.pause().unwrap();
    bench.steps(100);
    // Some cycles for the limits on acceleration.
    let mut output: Option<ControlOutput> = None;
    for i in 0..4 {
        let t = f64::from(i) * bench.dt_s;
        let base = BaseMotion {
            world_from_base: Pose::new(twist.linear * t, UnitQuaternion::new(twist.angular * t)),
            twist,
            age_s: 0.0,
            trouble: None,
        };
        output = Some(bench.step(|input: &mut ControlInput| input.base = Some(base)));
    }
    let output = output.unwrap();
    let carried = twist.linear + twist.angular.cross(&bench.tool());
    let made = output.twist_commanded.linear + carried;
    assert!(made.xy().norm() < 2e-3, "{made}");
    assert!((output.twist_commanded.angular + twist.angular).norm() < 2e-2);
}

#[test]
fn an_unknown_base_stops_the_path_keeps_the_force_and_retracts_after_a_second() {
    for trouble in [
        BaseTrouble::Silent,
        BaseTrouble::Unsettled,
        BaseTrouble::NotFinite,
        BaseTrouble::TooFast,
        BaseTrouble::Missing,
    ] {
        let mut bench = Bench::sliding(&long());
        for _ in 0..60 {
            bench.step(|input| input.base = Some(standing(None)));
        }
        let spoil = |input: &mut ControlInput| input.base = Some(standing(Some(trouble)));
        let since = bench.time_s;
        assert_eq!(bench.step(spoil).phase, Phase::Hold, "{trouble:?}");
        let at = bench.tool();
        let mut output = bench.step(spoil);
        while output.phase == Phase::Hold {
            assert!(
                (output.force_n.unwrap() - 3.0).abs() < 0.3,
                "{}",
                output.force_n.unwrap()
            );
            output = bench.step(spoil);
        }
        assert_eq!(output.phase, Phase::Retract);
        let held = bench.time_s - since;
        let patience = bench.controller.config().patience.base_retract_s;
        assert!((held - patience).abs() < 0.05, "{held}");
        assert!((bench.tool() - at).norm() < 5e-3);
        while output.phase.is_active() {
            output = bench.step(spoil);
        }
        assert_eq!(
            (output.phase, output.fault),
            (Phase::Fault, Some(Fault::Base(trouble)))
        );
        assert!(!output.fault.unwrap().text().is_empty());
    }
}

#[test]
fn a_short_trouble_is_ridden_out() {
    let mut bench = Bench::sliding(TASK);
    bench.steps(60);
    for _ in 0..50 {
        let output = bench.step(|input| input.base = Some(standing(Some(BaseTrouble::Unsettled))));
        assert_eq!(output.phase, Phase::Hold);
    }
    let mut output = bench.step(|input| input.base = Some(standing(None)));
    assert_eq!(output.phase, Phase::Slide);
    while output.phase.is_active() {
        output = bench.step(|input| input.base = Some(standing(None)));
    }
    assert_eq!((output.phase, output.fault), (Phase::Done, None));
}

#[test]
fn an_approach_waits_for_the_base_and_gives_up_after_a_second() {
    let mut bench = Bench::new(TASK);
    bench.steps(50);
    let spoil = |input: &mut ControlInput| input.base = Some(standing(Some(BaseTrouble::Silent)));
    for _ in 0..20 {
        bench.step(spoil);
    }
    let at = bench.tool();
    assert!(bench.speed() < 1e-9, "{}", bench.speed());
    let mut output = bench.step(spoil);
    while output.phase == Phase::Approach {
        assert!((bench.tool() - at).norm() < 1e-4);
        output = bench.step(spoil);
    }
    while output.phase.is_active() {
        output = bench.step(spoil);
    }
    assert_eq!(output.fault, Some(Fault::Base(BaseTrouble::Silent)));
}

#[test]
fn an_estimate_without_a_known_base_is_no_reason_to_leave_it() {
    let mut bench = Bench::sliding(&long());
    for _ in 0..50 {
        let output = bench.step(|input| {
            input.base = Some(standing(Some(BaseTrouble::Unsettled)));
            for estimate in input.estimates.iter_mut().flatten() {
                estimate.estimate.validity = Validity::BaseUnknown;
            }
        });
        assert_eq!((output.estimator, output.phase), (0, Phase::Hold));
    }
}

#[test]
fn a_base_that_is_not_finite_stops_the_arm() {
    let mut bench = Bench::sliding(&long());
    let output = bench.step(|input| {
        let mut base = standing(None);
        base.twist.linear.x = f64::NAN;
        input.base = Some(base);
    });
    assert_eq!(
        (output.phase, output.fault),
        (Phase::Fault, Some(Fault::ArmState))
    );
}

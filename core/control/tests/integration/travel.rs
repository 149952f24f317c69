//! The way in joint space to a task's start pose, and home after it.

use crate::bench::{Bench, TASK};
use nalgebra::Vector3;
use tangent_control::{Clearance, CommandKind, Fault, Phase, Task};
use tangent_mechanics::Joints;
use tangent_sensing::Validity;

/// Where the task starts, and home: above the plane, beside where the bench begins.
const START: [f64; 6] = [0.55, -1.62, 1.68, -1.63, -1.57, 0.2];
const HOME: [f64; 6] = [0.3, -1.7, 1.6, -1.5, -1.57, 0.0];

fn task(more: &str) -> String {
    format!("{TASK}\n[start]\njoints_rad = {START:?}\n{more}")
}

fn away(bench: &Bench, from: [f64; 6]) -> f64 {
    (bench.q - Joints::from(from)).amax()
}

/// The phases until the task ends.
fn phases(bench: &mut Bench) -> Vec<Phase> {
    let mut seen = Vec::new();
    loop {
        let phase = bench.step(|_| {}).phase;
        if seen.last() != Some(&phase) {
            seen.push(phase);
        }
        if !phase.is_active() {
            return seen;
        }
        assert!(bench.time_s < 120.0, "{seen:?}");
    }
}

#[test]
fn a_task_starts_from_its_start_pose_and_goes_home() {
    use Phase::{Approach, Contact, Done, Hold, Retract, Slide, Travel};
    for dt_s in [0.008, 0.002] {
        let mut bench = Bench::at_rate(&task(&format!("[home]\njoints_rad = {HOME:?}")), dt_s);
        let mut fastest: f64 = 0.0;
        while bench.step(|_| {}).phase == Phase::Travel {
            let output = bench.last.as_ref().unwrap();
            assert_eq!(output.kind, CommandKind::JointVelocity);
            fastest = fastest.max(output.qd.amax());
            assert!(output.twist_commanded.linear.norm() <= 0.105);
        }
        assert!((0.05..=0.2 + 1e-9).contains(&fastest), "{fastest}");
        assert!(away(&bench, START) < 3e-3, "{}", away(&bench, START));
        let start = bench.tool();
        let seen = phases(&mut bench);
        assert_eq!(
            seen,
            [Approach, Contact, Slide, Hold, Retract, Travel, Done]
        );
        assert!(away(&bench, HOME) < 3e-3, "{}", away(&bench, HOME));
        // The path began below the start pose.
        assert!((start - bench.tool()).norm() > 0.02);
    }
}

#[test]
fn an_arm_that_stands_in_its_start_pose_does_not_travel() {
    let at = Bench::new(TASK).q;
    let text = format!("{TASK}\n[start]\njoints_rad = {:?}", at.as_slice());
    let mut bench = Bench::new(&text);
    assert_eq!(bench.step(|_| {}).phase, Phase::Approach);
}

#[test]
fn a_stop_on_the_way_leaves_the_arm_there_and_a_new_start_arrives() {
    let text = task("");
    let mut bench = Bench::new(&text);
    for _ in 0..100 {
        assert_eq!(bench.step(|_| {}).phase, Phase::Travel);
    }
    bench.controller.stop();
    let output = bench.step(|_| {});
    assert_eq!((output.phase, output.fault), (Phase::Done, None));
    bench.steps(100);
    assert_eq!(bench.last.as_ref().unwrap().kind, CommandKind::Hold);
    assert!(away(&bench, START) > 0.05);
    bench
        .controller
        .start_task(&text.parse::<Task>().unwrap())
        .unwrap();
    assert_eq!(bench.step(|_| {}).phase, Phase::Travel);
    bench.run_until(Phase::Approach);
    assert!(away(&bench, START) < 3e-3);
}

#[test]
fn a_pause_and_a_missing_wrench_stand_still_and_the_way_continues() {
    let mut bench = Bench::new(&task(""));
    bench.steps(100);
    bench.controller.pause().unwrap();
    bench.steps(100);
    assert_eq!(bench.speed(), 0.0);
    // Longer than an arm without progress is waited for.
    bench.steps(600);
    bench.controller.resume().unwrap();
    bench.steps(50);
    assert!(bench.speed() > 0.005);
    for _ in 0..8 {
        bench.step(|input| input.wrench_age_s = 0.05);
    }
    assert_eq!(bench.last.as_ref().unwrap().phase, Phase::Travel);
    bench.run_until(Phase::Done);

    let mut bench = Bench::new(&task(""));
    bench.steps(100);
    let mut steps = 0;
    while bench
        .step(|input| input.wrench_validity = Validity::Missing)
        .phase
        .is_active()
    {
        steps += 1;
        assert!(steps < 200);
    }
    let output = bench.last.as_ref().unwrap();
    assert_eq!(output.fault, Some(Fault::Wrench(Validity::Missing)));
}

#[test]
fn a_touch_on_the_way_stops_the_arm_and_the_next_start_asks_a_person() {
    let text = task("");
    let mut bench = Bench::new(&text);
    // An untared sensor shows any force; only a change counts.
    for _ in 0..100 {
        let output = bench.step(|input| input.wrench.force = Vector3::new(25.0, -4.0, 9.0));
        assert_eq!(output.phase, Phase::Travel);
    }
    let speed = bench.last.as_ref().unwrap().qd.amax();
    let mut way_m = 0.0;
    for cycle in 0..200 {
        let before = bench.tool();
        let output = bench.step(|input| input.wrench.force = Vector3::new(25.0, 2.0, 9.0));
        way_m += (bench.tool() - before).norm();
        if cycle >= 2 {
            assert_eq!(output.fault, Some(Fault::TravelTouched));
            // It gives way for a millimetre, which changes nothing here.
            assert!(matches!(output.phase, Phase::Retract | Phase::Fault));
        }
    }
    assert_eq!(bench.last.as_ref().unwrap().phase, Phase::Fault);
    assert!(speed > 0.05 && bench.last.as_ref().unwrap().qd.amax() == 0.0);
    assert!(way_m < 0.01, "{way_m}");
    assert_eq!(bench.controller.clearance(), Clearance::Unknown);
    let error = bench
        .controller
        .start_task(&text.parse::<Task>().unwrap())
        .unwrap_err();
    assert!(error.to_string().contains("--clear"), "{error}");
}

#[test]
fn an_arm_that_does_not_get_there_is_a_fault() {
    let mut bench = Bench::new(&task(""));
    let stuck = bench.q;
    let mut steps = 0;
    while bench.step(|input| input.q = stuck).phase.is_active() {
        steps += 1;
        assert!(steps < 1000);
    }
    let output = bench.last.as_ref().unwrap();
    assert_eq!(output.fault, Some(Fault::TravelBlocked));
}

/// A zone in which the speed slider of the robot slows the arm is no reason to give up.
#[test]
fn a_slow_robot_arrives_later() {
    let mut bench = Bench::new(&task(""));
    let mut steps = 0;
    while bench.step(|input| input.speed_scaling = 0.3).phase == Phase::Travel {
        steps += 1;
        assert!(steps < 3000);
    }
    assert!(away(&bench, START) < 3e-3);
}

#[test]
fn a_start_pose_of_another_arm_is_refused_by_name() {
    let mut bench = Bench::new(TASK);
    bench.run_until(Phase::Done);
    let text = format!("{TASK}\n[start]\njoints_rad = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]");
    let error = bench
        .controller
        .start_task(&text.parse::<Task>().unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("start.joints_rad") && error.contains("7 numbers"),
        "{error}"
    );
}

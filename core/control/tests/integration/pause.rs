//! A pause stops the hybrid admittance in every phase, beyond all time limits, and the task resumes
//! from there.

// A whole file of tests: what fails here is the test.
use crate::bench::{Bench, TASK};
use tangent_control::{ControlInput, Fault, Phase};
use tangent_sensing::Validity;

/// Time in which the tool comes to rest, and for which it is observed afterwards, s.
const RAMP_S: f64 = 0.6;
const WATCH_S: f64 = 20.0;
/// Maximum motion of a tool at rest within `WATCH_S`, m.
const STILL_M: f64 = 2e-4;

/// Short time limits: none of them may run while the task is paused.
fn task() -> String {
    let limits = "timeouts.tare_s = 3.0\n    timeouts.contact_s = 3.0\n    timeouts.task_s = 18.0\n    end.hold_s = 0.5";
    TASK.replace(
        "force.reference_n",
        &format!("{limits}\n    force.reference_n"),
    )
}

/// Pauses for longer than any limit and checks the tool's true motion; `input` as in `Bench::step`.
fn stands(bench: &mut Bench, phase: Phase, input: impl Fn(&mut ControlInput) + Copy) {
    bench.controller.pause().unwrap();
    let cycles = |s: f64| (s / 0.008) as usize;
    for _ in 0..cycles(RAMP_S) {
        bench.step(input);
    }
    let at = bench.tool();
    for i in 0..cycles(WATCH_S) {
        let output = bench.step(input);
        let way = (bench.tool() - at).norm();
        assert!(way < STILL_M, "{phase:?}, cycle {i}: {way} m");
        assert_eq!((output.phase, output.fault), (phase, None), "cycle {i}");
    }
    bench.controller.resume().unwrap();
}

#[test]
fn before_the_approach() {
    let mut bench = Bench::new(&task().replace("tare = false", "tare = true"));
    bench.step(|_| {});
    // Whether tared meanwhile or not, the arm stays where it is.
    stands(&mut bench, Phase::Tare, |_| {});
    let tared = |input: &mut ControlInput| input.bias_age_s = Some(0.0);
    stands(&mut bench, Phase::Tare, tared);
    let mut output = bench.step(tared);
    assert_eq!(output.phase, Phase::Approach);
    // The zero stays the same for the rest of the task.
    while output.phase.is_active() {
        output = bench.step(tared);
    }
    assert_eq!((output.phase, output.fault), (Phase::Done, None));
}

#[test]
fn in_the_approach() {
    let mut bench = Bench::new(&task());
    bench.steps(20);
    stands(&mut bench, Phase::Approach, |_| {});
    assert!(bench.tool().z > bench.plane_m);
    bench.run_until(Phase::Done);
}

#[test]
fn after_the_touch_and_on_the_path() {
    for phase in [Phase::Contact, Phase::Slide] {
        let mut bench = Bench::new(&task());
        bench.run_until(phase);
        let held = if phase == Phase::Slide {
            Phase::Hold
        } else {
            phase
        };
        bench.controller.pause().unwrap();
        // The force settles first.
        bench.steps(200);
        stands(&mut bench, held, |_| {});
        bench.run_until(Phase::Done);
    }
}

#[test]
fn while_seeking_the_surface() {
    let mut bench = Bench::sliding(&task());
    bench.plane_m -= 0.004;
    bench.run_until(Phase::Seek);
    bench.steps(5);
    stands(&mut bench, Phase::Seek, |_| {});
    assert!(bench.tool().z > bench.plane_m);
    bench.run_until(Phase::Slide);
    bench.run_until(Phase::Done);
}

#[test]
fn a_surface_that_is_lost_in_a_pause_is_not_sought() {
    let mut bench = Bench::sliding(&task());
    bench.controller.pause().unwrap();
    bench.steps(200);
    bench.plane_m -= 0.004;
    stands(&mut bench, Phase::Seek, |_| {});
    bench.run_until(Phase::Slide);
}

#[test]
fn at_the_end_of_the_path() {
    let mut bench = Bench::sliding(&task());
    bench.run_until(Phase::Hold);
    stands(&mut bench, Phase::Hold, |_| {});
    bench.run_until(Phase::Done);
}

/// A protective stop ends the task without a motion; once the arm is ready again, a stop request
/// retracts the tool.
#[test]
fn a_tool_that_a_fault_left_on_the_surface_is_retracted() {
    let mut bench = Bench::sliding(&task());
    bench.steps(50);
    bench.step(|input| input.arm_ready = false);
    for _ in 0..100 {
        let output = bench.step(|input| input.arm_ready = false);
        assert_eq!(output.phase, Phase::Fault);
    }
    let (pressing, activation) = (bench.tool().z, bench.controller.activation());
    assert!(pressing < bench.plane_m);
    assert!(bench.controller.is_left_on_surface());
    bench.controller.leave_surface(activation + 3);
    assert_eq!(bench.controller.activation(), activation + 4);
    assert_eq!(bench.step(|_| {}).phase, Phase::Retract);
    bench.run_until(Phase::Fault);
    bench.steps(50);
    let end_m = bench.controller.task().unwrap().end.retract_distance_m;
    let way = bench.tool().z - pressing;
    // The tool comes to rest slightly further on.
    assert!((0.9 * end_m..end_m + 0.01).contains(&way), "{way} m");
    // Only once: afterwards the tool is off the surface.
    assert!(!bench.controller.is_left_on_surface());
    bench.controller.leave_surface(0);
    bench.steps(100);
    assert!((bench.tool().z - pressing - way).abs() < 1e-6);
}

/// While the tool moves off before a tare, a late wrench makes it wait at rest; only a wrench that
/// stays missing ends the task.
#[test]
fn a_late_wrench_while_moving_off_is_waited_for() {
    let pressed = || {
        let mut bench = Bench::sliding(&task());
        bench.steps(50);
        bench.step(|input| input.arm_ready = false);
        assert_eq!(bench.step(|_| {}).phase, Phase::Fault);
        let again = task().parse::<tangent_control::Task>().unwrap();
        bench.controller.start_task(&again).unwrap();
        assert_eq!(bench.step(|_| {}).phase, Phase::Clear);
        bench
    };
    let silent = |cycle: usize| {
        move |input: &mut ControlInput| input.wrench_age_s = 0.008 * cycle as f64 + 0.004
    };
    let mut bench = pressed();
    bench.steps(5);
    // 50 ms, as a host that stalls may cause.
    for cycle in 0..7 {
        let output = bench.step(silent(cycle));
        assert_eq!(
            (output.phase, output.fault),
            (Phase::Clear, None),
            "{cycle}"
        );
        if cycle >= 4 {
            let speed = output.twist_commanded.linear.norm();
            assert!(speed < 1e-3, "{cycle}: {speed} m/s");
        }
    }
    bench.run_until(Phase::Slide);
    let mut bench = pressed();
    let mut output = bench.step(|_| {});
    for cycle in 0..60 {
        output = bench.step(silent(cycle));
    }
    assert_eq!(output.fault, Some(Fault::Wrench(Validity::Stale)));
}

/// A sensor that fails while the tool approaches: nothing was touched, so the tool goes back to
/// where it was tared and no further. The task can be started from there again and again.
#[test]
fn a_fault_in_the_approach_does_not_march_the_tool_away() {
    let mut bench = Bench::new(&task().replace("tare = false", "tare = true"));
    let tared = |input: &mut ControlInput| input.bias_age_s = Some(0.0);
    let start_m = bench.tool().z;
    let again = task().replace("tare = false", "tare = true");
    for _ in 0..4 {
        while bench.step(tared).phase != Phase::Approach {}
        while bench.tool().z > start_m - 4e-3 {
            assert_eq!(bench.step(tared).phase, Phase::Approach);
        }
        let silent = |input: &mut ControlInput| {
            tared(input);
            input.wrench_age_s = 1.0;
        };
        let mut output = bench.step(silent);
        for _ in 0..2500 {
            output = bench.step(silent);
        }
        assert_eq!(output.phase, Phase::Fault);
        let off_m = bench.tool().z - start_m;
        assert!(off_m.abs() < 2e-3, "{off_m} m");
        bench
            .controller
            .start_task(&again.parse().unwrap())
            .unwrap();
    }
}

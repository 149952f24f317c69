//! The Franka with its depth camera as processes: failures while it wipes the wave, and the arm's
//! reaction.

use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE, seconds};
use crate::common::{stderr, wait_for};
use crate::failures::shown_is_true;
use tangent_live::live_in_half;

/// Time that a loaded machine may add to any time measured here, s.
const SLACK_S: f64 = 1.5;
/// Largest force during any fault, N: twice the reference of 15 N.
const FORCE_MAX_N: f64 = 30.0;

const SERVICES: [&str; 3] = ["router simulator franka controller", "camera", "estimator"];

/// The hard loop in a process that can die alone.
const APART: [&str; 5] = [
    "router",
    "simulator",
    "franka controller",
    "camera",
    "estimator",
];
const LOOP: &str = "franka controller";

/// A cell whose tool slides on the wave, for twenty seconds.
fn sliding(names: &[&str]) -> (Cell, Observer) {
    sliding_for(20.0, names)
}

/// A cell whose tool slides on the wave for this time, s.
fn sliding_for(duration_s: f64, names: &[&str]) -> (Cell, Observer) {
    let mut cell = Cell::with_franka();
    cell.start_all(names);
    let observer = Observer::join(&cell);
    observer.slide(&cell, &cell.loops_task(duration_s));
    (cell, observer)
}

fn safe(observer: &Observer, since_ns: i64) {
    observer.pressed_at_most(FORCE_MAX_N, since_ns);
}

/// After a fault a task starts as usual: its force is shown correctly, and it leaves the surface
/// when it is stopped.
fn wipes_again(cell: &Cell, observer: &Observer) {
    let from = now_ns();
    observer.slide(cell, &cell.loops_task(20.0));
    let slides = now_ns();
    wait_for("three seconds of sliding", PATIENCE, || {
        let last = observer.truths(slides).last()?.at_ns;
        (last - slides > 3_000_000_000).then_some(())
    });
    shown_is_true(observer, slides);
    let stopped = now_ns();
    cell.cli_json(&["task", "stop"], 0);
    let done = observer.phase("done", stopped).at_ns;
    let last = wait_for("the truth after it", PATIENCE, || {
        observer.truths(done).pop()
    });
    assert!(!last.message.in_contact, "it has not left the surface");
    safe(observer, from);
}

/// The loop's last answers are lost: the arm stops in a reflex and presses on the wave. The next
/// loop moves off before it tares.
#[test]
fn a_hard_loop_of_the_franka_killed_while_pressing_starts_again() {
    live_in_half(|| {
        let (mut cell, observer) = sliding(&APART);
        for _ in 0..2 {
            let killed = now_ns();
            cell.process(LOOP).kill();
            observer.at_rest(killed);
            safe(&observer, killed);
            cell.start(LOOP);
            wipes_again(&cell, &observer);
            // Again, from a task that slides.
            observer.slide(&cell, &cell.loops_task(20.0));
        }
    });
}

/// The bug: the bridge that started after the crash had no state of the task, and the force with
/// which the arm pressed on the wave became its zero.
#[test]
fn a_restarted_franka_bridge_refuses_a_tare_while_the_tool_presses() {
    live_in_half(|| {
        let (mut cell, observer) = sliding(&APART);
        let killed = now_ns();
        cell.process(LOOP).kill();
        observer.at_rest(killed);
        cell.start("franka");
        let refused = wait_for("the bridge answers", PATIENCE, || {
            let output = cell.cli(&["tare"]);
            let said = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
            assert!(!output.status.success(), "{said}");
            said.contains("not tared").then_some(said)
        });
        assert!(
            refused.contains("the controller publishes nothing"),
            "{refused}"
        );
        let asked = now_ns();
        let truth = wait_for("the truth", PATIENCE, || observer.truths(asked).pop());
        assert!(
            truth.message.in_contact,
            "it leans on nothing: nothing was tested"
        );
    });
}

/// The robot ends a motion without answers by a reflex. When the loop continues, nothing moves by
/// itself. An operator unlocks the robot, and the next task moves off before it tares.
#[test]
fn a_hard_loop_of_the_franka_that_hangs() {
    live_in_half(|| {
        let (mut cell, observer) = sliding(&APART);
        let stopped = now_ns();
        cell.process(LOOP).signal("STOP");
        observer.at_rest(stopped);
        cell.process(LOOP).signal("CONT");
        observer.phase("fault", stopped);
        observer.stays_slower_than(0.01, 1.0);
        safe(&observer, stopped);
        wait_for("the robot is unlocked", PATIENCE, || {
            let output = cell.cli(&["robot", "unlock"]);
            eprintln!("{}", String::from_utf8_lossy(&output.stdout).trim());
            output.status.success().then_some(())
        });
        observer.stays_slower_than(0.01, 1.0);
        wipes_again(&cell, &observer);
        cell.assert_running(&APART);
    });
}

/// The hard loop has what it needs in its own process; only the estimates pass the router. Without
/// them for two seconds, the tool leaves.
#[test]
fn the_router_of_the_franka_dies() {
    live_in_half(|| {
        let names = [
            "router",
            "simulator",
            "franka controller",
            "camera estimator",
        ];
        let (mut cell, observer) = sliding(&names);
        let killed = now_ns();
        cell.process("router").kill();
        std::thread::sleep(std::time::Duration::from_secs(4));
        cell.start("router");
        let back = now_ns();
        let last = wait_for("the controller is heard again", PATIENCE, || {
            observer.controls(back).pop()
        });
        assert_eq!(last.message.phase_text.as_str(), "fault", "{last:?}");
        assert!(
            last.message.fault.contains("estimate"),
            "{}",
            last.message.fault
        );
        observer.at_rest(back);
        safe(&observer, killed);
        wipes_again(&cell, &observer);
        cell.assert_running(&names);
    });
}

/// Touch alone is sufficient if the camera fails.
#[test]
fn the_depth_camera_dies_and_touch_goes_on() {
    live_in_half(|| {
        // Long enough for the rest of the test, which waits for the end of the task.
        let (mut cell, observer) = sliding_for(12.0, &SERVICES);
        let killed = now_ns();
        cell.process("camera").kill();
        wait_for("it wipes on without a camera", PATIENCE, || {
            let controls = observer.controls(killed);
            let last = controls.last()?;
            assert!(last.message.fault.is_empty(), "{}", last.message.fault);
            (seconds(last.at_ns - killed) > 4.0 && last.message.phase_text.as_str() == "slide")
                .then_some(())
        });
        safe(&observer, killed);
        cell.start("camera");
        observer.phase("done", killed);
        safe(&observer, killed);
    });
}

/// Without any normal the policy stops, the force is kept, and after a second the tool leaves the
/// surface.
#[test]
fn the_estimator_of_the_franka_dies() {
    live_in_half(|| {
        let (mut cell, observer) = sliding(&SERVICES);
        let killed = now_ns();
        cell.process("estimator").kill();
        let fault = observer.phase("fault", killed);
        assert!(seconds(fault.at_ns - killed) < 4.0 + SLACK_S);
        assert!(
            fault.message.fault.contains("estimate"),
            "{}",
            fault.message.fault
        );
        observer.at_rest(killed);
        safe(&observer, killed);
        cell.start("estimator");
        wipes_again(&cell, &observer);
    });
}

/// The robot's user stop ends the task; nothing moves by itself when it is released.
#[test]
fn the_user_stop_of_the_franka_is_pressed() {
    live_in_half(|| {
        let (cell, observer) = sliding(&SERVICES);
        let stopped = now_ns();
        cell.provoke("user_stop", "on");
        observer.phase("fault", stopped);
        observer.at_rest(stopped);
        cell.provoke("user_stop", "off");
        // The arm is held with a low stiffness, so it still creeps while it presses on the wave.
        observer.stays_slower_than(0.01, 1.0);
        safe(&observer, stopped);
        wipes_again(&cell, &observer);
    });
}

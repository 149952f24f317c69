//! The torque-controlled arm with its camera as processes: failures while it wipes the object, and
//! the arm's reaction.

use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE, seconds};
use crate::common::wait_for;
use tangent_live::live;

/// Time that a loaded machine may add to any time measured here, s.
const SLACK_S: f64 = 1.5;
/// Largest force during any fault, N: twice the reference of 20 N.
const FORCE_MAX_N: f64 = 40.0;

const TOGETHER: [&str; 1] = ["router simulator controller netft camera estimator"];

/// A cell whose tool slides on the object for many turns. Only the failing service has its own
/// process: a thousand cycles a second between more processes would overload a small machine.
fn sliding(names: &[&str]) -> (Cell, Observer) {
    let mut cell = Cell::with_object();
    cell.start_all(names);
    let observer = Observer::join(&cell);
    observer.slide(&cell, &cell.object_task(20));
    (cell, observer)
}

fn safe(observer: &Observer, since_ns: i64) {
    observer.pressed_at_most(FORCE_MAX_N, since_ns);
}

/// Sliding stops, the force is kept along the last normal, and after a second without an estimate
/// the tool leaves.
#[test]
fn the_objects_estimator_dies() {
    live(|| {
        let (mut cell, observer) =
            sliding(&["router simulator controller netft camera", "estimator"]);
        let killed = now_ns();
        cell.process("estimator").kill();
        let hold = observer.phase("hold", killed);
        assert!(seconds(hold.at_ns - killed) < 0.4 + SLACK_S);
        let fault = observer.phase("fault", killed);
        assert!(
            fault.message.fault.contains("estimate"),
            "{}",
            fault.message.fault
        );
        observer.at_rest(killed);
        safe(&observer, killed);
        // It restarts as another process, and the next task runs.
        cell.start("estimator");
        observer.slide(&cell, &cell.object_task(1));
        cell.assert_running(&["router simulator controller netft camera"]);
    });
}

/// Sliding stops and the force is kept. If the camera returns at once, the task continues; if not,
/// the task ends.
#[test]
fn the_camera_stops() {
    live(|| {
        let (mut cell, observer) =
            sliding(&["router simulator controller netft estimator", "camera"]);
        let off = now_ns();
        cell.provoke("camera", "off");
        let hold = observer.phase("hold", off);
        assert!(seconds(hold.at_ns - off) < 0.7 + SLACK_S);
        cell.provoke("camera", "on");
        let from = now_ns();
        observer.sliding(from);
        safe(&observer, off);

        let killed = now_ns();
        cell.process("camera").kill();
        let fault = observer.phase("fault", killed);
        assert!(
            fault.message.fault.contains("estimate"),
            "{}",
            fault.message.fault
        );
        observer.at_rest(killed);
        safe(&observer, killed);
        cell.start("camera");
        observer.slide(&cell, &cell.object_task(1));
    });
}

/// Without a wrench the arm stops within cycles, and leaves the surface if the wrench stays silent.
#[test]
fn the_force_sensor_falls_silent() {
    live(|| {
        let (mut cell, observer) =
            sliding(&["router simulator controller camera estimator", "netft"]);
        let killed = now_ns();
        cell.process("netft").kill();
        let fault = observer.phase("fault", killed);
        assert!(
            fault.message.fault.contains("wrench"),
            "{}",
            fault.message.fault
        );
        observer.at_rest(killed);
        safe(&observer, killed);
    });
}

/// The emergency stop ends the task at once; nothing moves by itself when it is released.
#[test]
fn the_emergency_stop_is_pressed() {
    live(|| {
        let (cell, observer) = sliding(&TOGETHER);
        let pressed = now_ns();
        cell.provoke("emergency_stop", "on");
        let fault = observer.phase("fault", pressed);
        assert!(seconds(fault.at_ns - pressed) < 3.0 + SLACK_S);
        observer.at_rest(pressed);
        safe(&observer, pressed);
        cell.provoke("emergency_stop", "off");
        observer.stays_at_rest(1.0);
    });
}

/// While the tool presses, a task can be paused, continues where it stopped, and can switch to
/// another estimator of its list.
#[test]
fn a_person_pauses_resumes_and_stops() {
    live(|| {
        let (cell, observer) = sliding(&TOGETHER);
        let from = now_ns();
        cell.cli_json(&["task", "pause"], 0);
        observer.phase("hold", from);
        observer.at_rest(from);
        let from = now_ns();
        cell.cli_json(&["task", "resume"], 0);
        observer.sliding(from);
        let from = now_ns();
        cell.cli_json(&["param", "set", "controller/force_reference_n", "12"], 0);
        wait_for("the force follows", PATIENCE, || {
            let controls = observer.controls(from);
            let last = &controls.last()?.message;
            ((last.force_reference_n - 12.0).abs() < 1e-9 && (last.force_n - 12.0).abs() < 2.0)
                .then_some(())
        });
        let from = now_ns();
        cell.cli_json(&["task", "stop"], 0);
        observer.phase("done", from);
        safe(&observer, from);
    });
}

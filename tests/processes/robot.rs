//! The robot's modes from the command line, as in the documentation for operators: after a
//! protective stop and a power cycle, a task runs again.

use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::{json, stderr, wait_for};
use tangent_live::{live_beside_others, live_in_half};

const COMPOSED: [&str; 2] = ["router simulator netft estimator", "rtde controller"];
/// RTDE `safety_mode` of a protective stop.
const PROTECTIVE_STOP: i32 = 3;

fn cell() -> (Cell, Observer) {
    let mut cell = Cell::new(|_| {});
    cell.start_all(&COMPOSED);
    let observer = Observer::join(&cell);
    (cell, observer)
}

/// A short task. `tare`: the sensor has no zero yet; without it, the tool may stand on the surface.
fn short(cell: &Cell, tare: bool) -> std::path::PathBuf {
    cell.task(
        tare,
        "kind = \"line\"\nto_m = [0.02, 0.0]\nspeed_m_per_s = 0.02",
    )
}

#[test]
fn a_protective_stop_is_unlocked_and_a_task_starts() {
    live_beside_others(|| {
        let (cell, observer) = cell();
        observer.slide(&cell, &cell.long_task());
        // Requests that would take the arm from the task are refused, and the task continues.
        for action in ["power-off", "reset", "unlock"] {
            let refused = cell.cli_json(&["robot", action], 1);
            assert_eq!(refused["done"], false, "{action}: {refused}");
            let why = if action == "unlock" {
                "no protective stop"
            } else {
                "tangent task stop"
            };
            assert!(
                refused["message"].as_str().unwrap().contains(why),
                "{refused}"
            );
        }
        observer.sliding(now_ns());

        let stopped = now_ns();
        cell.provoke("protective_stop", "");
        observer.phase("fault", stopped);
        let rest = observer.at_rest(stopped);
        let status = cell.cli_json(&["robot", "status"], 0);
        assert_eq!(status["data"]["safety_mode"], PROTECTIVE_STOP, "{status}");
        assert_eq!(status["data"]["ready"], false);
        assert_eq!(status["data"]["dashboard"]["robot_mode"], "RUNNING");
        // The robot refuses in the first five seconds, in its own words, which reach the operator.
        let unlocked = wait_for("the stop is unlocked", PATIENCE, || {
            let output = cell.cli(&["robot", "unlock", "--json"]);
            let said = json(&output);
            if output.status.code() == Some(0) {
                return Some(said);
            }
            let message = said["message"].as_str().unwrap();
            assert!(message.contains("until 5s after occurrence"), "{said}");
            None
        });
        assert_eq!(unlocked["robot"], "Protective stop releasing");
        assert!(observer.arm().unwrap().ready);
        // Nothing moves by itself.
        observer.stays_at_rest(0.5);
        assert!(rest > stopped);

        observer.wipe(&cell, &short(&cell, false));
    });
}

#[test]
fn power_goes_off_and_on_and_a_task_starts() {
    live_beside_others(|| {
        let (cell, observer) = cell();
        wait_for("the arm is ready", PATIENCE, || {
            observer.arm().filter(|arm| arm.ready)
        });
        let off = cell.cli_json(&["robot", "power-off"], 0);
        assert_eq!(off["robot"], "Powering off");
        assert!(
            off["message"].as_str().unwrap().contains("powered off"),
            "{off}"
        );
        let task = short(&cell, true);
        let refused = cell.cli_json(&["task", "start", task.to_str().unwrap()], 1);
        assert!(
            refused["message"].as_str().unwrap().contains("powered off"),
            "{refused}"
        );
        let on = cell.cli_json(&["robot", "power-on"], 0);
        assert!(
            on["robot"].as_str().unwrap().contains("Powering on"),
            "{on}"
        );
        assert!(observer.arm().unwrap().ready);
        let again = cell.cli_json(&["robot", "power-on"], 0);
        assert!(
            again["robot"].as_str().unwrap().contains("already"),
            "{again}"
        );
        let reset = cell.cli_json(&["robot", "reset"], 0);
        assert_eq!(reset["done"], true, "{reset}");

        observer.wipe(&cell, &task);
    });
}

/// A Franka has a reflex where a UR has a protective stop, and no command for its brakes.
#[test]
fn a_franka_reports_what_its_interface_does_not_support() {
    live_in_half(|| {
        let mut cell = Cell::with_franka();
        cell.start_all(&["router", "simulator franka controller"]);
        let observer = Observer::join(&cell);
        wait_for("the Franka is ready", PATIENCE, || {
            observer.arm().filter(|arm| arm.ready)
        });
        let status = cell.cli_json(&["robot", "status"], 0);
        assert_eq!(status["data"]["ready"], true, "{status}");
        let refused = cell.cli_json(&["robot", "unlock"], 1);
        assert!(
            refused["message"].as_str().unwrap().contains("no reflex"),
            "{refused}"
        );
        for action in ["power-on", "power-off"] {
            let refused = cell.cli_json(&["robot", action], 1);
            assert!(
                refused["message"].as_str().unwrap().contains("Desk"),
                "{refused}"
            );
        }
        // It is guided with its own buttons; its poses can be taken.
        let taught = cell.cli(&["teach", "shown"]);
        assert_eq!(taught.status.code(), Some(1));
        let said = stderr(&taught);
        for words in [
            "hold both buttons",
            "Enter: point",
            "input ended before `d`",
        ] {
            assert!(said.contains(words), "{words}: {said}");
        }
    });
}

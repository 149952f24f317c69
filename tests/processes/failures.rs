//! Processes that die, hang and come back while the tool slides. The motion of the arm is read from
//! the simulated truth.
//!
//! The bounds are those of the failure table plus the time that a machine which also builds may
//! add.

use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE, Seen, seconds};
use crate::common::{json, wait_for};
use tangent_live::live_beside_others;
use tangent_schemas::tangent::ControlState;

/// Time that a loaded machine may add to any time measured here, s.
const SLACK_S: f64 = 1.5;
/// Largest force during any fault, N: the larger of twice the reference and 10 N.
pub const FORCE_MAX_N: f64 = 10.0;

/// One process per service. Other tests put the service that fails into its own process and the
/// rest into another, so that a small machine is not kept busy with messages between processes.
pub const APART: [&str; 6] = [
    "router",
    "simulator",
    "netft",
    "rtde",
    "controller",
    "estimator",
];
const HARD_LOOP: [&str; 2] = ["router simulator netft estimator", "rtde controller"];
const SENSOR: [&str; 2] = ["router simulator rtde controller estimator", "netft"];
const ESTIMATOR: [&str; 2] = ["router simulator netft rtde controller", "estimator"];
const CONTROLLER: [&str; 2] = ["router simulator netft rtde estimator", "controller"];
const BRIDGE: [&str; 2] = ["router simulator netft controller estimator", "rtde"];

/// A cell whose tool slides, with one process for each of `names`.
pub fn sliding(names: &[&str]) -> (Cell, Observer) {
    let mut cell = Cell::new(|_| {});
    cell.start_all(names);
    let observer = Observer::join(&cell);
    observer.slide(&cell, &cell.long_task());
    (cell, observer)
}

/// Runs a new task with sliding to its end, and checks that the processes in `names` still run.
fn wipes_again(cell: &mut Cell, observer: &Observer, names: &[&str]) {
    // If the tool is still on the surface, it moves off before the tare.
    let task = cell.task(
        true,
        "kind = \"line\"\nto_m = [0.02, 0.0]\nspeed_m_per_s = 0.02",
    );
    observer.wipe(cell, &task);
    cell.assert_running(names);
}

fn fault(observer: &Observer, since_ns: i64) -> Seen<ControlState> {
    let seen = observer.phase("fault", since_ns);
    assert!(!seen.message.fault.is_empty());
    seen
}

/// Checks that the mean force shown by the controller while it slides is that of the simulator,
/// since `since_ns`.
pub fn shown_is_true(observer: &Observer, since_ns: i64) {
    let slides: Vec<f64> = observer
        .controls(since_ns)
        .iter()
        .filter(|seen| seen.message.phase_text.as_str() == "slide")
        .map(|seen| seen.message.force_n)
        .collect();
    let pressed: Vec<f64> = observer
        .truths(since_ns)
        .iter()
        .filter(|seen| seen.message.in_contact)
        .map(|seen| {
            let (f, n) = (&seen.message.wrench.force, &seen.message.normal);
            f.x * n.x + f.y * n.y + f.z * n.z
        })
        .collect();
    let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len() as f64;
    let (shown, truth) = (mean(&slides), mean(&pressed));
    assert!(
        (shown - truth).abs() <= 0.5,
        "shown {shown} N, true {truth} N"
    );
}

/// The new controller has only the state that the previous one has stored.
#[test]
fn a_stop_after_the_hard_loop_was_killed_takes_the_tool_off() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&HARD_LOOP);
        let killed = now_ns();
        cell.process("rtde controller").kill();
        observer.at_rest(killed);
        assert!(observer.truths(killed).last().unwrap().message.in_contact);
        cell.start("rtde controller");
        let since = now_ns();
        // Refused until the arm takes commands again.
        let stopped = wait_for("a stop that is carried out", PATIENCE, || {
            let said = cell.cli(&["task", "stop"]);
            let text = String::from_utf8_lossy(&said.stdout).into_owned();
            said.status.success().then_some(text)
        });
        assert!(stopped.contains("moving off"), "{stopped}");
        let done = observer.phase("done", since).at_ns;
        wait_for("a tool that hangs free", PATIENCE, || {
            let last = observer.truths(done).last()?.message.clone();
            (!last.in_contact).then_some(())
        });
        let peak_n = observer.truths(killed).iter().fold(0.0, |peak: f64, seen| {
            let f = &seen.message.wrench.force;
            peak.max((f.x * f.x + f.y * f.y + f.z * f.z).sqrt())
        });
        assert!(peak_n <= 10.0, "{peak_n} N");
        assert!(
            cell.cli_json(&["task", "stop"], 0)["message"]
                .as_str()
                .unwrap()
                .contains("nothing to do")
        );
    });
}

/// Each kill leaves the tool pressed. A tare there hides the force: 3 N shown were 6 N after the
/// first start, and 9 N after the second.
#[test]
fn a_hard_loop_killed_while_pressing_moves_off_before_it_tares() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&HARD_LOOP);
        for _ in 0..2 {
            let killed = now_ns();
            cell.process("rtde controller").kill();
            observer.at_rest(killed);
            assert!(observer.truths(killed).last().unwrap().message.in_contact);
            // Nothing moves, and the sensor service remembers that the controller pressed.
            let silent = wait_for("the controller's silence", PATIENCE, || {
                let answer = cell.cli_json(&["tare"], 1);
                let said = answer["message"].as_str().unwrap().to_owned();
                said.contains("publishes nothing").then_some(said)
            });
            assert!(silent.contains("may touch"), "{silent}");
            cell.start("rtde controller");
            let from = now_ns();
            observer.slide(&cell, &cell.long_task());
            let clear = observer.phase("clear", from).at_ns;
            let tare = observer.phase("tare", clear).at_ns;
            observer.phase("slide", tare);
            let settled = now_ns();
            wait_for("two seconds of sliding", PATIENCE, || {
                let last = observer.truths(settled).last()?.at_ns;
                (last - settled > 2_000_000_000).then_some(())
            });
            // In the middle of a slide it is refused as well, even with `--clear`.
            for args in [vec!["tare"], vec!["tare", "--clear"]] {
                let answer = cell.cli_json(&args, 1);
                let said = answer["message"].as_str().unwrap().to_owned();
                assert!(said.contains("phase"), "{said}");
            }
            shown_is_true(&observer, settled);
        }
        safe(&observer, 0);
    });
}

fn safe(observer: &Observer, since_ns: i64) {
    observer.pressed_at_most(FORCE_MAX_N, since_ns);
}

/// Sliding stops, and the force is kept along the last normal. After one second without an estimate
/// the tool retracts.
#[test]
fn an_estimator_that_dies() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&ESTIMATOR);
        let killed = now_ns();
        cell.process("estimator").kill();
        let hold = observer.phase("hold", killed);
        assert!(seconds(hold.at_ns - killed) < 0.1 + SLACK_S);
        let retract = observer.phase("retract", hold.at_ns);
        let held = seconds(retract.at_ns - hold.at_ns);
        assert!((0.9..1.0 + SLACK_S).contains(&held), "held for {held} s");
        // In between, the tool stands still and presses.
        let middle: Vec<f64> = observer
            .truths(hold.at_ns + 300_000_000)
            .iter()
            .filter(|t| t.at_ns < retract.at_ns)
            .map(|t| {
                assert!(t.message.sliding_speed_m_per_s < 5e-3);
                t.message.wrench.force.z.hypot(t.message.wrench.force.x)
            })
            .collect();
        let mean = middle.iter().sum::<f64>() / middle.len() as f64;
        assert!((mean - 3.0).abs() < 0.8, "{mean} N while it stands");
        let end = fault(&observer, killed);
        assert!(
            end.message.fault.contains("estimate"),
            "{}",
            end.message.fault
        );
        observer.at_rest(end.at_ns);
        safe(&observer, killed);

        cell.start("estimator");
        observer.stays_at_rest(1.0);
        wipes_again(&mut cell, &observer, &ESTIMATOR);
    });
}

/// An estimator that returns within one second is used again without a request.
#[test]
fn an_estimator_that_hangs_for_a_moment() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&ESTIMATOR);
        let stopped = now_ns();
        cell.process("estimator").signal("STOP");
        observer.phase("hold", stopped);
        let back = now_ns();
        cell.process("estimator").signal("CONT");
        observer.phase("slide", back);
        observer.sliding(back);
        assert!(
            observer
                .controls(stopped)
                .iter()
                .all(|c| c.message.fault.is_empty())
        );
        safe(&observer, stopped);
        cell.assert_running(&ESTIMATOR);
    });
}

#[test]
fn a_sensor_service_that_dies() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&SENSOR);
        let killed = now_ns();
        cell.process("netft").kill();
        let retract = observer.phase("retract", killed);
        assert!(seconds(retract.at_ns - killed) < 0.15 + SLACK_S);
        let end = fault(&observer, killed);
        assert!(
            end.message.fault.contains("wrench"),
            "{}",
            end.message.fault
        );
        observer.at_rest(end.at_ns);
        assert!(
            !observer
                .truths(end.at_ns)
                .last()
                .unwrap()
                .message
                .in_contact
        );
        safe(&observer, killed);

        cell.start("netft");
        observer.stays_at_rest(1.0);
        // A new process has to tare first.
        observer.slide(&cell, &cell.long_task());
        cell.assert_running(&SENSOR);
    });
}

/// The messages that it had queued arrive late, in a burst, and cause no motion.
#[test]
fn a_sensor_service_that_hangs() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&SENSOR);
        let stopped = now_ns();
        cell.process("netft").signal("STOP");
        let end = fault(&observer, stopped);
        observer.at_rest(end.at_ns);
        cell.process("netft").signal("CONT");
        observer.stays_at_rest(1.5);
        safe(&observer, stopped);
        wipes_again(&mut cell, &observer, &SENSOR);
    });
}

/// The bridge ramps the arm down. A new controller finds the task's activation rejected, and starts
/// nothing.
#[test]
fn a_controller_that_dies() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&CONTROLLER);
        let killed = now_ns();
        cell.process("controller").kill();
        let rest = observer.at_rest(killed);
        assert!(
            seconds(rest - killed) < 0.1 + SLACK_S,
            "{}",
            seconds(rest - killed)
        );
        safe(&observer, killed);

        cell.start("controller");
        observer.stays_at_rest(2.0);
        let arm = observer.arm().unwrap();
        assert!(arm.ready && arm.activation_latched > 0, "{arm:?}");
        wipes_again(&mut cell, &observer, &CONTROLLER);
    });
}

/// When it continues, its old activation is rejected. It reports a fault instead of assuming that
/// it still slides.
#[test]
fn a_controller_that_hangs() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&CONTROLLER);
        let stopped = now_ns();
        cell.process("controller").signal("STOP");
        let rest = observer.at_rest(stopped);
        assert!(seconds(rest - stopped) < 0.1 + SLACK_S);
        let back = now_ns();
        cell.process("controller").signal("CONT");
        observer.stays_at_rest(1.0);
        fault(&observer, back);
        safe(&observer, stopped);
        wipes_again(&mut cell, &observer, &CONTROLLER);
    });
}

/// The program on the robot stops the arm by itself. A new bridge takes over and causes no motion.
#[test]
fn a_bridge_that_dies() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&BRIDGE);
        let killed = now_ns();
        cell.process("rtde").kill();
        let rest = observer.at_rest(killed);
        assert!(
            seconds(rest - killed) < 0.1 + SLACK_S,
            "{}",
            seconds(rest - killed)
        );
        safe(&observer, killed);

        let from = now_ns();
        cell.start("rtde");
        // The controller keeps running, but its task must end.
        fault(&observer, from);
        observer.stays_at_rest(2.0);
        wipes_again(&mut cell, &observer, &BRIDGE);
    });
}

/// Bridge and controller in one process that first hangs and later dies: the arm comes to rest, and
/// a new task is needed.
#[test]
fn a_hard_loop_that_hangs_and_dies() {
    live_beside_others(|| {
        let (mut cell, observer) = sliding(&HARD_LOOP);
        let stopped = now_ns();
        cell.process("rtde controller").signal("STOP");
        let rest = observer.at_rest(stopped);
        assert!(seconds(rest - stopped) < 0.1 + SLACK_S);
        safe(&observer, stopped);
        let back = now_ns();
        cell.process("rtde controller").signal("CONT");
        fault(&observer, back);
        observer.stays_at_rest(1.5);
        wipes_again(&mut cell, &observer, &HARD_LOOP);

        observer.slide(&cell, &cell.long_task());
        let killed = now_ns();
        cell.process("rtde controller").kill();
        let rest = observer.at_rest(killed);
        assert!(seconds(rest - killed) < 0.1 + SLACK_S);
        safe(&observer, killed);
        cell.start("rtde controller");
        observer.stays_at_rest(2.0);
        wipes_again(&mut cell, &observer, &HARD_LOOP);
    });
}

/// While no service receives messages, the arm leaves the surface. Then all services reconnect
/// without a restart.
#[test]
fn a_router_that_is_started_again() {
    live_beside_others(|| {
        let names = [
            "router",
            "simulator recorder",
            "netft",
            "rtde controller",
            "estimator",
        ];
        let (mut cell, observer) = sliding(&names);
        let before = cell.ids();
        let killed = now_ns();
        cell.process("router").kill();
        wait_for("the loop has ended the task", PATIENCE, || {
            cell.log("rtde controller")
                .contains("fault: ")
                .then_some(())
        });
        let restarted = now_ns();
        cell.start("router");
        wait_for("everybody is back", PATIENCE, || {
            let status = json(&cell.cli(&["status", "--json"]));
            let there = |name: &str| {
                let services = status["services"].as_array().unwrap();
                services
                    .iter()
                    .any(|s| s["name"] == name && s["state"] != "silent")
            };
            [
                "netft",
                "rtde",
                "controller",
                "estimator",
                "recorder",
                "simulator",
            ]
            .iter()
            .all(|name| there(name))
            .then_some(())
        });
        let end = fault(&observer, restarted);
        assert!(
            end.message.fault.contains("wrench"),
            "{}",
            end.message.fault
        );
        observer.at_rest(end.at_ns);
        observer.stays_at_rest(1.0);
        wipes_again(&mut cell, &observer, &names);
        let mut after = cell.ids();
        after.insert("router".into(), before["router"]);
        assert_eq!(after, before);

        assert_eq!(
            cell.process("simulator recorder").terminate(PATIENCE),
            Some(0)
        );
        // The truth was recorded in the simulator's process, without a router in between.
        let recording = tangent_recorder::Recording::open(&cell.files()[0]).unwrap();
        let off = recording
            .messages()
            .filter(|m| m.topic == "/truth/contact" && m.publish_time_ns as i64 > killed)
            .map(|m| {
                let truth: tangent_schemas::tangent::ContactTruth =
                    tangent_schemas::cdr::decode(&m.bytes).unwrap();
                let f = &truth.wrench.force;
                let force = (f.x * f.x + f.y * f.y + f.z * f.z).sqrt();
                assert!(force <= FORCE_MAX_N, "{force} N");
                (m.publish_time_ns as i64, truth.in_contact)
            })
            .find(|(_, in_contact)| !in_contact)
            .expect("it came off the surface");
        assert!(
            seconds(off.0 - killed) < 0.5 + SLACK_S,
            "{}",
            seconds(off.0 - killed)
        );
    });
}

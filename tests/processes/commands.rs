//! Every command of a running cell, over the router.

use std::time::Duration;

use serde_json::Value;

use crate::cell::{Cell, Observer, PATIENCE, mcap_files};
use crate::common::{Process, json, number, run, wait_for};
use tangent_live::live_beside_others;

const PROCESSES: [&str; 6] = [
    "router",
    "simulator",
    "netft",
    "rtde controller",
    "estimator",
    "recorder",
];

fn service<'a>(status: &'a Value, name: &str) -> &'a Value {
    status["services"]
        .as_array()
        .unwrap()
        .iter()
        .find(|s| s["name"] == name)
        .unwrap_or_else(|| panic!("no {name} in {status}"))
}

/// A person starts the cell, looks at it, wipes, changes things meanwhile, and reads the recording.
#[test]
fn a_cell_is_run_from_the_command_line() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let observer = Observer::join(&cell);
        let ready = || observer.arm().filter(|arm| arm.ready);
        wait_for("the arm is ready", PATIENCE, ready);

        // Health is published once a second: soon every service has reported its rates.
        let status = wait_for("everybody tells rates", PATIENCE, || {
            let output = cell.cli(&["status", "--json"]);
            let status = json(&output);
            let told = |name: &str, rate: &str| {
                let services = status["services"].as_array().unwrap();
                services
                    .iter()
                    .any(|s| s["name"] == name && s["rates_hz"][rate].as_f64() > Some(50.0))
            };
            [
                ("netft", "wrench/tool"),
                ("rtde", "arm_state"),
                ("controller", "arm_state"),
                ("estimator", "arm_state"),
                ("recorder", "messages"),
                ("simulator", "cycles"),
            ]
            .iter()
            .all(|(name, rate)| told(name, rate))
            .then_some(status)
        });
        let ids = cell.ids();
        for (name, process) in [
            ("netft", "netft"),
            ("rtde", "rtde controller"),
            ("controller", "rtde controller"),
            ("estimator", "estimator"),
            ("recorder", "recorder"),
            ("simulator", "simulator"),
        ] {
            let service = service(&status, name);
            assert_eq!(service["alive"], true, "{service}");
            let instance = service["instance"].as_str().unwrap();
            assert!(
                instance.ends_with(&format!("-{}", ids[process])),
                "{instance}"
            );
        }
        for (name, age) in [
            ("netft", "record"),
            ("rtde", "robot_packet"),
            ("controller", "arm_state"),
        ] {
            let ms = number(&service(&status, name)["ages_ms"], &format!("/{age}"));
            assert!((0.0..1000.0).contains(&ms), "{name}: {age} {ms} ms");
        }

        let tared = cell.cli_json(&["tare"], 0);
        assert_eq!(tared["done"], true, "{tared}");
        // The simulated sensor's zero is some newtons off; the tare must find this offset.
        let bias: Vec<f64> = (0..3)
            .map(|i| number(&tared, &format!("/data/bias/{i}")))
            .collect();
        assert!(bias.iter().any(|b| b.abs() > 0.1), "{bias:?}");

        let task = cell.long_task();
        observer.slide(&cell, &task);
        let again = cell.cli_json(&["task", "start", task.to_str().unwrap()], 1);
        assert!(again["message"].as_str().unwrap().contains("slide"));
        let running = cell.cli_json(&["task", "status"], 0);
        assert_eq!(running["data"]["phase"], "slide", "{running}");
        assert_eq!(running["data"]["task"], "test");

        parameters(&cell, &observer);
        estimators(&cell);

        let before = tangent_runtime::clock::now_ns();
        assert_eq!(cell.cli_json(&["task", "pause"], 0)["done"], true);
        observer.phase("hold", before);
        observer.at_rest(before);
        let before = tangent_runtime::clock::now_ns();
        assert_eq!(cell.cli_json(&["task", "resume"], 0)["done"], true);
        observer.sliding(before);

        // A second recorder, started by a user.
        let own = tempfile::tempdir().unwrap();
        let file = cell.file();
        let mut record = Process::start(
            "record",
            &[
                "record",
                "--folder",
                own.path().to_str().unwrap(),
                "--cell",
                file.to_str().unwrap(),
            ],
        );
        wait_for("it writes", PATIENCE, || {
            let files = mcap_files(own.path());
            let size = files.first()?.metadata().ok()?.len();
            (size > 10_000).then_some(())
        });

        let before = tangent_runtime::clock::now_ns();
        assert_eq!(cell.cli_json(&["task", "stop"], 0)["done"], true);
        observer.phase("done", before);
        record.signal("INT");
        assert_eq!(record.ended(PATIENCE), Some(0));

        let names = PROCESSES;
        cell.assert_running(&names);
        for name in names.iter().rev() {
            let code = cell.process(name).terminate(PATIENCE);
            assert_eq!(code, Some(0), "{name}");
        }
        // The cell's recorder has the whole task; the user's recorder has its end.
        for (path, whole) in [
            (&cell.files()[0], true),
            (&mcap_files(own.path())[0], false),
        ] {
            let output = run(&["report", path.to_str().unwrap(), "--json", "--no-html"]);
            assert!(
                matches!(output.status.code(), Some(0 | 3)),
                "{:?}",
                output.status
            );
            let figures = json(&output);
            assert_eq!(figures["phase"], "done", "{figures}");
            assert_eq!(figures["recording"]["truncated"], false);
            if whole {
                let force = number(&figures, "/force/mean_n");
                assert!((force - 3.0).abs() < 0.5, "{force} N");
                assert_eq!(figures["verdict"], "stopped", "{figures}");
                assert_eq!(figures["pauses"].as_array().unwrap().len(), 1, "{figures}");
            }
        }
    });
}

fn parameters(cell: &Cell, observer: &Observer) {
    let all = cell.cli_json(&["param", "get"], 0);
    let text = all.to_string();
    for name in ["force_reference_n", "filter_cutoff_hz", "wrench_patience_s"] {
        assert!(text.contains(name), "no {name} in {text}");
    }
    let key = "controller/force_reference_n";
    let refused = cell.cli_json(&["param", "set", key, "-4"], 1);
    assert_eq!(refused["done"], false);
    cell.cli_json(&["param", "set", key, "5"], 0);
    let got = cell.cli_json(&["param", "get", key], 0);
    assert_eq!(got["done"], true, "{got}");
    wait_for("5 N are pressed with", PATIENCE, || {
        let now = tangent_runtime::clock::now_ns();
        let lately = observer.controls(now - 300_000_000);
        let mean = lately.iter().map(|c| c.message.force_n).sum::<f64>() / lately.len() as f64;
        ((mean - 5.0).abs() < 0.5).then_some(())
    });
    cell.cli_json(&["param", "set", key, "3"], 0);
    let unknown = cell.cli(&["param", "set", "controller/no_such_thing", "1"]);
    assert_eq!(unknown.status.code(), Some(1));
}

fn estimators(cell: &Cell) {
    let list = wait_for("every estimator at work", PATIENCE, || {
        let list = cell.cli_json(&["estimator", "list"], 0);
        let rows = list["estimators"].as_array()?;
        let working = |name: &&str| {
            rows.iter()
                .any(|r| r["name"] == *name && r["rate_hz"].as_f64() > Some(20.0))
        };
        ["reactive", "quadratic", "gaussian_process", "blend"]
            .iter()
            .all(working)
            .then_some(list)
    });
    assert_eq!(list["active"], "blend", "{list}");
    let used = wait_for("the switch is accepted", PATIENCE, || {
        let answer = json(&cell.cli(&["estimator", "use", "quadratic", "--json"]));
        // The request is refused, with the reason, while the new estimator has no estimate.
        (answer["done"] == true).then_some(answer)
    });
    assert!(used["message"].as_str().unwrap().contains("quadratic"));
    let list = cell.cli_json(&["estimator", "list"], 0);
    assert_eq!(list["active"], "quadratic", "{list}");
    let refused = cell.cli_json(&["estimator", "use", "nobody"], 1);
    assert!(
        refused["message"].as_str().unwrap().contains("nobody"),
        "{refused}"
    );
}

/// Ctrl-C of `up` in the middle of the path: the tool leaves the surface, all services end in
/// order, and there is a report.
#[test]
fn ctrl_c_of_up_retracts_and_reports() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let offset = crate::common::port_offset().to_string();
        let path = folder.path().to_str().unwrap();
        let log = std::fs::File::create(folder.path().join("up.log")).unwrap();
        let mut up = Process::start_with_log(
            "up",
            &["up", "--folder", path, "--port-offset", &offset],
            log,
        );
        let said = || std::fs::read_to_string(folder.path().join("up.log")).unwrap();
        wait_for("it slides", PATIENCE, || {
            assert_eq!(up.code(), None, "{}", said());
            said().contains("slide").then_some(())
        });
        up.signal("INT");
        let code = up.ended(Duration::from_secs(60));
        // A task that was stopped is not a success.
        assert_eq!(code, Some(1), "{}", said());
        assert!(said().contains("retracting"), "{}", said());
        assert!(said().contains("NOT completed: stopped at"), "{}", said());
        let watched = format!(
            "tangent status --watch --connect tcp/127.0.0.1:{}",
            7447 + offset.parse::<u16>().unwrap()
        );
        assert!(said().contains(&watched), "{}", said());
        let files = mcap_files(folder.path());
        assert_eq!(files.len(), 1);
        assert!(files[0].with_extension("html").exists());
        let figures = json(&run(&[
            "report",
            files[0].to_str().unwrap(),
            "--json",
            "--no-html",
        ]));
        assert_eq!(figures["phase"], "done", "{figures}");
        assert_eq!(figures["verdict"], "stopped", "{figures}");
        assert!(number(&figures, "/progress") < 1.0, "{figures}");
        assert_eq!(figures["recording"]["truncated"], false);
        // The tool left the surface: the last truth is without contact.
        let recording = tangent_recorder::Recording::open(&files[0]).unwrap();
        let last = recording
            .messages()
            .filter(|m| m.topic == "/truth/contact")
            .last()
            .unwrap();
        let truth: tangent_schemas::tangent::ContactTruth =
            tangent_schemas::cdr::decode(&last.bytes).unwrap();
        assert!(!truth.in_contact);
    });
}

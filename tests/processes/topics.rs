//! The bus in words, and names that do not exist on it.

use std::fs::File;

use crate::cell::{Cell, PATIENCE};
use crate::common::{Process, json, number, run, stderr, wait_for};
use tangent_live::live_beside_others;

const PROCESSES: [&str; 3] = ["router simulator netft", "rtde controller", "estimator"];

/// Topics are listed, printed and measured, from any cell file and endpoint; a name that does not
/// exist is answered with the nearest one and the list.
#[test]
fn what_is_published_is_shown_and_wrong_names_are_answered_with_right_ones() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let list = wait_for("all topics have messages", PATIENCE, || {
            let list = json(&cell.cli(&["topic", "list", "--seconds", "1", "--json"]));
            let topics = list["topics"].as_array().unwrap();
            let all = [
                "arm/state",
                "wrench/tool",
                "health/rtde",
                "estimate/blend/normal",
            ];
            let there = |name: &&str| topics.iter().any(|topic| topic["topic"] == *name);
            all.iter().all(there).then_some(list)
        });
        let arm = list["topics"]
            .as_array()
            .unwrap()
            .iter()
            .find(|topic| topic["topic"] == "arm/state")
            .unwrap();
        assert_eq!(arm["type"], "tangent_msgs/msg/ArmState");
        assert_eq!(arm["publishers"], 1);

        let one = json(&cell.cli(&["topic", "echo", "arm/state", "--count", "1", "--json"]));
        assert_eq!(one["message"]["q"].as_array().unwrap().len(), 6, "{one}");
        let text = cell.cli(&[
            "topic",
            "echo",
            "wrench/tool",
            "--count",
            "1",
            "--fields",
            "wrench.force",
        ]);
        let text = String::from_utf8_lossy(&text.stdout).into_owned();
        assert!(
            text.contains("wrench/tool") && text.contains("wrench.force"),
            "{text}"
        );
        let rate = cell.cli_json(&["topic", "hz", "arm/state", "--seconds", "1"], 0);
        let hz = number(&rate, "/rate/rate_hz");
        assert!((60.0..190.0).contains(&hz), "{rate}");

        wrong_names(&cell);
        wrong_cell(&cell);
        watch(&cell);
    });
}

fn wrong_names(cell: &Cell) {
    for (args, words) in [
        (
            &["topic", "echo", "arm/stat", "--wait-s", "0.2"][..],
            &["arm/stat`", "`arm/state`", "wrench/tool"][..],
        ),
        (
            &[
                "topic",
                "echo",
                "arm/state",
                "--count",
                "1",
                "--fields",
                "qdd",
            ],
            &["qdd", "tool_pose"],
        ),
        (
            &["param", "get", "contoller"],
            &["contoller", "`controller`", "netft"],
        ),
        (
            &["param", "set", "contoller/force_reference_n", "3"],
            &["contoller", "`controller/force_reference_n`"],
        ),
        (
            &["param", "get", "controller/force_referense_n"],
            &["force_referense_n", "`force_reference_n`"],
        ),
        (
            &["estimator", "use", "blent"],
            &["blent", "`blend`", "reactive"],
        ),
    ] {
        let output = cell.cli(args);
        assert!(!output.status.success(), "{args:?}");
        let said = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
        for word in words {
            assert!(said.contains(word), "{args:?}: no {word:?} in: {said}");
        }
    }
}

/// A cell file with another name, and a router that is named on the command line.
fn wrong_cell(cell: &Cell) {
    let own = std::fs::read_to_string(cell.file()).unwrap();
    let name = format!("cell{}", cell.port_offset());
    let other = cell.file().with_file_name("other.toml");
    std::fs::write(&other, own.replace(&format!("\"{name}\""), "\"kitchen\"")).unwrap();
    for args in [&["status"][..], &["task", "status"], &["tare"]] {
        let mut all = args.to_vec();
        all.extend(["--cell", other.to_str().unwrap(), "--json"]);
        let output = run(&all);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{args:?}: {}",
            stderr(&output)
        );
        let error = json(&output);
        let said = error["error"].as_str().unwrap();
        assert!(said.contains("kitchen") && said.contains(&name), "{said}");
        assert_eq!(error["exit_code"], 2);
    }
    let endpoint = format!("tcp/127.0.0.1:{}", 7447 + cell.port_offset());
    let elsewhere = own.replace(&endpoint, "tcp/127.0.0.1:9");
    std::fs::write(&other, elsewhere).unwrap();
    let args = ["status", "--cell", other.to_str().unwrap(), "--json"];
    assert_eq!(run(&args).status.code(), Some(1));
    let connected = [&args[..], &["--connect", &endpoint]].concat();
    let status = json(&run(&connected));
    assert_eq!(status["cell"], name.as_str());
    assert!(!status["services"].as_array().unwrap().is_empty());
}

/// Redirected, `--watch` prints one state after the other, without control characters.
fn watch(cell: &Cell) {
    let shown = cell.file().with_file_name("watch.txt");
    let file = cell.file();
    let args = ["status", "--watch", "--cell", file.to_str().unwrap()];
    let output = File::create(&shown).unwrap();
    let mut watching =
        Process::start_with_output("watch", &args, output, std::process::Stdio::null());
    let text = wait_for("the state is shown twice", PATIENCE, || {
        let text = std::fs::read_to_string(&shown).unwrap();
        (text.matches("cell cell").count() >= 2).then_some(text)
    });
    watching.signal("INT");
    assert_eq!(watching.ended(PATIENCE), Some(0));
    for service in ["controller", "estimator", "netft", "rtde", "simulator"] {
        assert!(text.contains(service), "{text}");
    }
    assert!(!text.contains('\x1b'), "{text}");
    for line in text.lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

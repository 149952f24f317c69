//! The ROS 2 service against a program of ROS 2 that shares no code with it (`tests/ros2_peer`):
//! types, graph, topics both ways, service calls and a soak, on a simulated cell.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use common::{Process, port_offset, root, wait_for};
use serde_json::Value;
use tangent_live::{live, live_beside_others};
use tangent_runtime::{Bus, CellConfig, Role};
use tangent_schemas::standard::PoseWithCovarianceStamped;
use tangent_schemas::tangent::{ControlState, Health};
use tangent_schemas::{definition, topics};

/// Longest wait for the start of a system on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(60);
const POSE: &str = "/platform/base_pose";

/// The built peer: `TANGENT_ROS2_PEER`, or where its own build puts it.
fn peer() -> Option<PathBuf> {
    let built = match std::env::var_os("TANGENT_ROS2_PEER") {
        Some(path) => PathBuf::from(path),
        None => root().join("tests/ros2_peer/target/debug/ros2-peer"),
    };
    if built.exists() {
        return Some(built);
    }
    assert!(
        std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
        "TANGENT_REQUIRE_INTEROP is set, but {} is not built",
        built.display()
    );
    eprintln!(
        "skipped, because {} is not built: cargo build --manifest-path tests/ros2_peer/Cargo.toml",
        built.display()
    );
    None
}

/// Runs the peer to its end. Returns its lines of JSON.
fn run(peer: &Path, router: &str, arguments: &[&str], input: &str) -> Vec<Value> {
    let mut child = Command::new(peer)
        .args([router, "0"])
        .args(arguments)
        .env("RUST_LOG", "error")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(input.as_bytes())
        .unwrap();
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{arguments:?}: {text}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// `tangent up --ros2`, and a bus in its cell.
struct Cell {
    _up: Process,
    bus: Bus,
    router: String,
    _folder: tempfile::TempDir,
}

impl Cell {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut text = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
        for (from, to) in [
            (
                "commands = [\"stop\", \"pause\", \"status\"]",
                "commands = [\"stop\", \"status\", \"start\", \"select\"]",
            ),
            ("# [ros2.inputs] ", "[ros2.inputs] "),
            (
                "# base_pose = \"/base_pose\" ",
                "base_pose = \"/platform/base_pose\" ",
            ),
        ] {
            assert!(text.contains(from), "{from}");
            text = text.replacen(from, to, 1);
        }
        let file = folder.path().join("my_cell.toml");
        fs::write(&file, text).unwrap();
        let offset = port_offset();
        let log = fs::File::create(folder.path().join("up.log")).unwrap();
        let up = Process::start_with_log(
            "up",
            &[
                "up",
                "--ros2",
                "--stay",
                "--cell",
                file.to_str().unwrap(),
                "--folder",
                folder.path().join("recordings").to_str().unwrap(),
                "--port-offset",
                &offset.to_string(),
            ],
            log,
        );
        let router = format!("tcp/127.0.0.1:{}", 7447 + offset);
        let config = CellConfig::load(&file).unwrap();
        let config = config
            .changed("the observer's cell", |cell| {
                let zenoh = cell["zenoh"].as_table_mut().unwrap();
                zenoh.insert("connect".to_owned(), vec![router.clone()].into());
            })
            .unwrap();
        let bus = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let health = bus.subscribe(&topics::health("ros2"), 16).unwrap();
        wait_for("the ROS 2 service", PATIENCE, || {
            let health: Option<Health> = health.try_recv().map(|h| h.message);
            health.filter(|h| h.state == 1)
        });
        Self {
            _up: up,
            bus,
            router,
            _folder: folder,
        }
    }

    fn until_phase(&self, what: &str, holds: impl Fn(u8) -> bool) -> ControlState {
        let states = self.bus.subscribe(&topics::CONTROL_STATE, 4).unwrap();
        wait_for(what, PATIENCE, || {
            let state = states.recv_timeout(Duration::from_millis(100))?;
            holds(state.message.phase).then_some(state.message)
        })
    }
}

#[test]
fn every_type_has_the_hash_that_another_program_computes() {
    let Some(peer) = peer() else { return };
    let hashes = run(&peer, "tcp/127.0.0.1:1", &["hashes"], "");
    let hashes: BTreeMap<String, String> = serde_json::from_value(hashes[0].clone()).unwrap();
    let on_the_wire = |name: &str| {
        let parts: Vec<&str> = name.split('/').collect();
        format!("{}::{}::dds_::{}_", parts[0], parts[1], parts[2])
    };
    let mut compared = 0;
    for (name, _) in definition::FILES {
        if let Some(theirs) = hashes.get(&on_the_wire(name)) {
            let ours = tangent_ros2::type_hash::of_message(name).unwrap();
            assert_eq!(&ours, theirs, "{name}");
            compared += 1;
        } else {
            assert!(!name.starts_with("tangent_msgs/"), "{name} is not compared");
        }
    }
    for name in [
        "std_srvs/srv/Trigger",
        "tangent_msgs/srv/StartTask",
        "tangent_msgs/srv/SelectEstimator",
    ] {
        let ours = tangent_ros2::type_hash::of_service(name).unwrap();
        assert_eq!(ours, hashes[&on_the_wire(name)], "{name}");
        compared += 1;
    }
    assert_eq!(compared, hashes.len());
}

/// The node graph, echoes, calls and inputs, on one cell: each needs the one before.
#[test]
fn a_program_of_ros_2_sees_feeds_and_commands_a_cell() {
    let Some(peer) = peer() else { return };
    live_beside_others(|| {
        let cell = Cell::start();
        let ask = |arguments: &[&str]| run(&peer, &cell.router, arguments, "");
        cell.until_phase("the slide", |phase| phase == 3);

        let graph = &ask(&["graph", "/cell1", "tangent"])[0];
        let publishers = &graph["publishers"];
        for topic in [
            "arm/state",
            "joint_states",
            "wrench/tool",
            "wrench/status",
            "estimate/blend/normal",
            "control/state",
            "health/rtde",
            "tf",
        ] {
            assert_eq!(publishers[format!("/cell1/{topic}")], 1, "{topic}: {graph}");
        }
        assert!(
            publishers[POSE].is_null() || publishers[POSE] == 0,
            "{graph}"
        );
        let services = graph["services"].as_array().unwrap();
        let services: Vec<&str> = services.iter().map(|s| s[0].as_str().unwrap()).collect();
        for (service, offered) in [
            ("stop", true),
            ("status", true),
            ("start", true),
            ("select", true),
            ("pause", false),
            ("resume", false),
            ("tare", false),
        ] {
            let name = format!("/cell1/{service}");
            assert_eq!(services.contains(&name.as_str()), offered, "{service}");
        }

        let selected = &ask(&["select", "/cell1/select", "nobody"])[0];
        assert_eq!(selected["done"], false, "{selected}");
        assert!(
            selected["message"].as_str().unwrap().contains("nobody"),
            "{selected}"
        );
        let status = &ask(&["trigger", "/cell1/status"])[0];
        assert_eq!(status["success"], true, "{status}");
        let data: Value = serde_json::from_str(status["message"].as_str().unwrap()).unwrap();
        assert!(data.is_object(), "{data}");

        let stopped = &ask(&["trigger", "/cell1/stop"])[0];
        assert_eq!(stopped["success"], true, "{stopped}");
        cell.until_phase("the end of the task", |phase| [0, 5, 6].contains(&phase));

        // A task is refused with the reason, as from the command line.
        let start = &ask(&["start", "/cell1/start", "force = 3", "no"])[0];
        assert_eq!(start["done"], false, "{start}");
        assert!(!start["message"].as_str().unwrap().is_empty());

        // What hiroz reads in every token, and would write for the same endpoint.
        let tokens = cell_tokens(&cell.router);
        let read = run(&peer, &cell.router, &["tokens"], &tokens.join("\n"));
        assert_eq!(read.len(), tokens.len());
        for (token, read) in tokens.iter().zip(&read) {
            assert_eq!(read["token"], token.as_str());
            assert_eq!(read["namespace"], "/cell1");
            assert_eq!(read["node"], "tangent");
            if read["kind"] != "NN" {
                assert_eq!(read["volatile"], true);
                assert_eq!(read["reliable"], read["kind"] != "MS");
            }
        }

        echoes(&ask);

        let poses = cell.bus.subscribe(&topics::BASE_POSE, 512).unwrap();
        let sent = &ask(&["pose", POSE, "50", "3"])[0]["sent"];
        let mut arrived = 0;
        while let Some(pose) = poses.try_recv() {
            let pose: PoseWithCovarianceStamped = pose.message;
            assert_eq!(pose.header.frame_id.as_str(), "world");
            assert_eq!(pose.pose.pose.position.y, 0.25);
            assert_eq!(pose.pose.covariance.0[0], 1e-8);
            arrived += 1;
        }
        // The first ones are sent before the two programs know of each other.
        assert!(
            arrived > 50 && arrived <= sent.as_u64().unwrap(),
            "{arrived} of {sent}"
        );
    });
}

/// Liveliness tokens of ROS 2 at the router.
fn cell_tokens(router: &str) -> Vec<String> {
    let (sender, tokens) = std::sync::mpsc::channel();
    let endpoints = [router.to_owned()];
    let session = tangent_runtime::PlainSession::open(
        &CellConfig::default_cell().zenoh,
        &endpoints,
        Some(PATIENCE),
        &tangent_runtime::Stop::new(),
    )
    .unwrap();
    let _tokens = session
        .on_tokens("@ros2_lv/**", move |token, appears| {
            if appears {
                let _ = sender.send(token.to_owned());
            }
        })
        .unwrap();
    let mut all = Vec::new();
    while let Ok(token) = tokens.recv_timeout(Duration::from_secs(2)) {
        all.push(token);
    }
    assert!(!all.is_empty());
    all
}

/// Messages as the peer decodes them, in order and from one publisher.
fn echoes(ask: &dyn Fn(&[&str]) -> Vec<Value>) {
    for (kind, topic) in [
        ("ArmState", "arm/state"),
        ("JointState", "joint_states"),
        ("WrenchStamped", "wrench/tool"),
        ("NormalEstimate", "estimate/blend/normal"),
        ("ControlState", "control/state"),
        ("Health", "health/rtde"),
        ("TFMessage", "tf"),
    ] {
        let count = if kind == "Health" { "2" } else { "10" };
        let lines = ask(&["echo", kind, &format!("/cell1/{topic}"), count]);
        assert_eq!(lines.len().to_string(), count, "{topic}");
        for pair in lines.windows(2) {
            assert_eq!(pair[0]["gid"], pair[1]["gid"], "{topic}");
            let number = |line: &Value| line["sequence"].as_i64().unwrap();
            assert!(number(&pair[0]) < number(&pair[1]), "{topic}");
        }
        let message = &lines[0]["message"];
        match kind {
            "ArmState" => assert_eq!(message["q"].as_array().unwrap().len(), 6),
            "JointState" => {
                assert_eq!(message["name"][0], "shoulder_pan_joint", "{message}");
                assert_eq!(message["position"].as_array().unwrap().len(), 6);
            }
            "NormalEstimate" => assert_eq!(message["estimator"], "blend"),
            "Health" => assert_eq!(message["service"], "rtde"),
            "WrenchStamped" => assert_eq!(message["header"]["frame_id"], "tool"),
            "TFMessage" => assert!(!message["transforms"].as_array().unwrap().is_empty()),
            _ => assert!(message["phase"].is_u64(), "{message}"),
        }
    }
}

/// Nodes of ROS 2 and the cell talk for `seconds`, and at most a hundredth of a topic's messages is
/// missing: alone on the machine, because messages that a program is too slow for are dropped.
fn soak(seconds: u64) {
    let Some(peer) = peer() else { return };
    live(|| {
        let cell = Cell::start();
        let poses = cell.bus.subscribe(&topics::BASE_POSE, 100_000).unwrap();
        let figures = run(
            &peer,
            &cell.router,
            &["soak", "cell1", POSE, &seconds.to_string()],
            "",
        )
        .remove(0);
        println!("{figures}");
        for topic in ["arm/state", "joint_states", "wrench/tool"] {
            let counts = &figures["topics"][topic];
            let number = |what: &str| counts[what].as_f64().unwrap();
            // 100 Hz on an idle machine; half of that where builds take a core.
            assert!(
                number("received") > 50.0 * seconds as f64,
                "{topic}: {figures}"
            );
            assert!(
                number("missing") <= 0.01 * number("received"),
                "{topic}: {figures}"
            );
            assert_eq!(number("backwards"), 0.0, "{topic}: {figures}");
            assert_eq!(number("publishers"), 1.0, "{topic}: {figures}");
        }
        let unanswered = figures["unanswered"].as_array().unwrap();
        assert!(unanswered.is_empty(), "{figures}");
        assert!(
            figures["called"].as_u64().unwrap() > seconds / 4,
            "{figures}"
        );
        let mut arrived = 0_u64;
        let mut last = 0;
        while let Some(pose) = poses.try_recv() {
            let stamp_ns = pose.message.header.stamp.to_ns();
            assert!(stamp_ns > last, "a pose out of order");
            last = stamp_ns;
            arrived += 1;
        }
        let sent = figures["poses"].as_u64().unwrap();
        println!("{arrived} of {sent} poses arrived");
        assert!(arrived * 100 >= sent * 95, "{arrived} of {sent} poses");
    });
}

#[test]
fn a_minute_of_topics_poses_and_calls() {
    soak(60);
}

/// Ten minutes: `cargo test --release --test ros2 -- --ignored soak`.
#[test]
#[ignore = "lasts ten minutes"]
fn soak_of_ten_minutes() {
    soak(600);
}

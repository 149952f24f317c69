//! `tangent up --cell`: the file's cell runs; this is checked on the wire.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::path::Path;
use std::time::Duration;

use common::{Process, port_offset, root, wait_for};
use tangent_live::live_beside_others;
use tangent_mechanics::{Arm, Flange, Joints, ModelData, Pose, Tool};
use tangent_runtime::{Bus, CellConfig, Role};
use tangent_schemas::tangent::{ArmState, Request};
use tangent_schemas::topics::{self, queries};

/// Longest wait for the start of a system on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// The shipped cell with these texts in place of others.
fn cell(folder: &Path, changes: &[(&str, &str)]) -> String {
    let mut text = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let path = folder.join("my_cell.toml");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn up_runs_the_cell_that_it_is_given() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let file = cell(
            folder.path(),
            &[
                ("model = \"ur5\"", "model = \"ur5e\""),
                (
                    "address = \"127.0.0.1\"               # of the controller",
                    "address = \"192.168.7.9\"",
                ),
                ("filter_cutoff_hz = 50.0", "filter_cutoff_hz = 20.0"),
                (
                    "translation_m = [0.0, 0.0, 0.165]",
                    "translation_m = [0.0, 0.0, 0.2]",
                ),
                ("preset = \"default\"", "preset = \"paper\""),
                (
                    "# [controller.settings]",
                    "settings.force.damping_n_s_per_m = 222.0 #",
                ),
            ],
        );
        let offset = port_offset();
        let recordings = folder.path().join("recordings");
        let log = fs::File::create(folder.path().join("up.log")).unwrap();
        let mut up = Process::start_with_log(
            "up",
            &[
                "up",
                "--cell",
                &file,
                "--folder",
                recordings.to_str().unwrap(),
                "--port-offset",
                &offset.to_string(),
                "--stay",
            ],
            log,
        );
        let config = CellConfig::load(Path::new(&file)).unwrap();
        let config = config
            .changed("the observer's cell", |cell| {
                let endpoint = format!("tcp/127.0.0.1:{}", 7447 + offset);
                let zenoh = cell["zenoh"].as_table_mut().unwrap();
                zenoh.insert("connect".to_owned(), vec![endpoint].into());
            })
            .unwrap();
        let bus = wait_for("the router", PATIENCE, || {
            Bus::open_within(&config, Role::Client, Duration::from_secs(2)).ok()
        });
        let arms = bus.subscribe(&topics::ARM_STATE, 2000).unwrap();
        let mut truth = bus.latest(&topics::TRUTH_CONTACT).unwrap();
        let mut wrench = bus.latest(&topics::WRENCH_STATUS).unwrap();

        // The rate by the robot's own clock, which no load on this machine changes.
        let first: ArmState = arms.recv_timeout(PATIENCE).unwrap().message;
        let mut last = first.clone();
        while last.cycle < first.cycle + 500 {
            last = arms.recv_timeout(PATIENCE).unwrap().message;
        }
        assert_eq!(last.period_s, 0.002);
        let rate_hz = 500.0 / (last.robot_time_s - first.robot_time_s)
            * (last.cycle - first.cycle) as f64
            / 500.0;
        assert!((rate_hz - 500.0).abs() < 25.0, "{rate_hz} Hz");

        // The kinematics: those of a UR5e with the cell's tool, as the bridge computes them and as
        // the simulator stands.
        let tool: Pose<Flange, Tool> = config.tool.flange_from_tool();
        let reach = |model: &str, q: &[f64]| {
            let arm = Arm::<6>::new(&ModelData::builtin(model).unwrap()).unwrap();
            let q = Joints::<6>::from_column_slice(q);
            (arm.base_from_flange(&q) * tool).translation()
        };
        let near = |a: &nalgebra::Vector3<f64>, b: &tangent_schemas::standard::Point| {
            ((a.x - b.x).powi(2) + (a.y - b.y).powi(2) + (a.z - b.z).powi(2)).sqrt()
        };
        let there = reach("ur5e", &last.q);
        assert!(near(&there, &last.tool_pose.position) < 1e-9);
        assert!(near(&reach("ur5", &last.q), &last.tool_pose.position) > 0.005);
        let simulated = wait_for("the simulator's truth", PATIENCE, || {
            truth.get().map(|t| t.message.tool_pose.position.clone())
        });
        // The arm may move by some millimetres between the two messages.
        assert!(near(&there, &simulated) < 0.005, "{there} {simulated:?}");

        // The delay of the wrench's low pass: 11 ms at the cell's 20 Hz; it would be 4.5 ms at 50
        // Hz.
        let delay_s = wait_for("the wrench", PATIENCE, || {
            wrench.get().map(|w| w.message.filter_delay_s)
        });
        let expected_s = tangent_sensing::LowPass::new(20.0, 7000.0)
            .unwrap()
            .delay_s();
        assert!(
            (delay_s - expected_s).abs() < 1e-3,
            "{delay_s} s, {expected_s} s"
        );

        // The gains: the paper's alignment, the cell's own damping.
        let gain = |name: &str| {
            let request = Request {
                action: "get".to_owned(),
                argument: String::new(),
            };
            let key = queries::parameter("controller", name);
            let answer = bus.ask(&key, &request, PATIENCE).unwrap();
            let data: serde_json::Value = serde_json::from_str(&answer.data).unwrap();
            data["default"].as_f64().unwrap()
        };
        assert_eq!(gain("alignment_gain_per_s"), 0.08);
        assert_eq!(gain("damping_n_s_per_m"), 222.0);

        drop((arms, truth, wrench, bus));
        up.terminate(PATIENCE);
        let said = fs::read_to_string(folder.path().join("up.log")).unwrap();
        assert!(said.contains("robot.address = \"192.168.7.9\""), "{said}");

        // The recording contains the cell file as it was used.
        let recording = fs::read_dir(&recordings)
            .unwrap()
            .map(|e| e.unwrap().path())
            .find(|path| path.extension().is_some_and(|e| e == "mcap"))
            .unwrap();
        let recording = tangent_recorder::Recording::open(&recording).unwrap();
        let text = &recording.attachments()["cell.toml"];
        let stored = CellConfig::parse("the recorded cell", text).unwrap();
        assert_eq!(stored.robot.model, "ur5e");
        assert_eq!(stored.robot.address, "127.0.0.1");
        assert_eq!(stored.robot.port_offset, offset);
        assert_eq!(stored.sensor.filter_cutoff_hz, 20.0);
        assert_eq!(stored.controller.preset, "paper");
    });
}

//! Two cells through one router with certificates and access rules, every service in a process with
//! its own identity. A task on one cell never moves the other, an identity without permission
//! cannot command, and one recorder receives both. A revoked host is locked out at once.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use common::{Process, json, port_offset, root, run, stderr, wait_for};
use serde_json::Value;
use tangent_live::live_in_half;
use tangent_runtime::{Bus, CellConfig, Latest, Role};
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, NormalEstimate};
use tangent_schemas::topics;

const PATIENCE: Duration = Duration::from_secs(120);
const CELLS: [&str; 2] = ["left", "right"];

/// Cell file of one of the two cells, with its own ports and the common router.
fn cell_file(folder: &Path, name: &str, offset: u16, router_port: u16) -> PathBuf {
    let mut text = fs::read_to_string(root().join("deploy/cell.toml"))
        .unwrap()
        .replace("name = \"cell1\"", &format!("name = \"{name}\""))
        .replace("port_offset = 0 ", &format!("port_offset = {offset} "))
        .replace(
            "tcp/127.0.0.1:7447",
            &format!("quic/127.0.0.1:{router_port}"),
        )
        // The two cells share a small machine with other tests.
        .replace(
            "rate_hz = 0.0                       # records",
            "rate_hz = 1000.0 # records",
        )
        .replace(
            "run = [\"reactive\", \"quadratic\", \"gaussian_process\", \"blend\"]",
            "run = [\"reactive\", \"blend\"]",
        )
        .replace("[zenoh]\n", "[zenoh]\naccess = \"keys/access.json5\"\n");
    text.push_str(
        "\n[zenoh.tls]\nca = \"keys/ca.pem\"\ncertificate = \"keys/{identity}.pem\"\nkey = \"keys/{identity}.key\"\n",
    );
    let path = folder.join(format!("{name}.toml"));
    fs::write(&path, text).unwrap();
    path
}

struct Fleet {
    folder: tempfile::TempDir,
    files: Vec<String>,
    /// Processes of the fleet, the router first.
    processes: Vec<Process>,
}

impl Fleet {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("keys");
        let made = run(&[
            "keys",
            "new",
            keys.to_str().unwrap(),
            "--for",
            CELLS[0],
            "--for",
            CELLS[1],
        ]);
        assert!(made.status.success(), "{}", stderr(&made));
        let offsets = [port_offset(), port_offset()];
        let router_port = 7447 + offsets[0];
        let files: Vec<String> = CELLS
            .iter()
            .zip(offsets)
            .map(|(name, offset)| {
                let path = cell_file(folder.path(), name, offset, router_port);
                path.to_str().unwrap().to_owned()
            })
            .collect();
        let mut processes = vec![Process::start(
            "router",
            &["run", "router", "--cell", &files[0]],
        )];
        for file in &files {
            for services in [
                &["simulator"][..],
                &["rtde", "controller", "netft"],
                &["estimator"],
            ] {
                let args: Vec<&str> = ["run"]
                    .iter()
                    .chain(services)
                    .chain(&["--cell", file])
                    .copied()
                    .collect();
                processes.push(Process::start(&services.join("+"), &args));
            }
        }
        Self {
            folder,
            files,
            processes,
        }
    }

    fn file(&self, cell: usize) -> &Path {
        Path::new(&self.files[cell])
    }

    /// A session in this test, under the given identity.
    fn join(&self, cell: usize, identity: &str) -> Bus {
        let mut config = CellConfig::load(self.file(cell)).unwrap();
        config.zenoh.identify(identity);
        Bus::open_within(&config, Role::Client, PATIENCE).unwrap()
    }

    fn task_status(&self, cell: usize) -> Value {
        json(&run(&[
            "task",
            "status",
            "--json",
            "--cell",
            &self.files[cell],
        ]))
    }
}

fn newest<M: tangent_schemas::Message>(reader: &mut Latest<M>) -> M {
    let until = Instant::now() + PATIENCE;
    loop {
        if let Some(received) = reader.take_new() {
            return received.message.clone();
        }
        assert!(Instant::now() < until, "silence");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn two_cells_share_a_router_and_nothing_else() {
    live_in_half(|| {
        let mut fleet = Fleet::start();
        let viewers = [fleet.join(0, "viewer"), fleet.join(1, "viewer")];
        let mut arms = viewers
            .each_ref()
            .map(|bus| bus.latest(&topics::ARM_STATE).unwrap());
        let mut controls = viewers
            .each_ref()
            .map(|bus| bus.latest(&topics::CONTROL_STATE).unwrap());
        for (name, arm) in CELLS.iter().zip(&mut arms) {
            let state: ArmState = wait_for(&format!("{name} is ready"), PATIENCE, || {
                let state = newest(arm);
                state.ready.then_some(state)
            });
            assert!(
                state.commanded_by.starts_with("controller/"),
                "{}",
                state.commanded_by
            );
        }

        // One recorder for both cells.
        let recordings = fleet.folder.path().join("recordings");
        let text = fs::read_to_string(fleet.file(0))
            .unwrap()
            .replace("cells = [] ", &format!("cells = {CELLS:?} "));
        let text = text.replace(
            "folder = \"recordings\"",
            &format!("folder = {recordings:?}"),
        );
        let recorder_file = fleet.folder.path().join("recorder.toml");
        fs::write(&recorder_file, text).unwrap();
        let mut recorder = Process::start(
            "recorder",
            &["run", "recorder", "--cell", recorder_file.to_str().unwrap()],
        );

        // A client without an operator's identity sends the requests of an operator to both cells.
        let task = root().join("deploy/tasks/line.toml");
        let task = task.to_str().unwrap();
        let refused = run(&[
            "task",
            "start",
            task,
            "--cell",
            &fleet.files[0],
            "--identity",
            "viewer",
        ]);
        assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
        assert!(
            stderr(&refused).contains("no answer on"),
            "{}",
            stderr(&refused)
        );
        // The controller's identity of one cell is unknown in the other.
        let mut config = CellConfig::load(fleet.file(1)).unwrap();
        config.zenoh.identify("controller.left");
        let intruder = Bus::open_within(&config, Role::Client, PATIENCE).unwrap();
        let commands = intruder
            .raw_publisher(
                topics::ARM_COMMAND.key(),
                topics::ARM_COMMAND.message_name(),
            )
            .unwrap();

        let rest = newest(&mut arms[1]);
        let started = wait_for("the left task starts", PATIENCE, || {
            let started = json(&run(&[
                "task",
                "start",
                task,
                "--json",
                "--cell",
                &fleet.files[0],
            ]));
            (started["done"] == true).then_some(started)
        });
        assert!(
            started["data"]["activation"].as_u64().unwrap() > 0,
            "{started}"
        );
        let mut slid = false;
        let until = Instant::now() + PATIENCE;
        while !slid {
            assert!(
                Instant::now() < until,
                "the left arm never slid: {}",
                fleet.task_status(0)
            );
            let state: ControlState = newest(&mut controls[0]);
            assert_ne!(state.phase_text.as_str(), "fault", "{}", state.fault);
            slid = state.phase_text.as_str() == "slide" && state.force_n > 1.0;
            // Meanwhile, another client sends commands to the second arm.
            let right = newest(&mut arms[1]);
            let mut bytes = Vec::new();
            let command = ArmCommand {
                cycle: right.cycle,
                kind: 1,
                values: right.q.iter().map(|_| 0.5).collect(),
                activation: 99,
                ..ArmCommand::default()
            };
            tangent_schemas::cdr::encode(&command, &mut bytes).unwrap();
            commands.publish(&bytes);
            assert_eq!(right.commanded_by, rest.commanded_by);
            assert!(
                !right.refusal_reason.contains("drives this arm"),
                "{}",
                right.refusal_reason
            );
            for (now, then) in right.q.iter().zip(&rest.q) {
                assert!(
                    (now - then).abs() < 1e-3,
                    "the right arm moved: {:?}",
                    right.q
                );
            }
            assert_eq!(newest(&mut controls[1]).phase_text.as_str(), "idle");
        }

        // The status lists every service, by cell.
        let status = json(&run(&[
            "status",
            "--all",
            "--json",
            "--cell",
            &fleet.files[0],
        ]));
        for name in CELLS {
            let cell = status["cells"]
                .as_array()
                .unwrap()
                .iter()
                .find(|c| c["cell"] == name);
            let cell = cell.unwrap_or_else(|| panic!("{name} is not in {status}"));
            for service in ["rtde", "controller", "netft", "estimator", "simulator"] {
                let there = cell["services"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .any(|s| s["name"] == service);
                assert!(there, "{name}/{service} is not in {cell}");
            }
        }

        // A second process of this name reports the first one's host, and ends.
        let second = run(&["run", "netft", "--cell", &fleet.files[1]]);
        assert_eq!(second.status.code(), Some(1));
        let said = stderr(&second);
        assert!(said.contains("netft already runs in cell right"), "{said}");
        assert!(said.contains("on host"), "{said}");

        let stopped = run(&["task", "stop", "--cell", &fleet.files[0]]);
        assert!(stopped.status.success(), "{}", stderr(&stopped));
        wait_for("the left arm retracts", PATIENCE, || {
            let phase = fleet.task_status(0)["data"]["phase"].as_str()?.to_owned();
            (phase != "retract" && phase != "slide").then_some(())
        });
        assert_eq!(recorder.terminate(PATIENCE), Some(0));
        fleet.processes.iter_mut().rev().for_each(Process::kill);

        // One recording contains two cells.
        let file = fs::read_dir(&recordings)
            .unwrap()
            .next()
            .unwrap()
            .unwrap()
            .path();
        let file = file.to_str().unwrap();
        let undecided = run(&["report", file, "--no-html"]);
        assert_eq!(undecided.status.code(), Some(1));
        assert!(
            stderr(&undecided).contains("left, right"),
            "{}",
            stderr(&undecided)
        );
        let of = |cell: &str| {
            json(&run(&[
                "report",
                file,
                "--no-html",
                "--json",
                "--cell",
                cell,
            ]))
        };
        let (left, right) = (of("left"), of("right"));
        assert!(left["force"]["mean_n"].as_f64().unwrap() > 1.0, "{left}");
        assert!(right["force"]["mean_n"].is_null(), "{right}");
    });
}

/// The router continues to run; only the host whose key was lost is disconnected, within seconds.
#[test]
fn a_revoked_host_is_locked_out_while_the_router_runs() {
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    let keys = keys.to_str().unwrap();
    let file = cell_file(folder.path(), "left", 0, 7447 + port_offset());
    let made = run(&[
        "keys",
        "new",
        keys,
        "--for",
        "left",
        "--estimator-host",
        "lab",
        "--estimator-host",
        "desk",
    ]);
    assert!(made.status.success(), "{}", stderr(&made));
    let mut router = Process::start(
        "router",
        &["run", "router", "--cell", file.to_str().unwrap()],
    );
    let join = |identity: &str| {
        let mut config = CellConfig::load(&file).unwrap();
        config.zenoh.identify(identity);
        Bus::open_within(&config, Role::Client, PATIENCE).unwrap()
    };
    let controller = join("controller.left");
    let heard = controller
        .subscribe(&topics::ESTIMATE_NORMALS, 1000)
        .unwrap();
    let hosts = ["estimator-lab.left", "estimator-desk.left"].map(|identity| {
        let bus = join(identity);
        let publisher = bus.publisher(&topics::estimate_normal("any")).unwrap();
        (bus, publisher)
    });
    let hear = |wanted: u64| {
        for (i, (_, publisher)) in hosts.iter().enumerate() {
            publisher.publish(&NormalEstimate {
                cycle: i as u64,
                ..NormalEstimate::default()
            });
        }
        std::thread::park_timeout(Duration::from_millis(1));
        let all: Vec<u64> = std::iter::from_fn(|| heard.try_recv())
            .map(|received| received.message.cycle)
            .collect();
        (all.contains(&wanted), all.contains(&0))
    };
    for host in [0, 1] {
        wait_for("both are heard", PATIENCE, || hear(host).0.then_some(()));
    }
    let revoked = run(&["keys", "revoke", keys, "estimator-lab.left"]);
    assert!(revoked.status.success(), "{}", stderr(&revoked));
    // From some moment on, only messages of the other one arrive.
    wait_for("only the other one is heard", PATIENCE, || {
        let until = Instant::now() + Duration::from_secs(1);
        let (mut other, mut lost) = (false, false);
        while Instant::now() < until {
            let (desk, lab) = hear(1);
            other |= desk;
            lost |= lab;
        }
        (other && !lost).then_some(())
    });
    assert_eq!(router.code(), None, "the router has ended");
    let listed = run(&["keys", "list", keys]);
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    let line = listed.lines().find(|l| l.starts_with("estimator-lab.left"));
    assert!(line.unwrap().contains("REVOKED"), "{listed}");
    assert_eq!(router.terminate(PATIENCE), Some(0));
}

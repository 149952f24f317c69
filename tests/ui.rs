//! The operator's page on a live simulated cell: over HTTP, and in a real browser.

#![allow(clippy::unwrap_used)]

mod common;
#[path = "ui/soak.rs"]
mod soak;
// Shared with the other tests of processes, of which this one needs a part.
#[allow(dead_code)]
#[path = "processes/cell.rs"]
mod cell;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cell::{Cell, PATIENCE, set};
use common::{Process, wait_for};
use serde_json::{Value, json};
use tangent_live::{interop, live, live_beside_others, ports};
use tangent_recorder::Recording;
use tangent_schemas::tangent::OperatorCommand;
use tangent_schemas::{Message, cdr};

/// The cell's processes: the page is not in that of the control loop.
const PROCESSES: [&str; 4] = [
    "router",
    "simulator",
    "rtde netft controller",
    "estimator recorder",
];

/// A cell with its page.
struct Served {
    cell: Cell,
    ui: Process,
    /// Address with the token.
    page: String,
}

impl Served {
    /// Tasks are lines of some strokes, with or without a tare.
    fn start(on_lost_page: &str, offered: &[(&str, bool, u32)]) -> Self {
        let cell = Cell::new(|cell| {
            set(cell, "ui.address", format!("127.0.0.1:{}", ports::free()));
            set(cell, "ui.on_lost_page", on_lost_page);
        });
        Self::of(cell, &PROCESSES, offered, 0.02)
    }

    /// Serves the page of a cell whose file has an address for it.
    fn of(
        mut cell: Cell,
        processes: &[&str],
        offered: &[(&str, bool, u32)],
        speed_m_per_s: f64,
    ) -> Self {
        let folder = cell.file().parent().unwrap().to_owned();
        let tasks = folder.join("tasks");
        fs::create_dir(&tasks).unwrap();
        for (name, tare, strokes) in offered {
            let text = format!(
                "name = \"{name}\"\ntare = {tare}\nforce.reference_n = 3.0\nend.retract_distance_m = 0.005\n\
                 approach.speed_m_per_s = 0.015\n[path]\nkind = \"line\"\nto_m = [0.04, 0.0]\nspeed_m_per_s = {speed_m_per_s}\nstrokes = {strokes}\n"
            );
            fs::write(tasks.join(format!("{name}.toml")), text).unwrap();
        }
        cell.start_all(processes);
        let (out, log) = (folder.join("ui.out"), folder.join("ui.log"));
        let file = cell.file();
        let ui = Process::start_with_output(
            "ui",
            &["ui", "--cell", file.to_str().unwrap()],
            fs::File::create(&out).unwrap(),
            fs::File::create(log).unwrap(),
        );
        let page = wait_for("the page's address", PATIENCE, || {
            let said = fs::read_to_string(&out).unwrap();
            said.ends_with('\n').then(|| said.trim().to_owned())
        });
        Self { cell, ui, page }
    }

    fn host(&self) -> String {
        let rest = self.page.strip_prefix("http://").unwrap();
        rest.split('/').next().unwrap().to_owned()
    }

    fn token(&self) -> String {
        self.page.split_once("#token=").unwrap().1.to_owned()
    }

    fn post(&self, path: &str, body: &Value) -> Value {
        post(&self.host(), &self.token(), path, body)
    }

    fn command(&self, action: &str) -> Value {
        self.post("/api/command", &json!({ "action": action }))
    }

    /// Starts a task as soon as the cell takes it.
    fn begin(&self, file: &str) {
        wait_for("the task starts", PATIENCE, || {
            let body = json!({ "action": "start", "task": file });
            let answer = self.post("/api/command", &body);
            if answer["done"] != true {
                eprintln!("{}", answer["message"]);
            }
            (answer["done"] == true).then_some(())
        });
    }

    /// The first snapshot for which this holds.
    fn seen(&self, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
        let host = self.host();
        let mut stream = TcpStream::connect(&host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let head = format!("GET /api/stream HTTP/1.0\r\nHost: {host}\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        let until = Instant::now() + PATIENCE;
        let mut last = Value::Null;
        for line in BufReader::new(stream).lines() {
            let line = line.unwrap();
            let Some(text) = line.strip_prefix("data: ") else {
                continue;
            };
            last = serde_json::from_str(text).unwrap();
            if holds(&last) {
                return last;
            }
            assert!(Instant::now() < until, "{what}: not in {}", last["task"]);
        }
        panic!("{what}: the stream ended after {}", last["task"]);
    }

    fn phase(&self, phase: &str) -> Value {
        self.seen(phase, |s| s["task"]["phase"] == phase)
    }

    /// Ends the recorder, and returns the recording.
    fn recording(&mut self) -> PathBuf {
        self.cell.process("estimator recorder").terminate(PATIENCE);
        let files = self.cell.files();
        assert_eq!(files.len(), 1, "{files:?}");
        files[0].clone()
    }
}

fn ask(host: &str, head: &str, body: &str) -> String {
    let mut stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let length = body.len();
    let text = format!("{head}\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n{body}");
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (_, body) = answer.split_once("\r\n\r\n").unwrap();
    body.to_owned()
}

fn post(host: &str, token: &str, path: &str, body: &Value) -> Value {
    let head = format!(
        "POST {path} HTTP/1.0\r\nContent-Type: application/json\r\nAuthorization: Bearer {token}"
    );
    let answer = ask(host, &head, &body.to_string());
    serde_json::from_str(&answer).unwrap_or(Value::Null)
}

/// Time on the processor of a process so far, s.
fn processor_s(id: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .unwrap()
        .split_whitespace()
        .collect();
    let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
    ticks / 100.0
}

fn commands(recording: &Recording) -> Vec<OperatorCommand> {
    recording
        .messages()
        .filter(|m| m.type_name == OperatorCommand::NAME)
        .map(|m| cdr::decode(&m.bytes).unwrap())
        .collect()
}

#[test]
fn a_task_is_driven_from_the_page_and_everything_is_recorded() {
    live_beside_others(|| {
        let mut served = Served::start("pause", &[("long", true, 20)]);
        served.begin("long.toml");
        let here = Arc::new(AtomicBool::new(true));
        let page = std::thread::spawn({
            let (host, token, here) = (served.host(), served.token(), Arc::clone(&here));
            move || {
                while here.load(Ordering::Relaxed) {
                    post(&host, &token, "/api/here", &json!({ "page": "test" }));
                    std::thread::sleep(Duration::from_millis(500));
                }
            }
        });
        served.phase("slide");
        let (began, used) = (Instant::now(), processor_s(served.ui.id()));
        let slid = served.seen("progress", |s| {
            s["task"]["progress"].as_f64() > Some(0.08) && began.elapsed() > Duration::from_secs(4)
        });
        let share = (processor_s(served.ui.id()) - used) / began.elapsed().as_secs_f64();
        println!(
            "the page's service takes {:.1} % of a core with one page at 20 Hz",
            100.0 * share
        );
        assert!(
            slid["force"]["now"].as_f64().unwrap() > 1.0,
            "{}",
            slid["force"]
        );
        assert_eq!(slid["pages"], json!([1, 1]));

        // What was pressed so far is in the map: about 3 N for the time since touchdown.
        let map = ask(&served.host(), "GET /api/dose HTTP/1.0", "");
        let map: Value = serde_json::from_str(&map).unwrap();
        let sum: f64 = map["cells"].as_array().unwrap().len() as f64;
        let impulse = map["impulse_n_s"].as_f64().unwrap();
        assert!(sum > 50.0 && impulse > 3.0, "{sum} cells, {impulse} N*s");

        assert_eq!(served.command("pause")["done"], true);
        served.seen("the pause", |s| s["task"]["paused"] == true);
        assert_eq!(served.command("resume")["done"], true);
        served.seen("the path goes on", |s| s["task"]["paused"] == false);
        // The page vanishes: the cell file says that the task is paused.
        here.store(false, Ordering::Relaxed);
        page.join().unwrap();
        served.seen("the lost page is answered", |s| {
            s["task"]["paused"] == true && s["last_command"]["who"] == "lost page"
        });
        assert_eq!(served.command("resume")["done"], true);
        served.seen("the path goes on", |s| s["task"]["paused"] == false);
        assert_eq!(served.command("stop")["done"], true);
        served.seen("the end", |s| s["task"]["active"] == false);

        let path = served.recording();
        let recorded = commands(&Recording::open(&path).unwrap());
        let done: Vec<(&str, &str)> = recorded
            .iter()
            .filter(|c| c.done)
            .map(|c| (c.who.as_str(), c.action.as_str()))
            .collect();
        assert_eq!(
            done,
            [
                ("local", "start"),
                ("local", "pause"),
                ("local", "resume"),
                ("lost page", "pause"),
                ("local", "resume"),
                ("local", "stop"),
            ]
        );
        let stamps: Vec<i64> = recorded.iter().map(|c| c.header.stamp.to_ns()).collect();
        assert!(stamps.is_sorted() && stamps[0] > 0, "{stamps:?}");
        assert!(
            recorded
                .iter()
                .all(|c| c.address.is_empty() == (&*c.who == "lost page"))
        );

        let name = path.file_name().unwrap().to_str().unwrap();
        let answer = served.post("/api/report", &json!({ "recording": name }));
        let report = answer["report"]
            .as_str()
            .unwrap_or_else(|| panic!("{answer}"));
        let html = ask(
            &served.host(),
            &format!("GET /recordings/{report} HTTP/1.0"),
            "",
        );
        assert!(
            html.contains("<svg") && html.contains("long"),
            "{}",
            html.len()
        );
        assert_eq!(served.ui.terminate(PATIENCE), Some(0));
    });
}

/// What a script found in a browser; `None` without one.
fn browsed(served: &Served, script: &str) -> Option<Value> {
    let pictures = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("TANGENT_PICTURES")
        .map_or_else(|| pictures.path().to_owned(), PathBuf::from);
    let id = served.ui.id().to_string();
    let arguments = [served.page.as_str(), &id, folder.to_str().unwrap()];
    let output = interop::output_of(script, &arguments)?;
    Some(serde_json::from_str(output.lines().last().unwrap()).unwrap())
}

#[test]
fn an_operator_works_with_it_in_a_browser() {
    live(|| {
        let served = Served::start("nothing", &[("wipe", true, 2), ("long", false, 60)]);
        let Some(found) = browsed(&served, "ui_browser.py") else {
            return;
        };
        assert_eq!(found["token_in_address"], false);
        assert_eq!(found["you"], json!(["local, engineer", "reading only"]));
        let may = json!({ "start": false, "pause": false, "stop": true });
        assert_eq!(found["phone_may"], may);
        assert_eq!(found["phone_width"], 390, "nothing is wider than the phone");
        assert_eq!(found["phone_dark"], "rgb(17, 22, 28)");
        let place: Vec<f64> = serde_json::from_value(found["phone_stop"].clone()).unwrap();
        assert!(place[0] > 0.0 && place[1] <= place[2], "{place:?}");
        let stopped = json!([
            "Standing still",
            "Paused",
            "Approaching",
            "Touching down",
            "Sliding",
            "Pressing and standing",
            "Retracting"
        ]);
        assert_eq!(found["stopped_in"], stopped);
        let cut = found["cut"].as_str().unwrap();
        assert!(
            cut.contains("No connection") && cut.contains("continues"),
            "{cut}"
        );
        let reached = found["reached"].as_array().unwrap();
        assert_eq!(
            (&reached[0], reached.last().unwrap()),
            (&json!("stop"), &json!("start"))
        );
        assert_eq!(found["errors"], json!([]));
        assert_eq!(found["webgl"], json!([true, false]));
        assert!(!found["report"].as_str().unwrap().is_empty());
    });
}

/// Moves the simulated arm like a hand, as soon as a page has taken what comes before, until
/// `gone`.
fn guide(served: &Served, gone: &AtomicBool) {
    let taken = |what: &str, holds: &dyn Fn(&Value) -> bool| {
        let gone = || gone.load(Ordering::Relaxed);
        served.seen(what, |s| gone() || holds(&s["teach"]));
        !gone()
    };
    let numbers = |value: &Value| -> [f64; 3] { serde_json::from_value(value.clone()).unwrap() };
    let place = |snapshot: &Value| {
        let joints = snapshot["space"]["joints"].as_array().unwrap();
        numbers(joints.last().unwrap())
    };
    // Forces in N: across the tool's axis, and against it.
    let push = |across_n: f64, back_n: f64, way_m: f64| {
        let before = served.seen("the arm", |s| s["space"].is_object());
        let (from, z) = (place(&before), numbers(&before["space"]["tool_z"]));
        let force = [0, 1, 2].map(|i| {
            let y = if i == 1 { 1.0 } else { 0.0 } - z[1] * z[i];
            y * across_n - z[i] * back_n
        });
        let [x, y, z] = force;
        served.cell.provoke("push", &format!("{x},{y},{z}"));
        served.seen("the tool follows the hand", |s| {
            let apart = place(s)
                .iter()
                .zip(&from)
                .map(|(a, b)| (a - b).powi(2))
                .sum::<f64>();
            apart.sqrt() > way_m
        });
        served.cell.provoke("push", "0,0,0");
    };
    if taken("the first point", &|t| t["points"] == 1) {
        push(8.0, 0.0, 0.02);
    }
    if taken("a stroke", &|t| t["stroking"] == true) {
        push(-8.0, 0.0, 0.01);
    }
    if taken("the stroke's end", &|t| t["strokes"] == 1) {
        push(0.0, 8.0, 0.05);
    }
}

#[test]
fn an_engineer_teaches_a_task_in_a_browser() {
    live(|| {
        let served = Served::start("nothing", &[("wipe", true, 2)]);
        served.seen("the arm is ready", |s| {
            s["lights"][0]["code"]
                .as_str()
                .unwrap()
                .starts_with("robot.ready")
        });
        let gone = AtomicBool::new(false);
        let found = std::thread::scope(|scope| {
            scope.spawn(|| guide(&served, &gone));
            let found = browsed(&served, "ui_teach.py");
            gone.store(true, Ordering::Relaxed);
            found
        });
        let Some(found) = found else {
            return;
        };
        assert_eq!(found["phone_teaches"], false);
        assert_eq!(found["drawn"], "4");
        assert!(
            found["exists"]
                .as_str()
                .unwrap()
                .contains("wipe.toml exists")
        );
        assert_eq!(found["still_free"], true);
        assert_eq!(found["chosen"], "shown.toml");
        assert_eq!(found["percent"], "100 %");
        let held_after_s = found["held_after_s"].as_f64().unwrap();
        println!("the arm holds itself {held_after_s:.1} s after the page is gone");
        assert_eq!(found["kept_points"], 1);
        assert_eq!(found["errors"], json!([]));
        let file = served.cell.file().with_file_name("tasks/shown.toml");
        let checked = served.cell.cli(&["check", file.to_str().unwrap()]);
        assert_eq!(checked.status.code(), Some(0));
    });
}

#[test]
fn a_cell_at_500_hz_is_shown_right_and_stopped_while_it_seeks() {
    live(|| {
        // The surface steps down in the middle of the path, at a sharp rim. A thin tip falls over
        // it: a pad, or a slow tool, tilts around it and keeps its contact.
        let surface = "shape = \"step\"\nheight_m = -0.012\nedge_radius_m = 0.0005\n\
                       position_m = [0.42, 0.0, 0.1]\n\
                       [plant.tool.tip]\nshape = \"round\"\nradius_m = 0.001";
        let cell = Cell::with_e_series(surface, |cell| {
            set(cell, "ui.address", format!("127.0.0.1:{}", ports::free()));
            // A search of 10 s: a browser on a busy machine shows a phase of 2 s too late.
            let slow = toml::from_str::<toml::Table>("contact.seek_speed_m_per_s = 0.001");
            set(cell, "controller.settings", slow.unwrap());
        });
        let served = Served::of(cell, &PROCESSES, &[("long", true, 20)], 0.08);
        let Some(found) = browsed(&served, "ui_fast.py") else {
            return;
        };
        println!("{found}");
        let figures =
            |part: &str| -> Vec<f64> { serde_json::from_value(found[part].clone()).unwrap() };
        let [robot_hz, robot_ms] = figures("robot")[..] else {
            panic!("{found}");
        };
        let [controller_hz, missed, controller_ms] = figures("controller")[..] else {
            panic!("{found}");
        };
        for hz in [robot_hz, controller_hz] {
            assert!((450.0..=510.0).contains(&hz), "{found}");
        }
        assert!(
            robot_ms < 100.0 && controller_ms < 100.0 && missed < 500.0,
            "{found}"
        );
        assert_eq!(found["errors"], json!([]));
    });
}

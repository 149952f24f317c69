//! The service over real HTTP, with a bus in this process in place of a cell.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Instant;

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use tangent_control::Phase;
use tangent_mechanics::{Base, ModelData, Pose, Tool};
use tangent_runtime::bus::answer;
use tangent_runtime::config::OnLostPage;
use tangent_runtime::{CellConfig, Handle};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmState, ControlState, Request};
use tangent_schemas::topics::queries;

use super::*;
use crate::access::Role;

mod teaching;

use teaching::Pupil;

const PATIENCE: Duration = Duration::from_secs(20);

/// A calibration that counts its poses, and refuses the third.
fn tools() -> Tools {
    let poses = Mutex::new(0);
    let calibrate: Calibrator = Arc::new(move |step| {
        let mut poses = lock(&poses);
        let done = match step {
            CalibrationStep::Begin => {
                *poses = 0;
                true
            }
            CalibrationStep::Pose if *poses < 2 => {
                *poses += 1;
                true
            }
            CalibrationStep::Pose => false,
        };
        Calibration {
            done,
            message: if done { "" } else { "the arm moves" }.to_owned(),
            poses: *poses,
            wanted: 9,
            ..Calibration::default()
        }
    });
    Tools {
        report: None,
        calibrate: Some(calibrate),
        teach: Some(Arc::new(Pupil::default())),
    }
}

/// A page without a cell behind it.
struct Page {
    bus: Bus,
    stop: Stop,
    address: SocketAddr,
    operator: String,
    engineer: String,
    thread: Option<JoinHandle<Result<(), UiError>>>,
    _folder: tempfile::TempDir,
}

impl Page {
    fn start(change: impl FnOnce(&mut Config)) -> Self {
        let cell = CellConfig::default_cell();
        let model = ModelData::builtin(&cell.robot.model).unwrap();
        let mut config = Config::from_cell(&cell, &model).unwrap();
        let folder = tempfile::tempdir().unwrap();
        config.address.set_port(0);
        config.recordings = folder.path().to_owned();
        config.tasks = folder.path().to_owned();
        config.missing_tasks = None;
        std::fs::write(
            folder.path().join("wipe.toml"),
            "name = 'wipe'\nforce.reference_n = 3.0\n[path]\nkind = 'stay'\nduration_s = 1.0\n",
        )
        .unwrap();
        let mut token = |name, role| config.tokens.add_for_this_process(name, role).unwrap();
        let operator = token("anna", Role::Operator);
        let engineer = token("ben", Role::Engineer);
        change(&mut config);
        let (bus, stop) = (Bus::in_process("test"), Stop::new());
        let (told, listening) = mpsc::channel();
        let thread = std::thread::spawn({
            let (bus, stop) = (bus.clone(), stop.clone());
            move || {
                run(config, &bus, &stop, tools(), |address| {
                    told.send(address).unwrap()
                })
            }
        });
        let address = listening.recv_timeout(PATIENCE).unwrap();
        Self {
            bus,
            stop,
            address,
            operator,
            engineer,
            thread: Some(thread),
            _folder: folder,
        }
    }

    /// Status and body of a request with these lines in its head.
    fn ask(&self, method: &str, path: &str, head: &[&str], body: &[u8]) -> (u16, String) {
        let own = format!("Host: {}", self.address);
        let has_host = head.iter().any(|line| line.starts_with("Host:"));
        let mut lines = vec![format!("{method} {path} HTTP/1.0")];
        lines.extend((!has_host).then_some(own));
        lines.extend(head.iter().map(|line| (*line).to_owned()));
        lines.push(format!("Content-Length: {}", body.len()));
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let head = lines.join("\r\n") + "\r\n\r\n";
        stream.write_all(head.as_bytes()).unwrap();
        // A body that is too large may be refused before it is read.
        let _ = stream.write_all(body);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer).into_owned();
        let status = answer.split(' ').nth(1).unwrap_or("0").parse().unwrap();
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        (status, body.to_owned())
    }

    fn get(&self, path: &str) -> (u16, String) {
        self.ask("GET", path, &[], b"")
    }

    fn get_json(&self, path: &str) -> Value {
        serde_json::from_str(&self.get(path).1).unwrap()
    }

    fn post(&self, path: &str, token: &str, body: &Value) -> (u16, Value) {
        let token = format!("Authorization: Bearer {token}");
        let mut head = vec!["Content-Type: application/json"];
        if token.len() > "Authorization: Bearer ".len() {
            head.push(&token);
        }
        let (status, body) = self.ask("POST", path, &head, body.to_string().as_bytes());
        (status, serde_json::from_str(&body).unwrap_or(Value::Null))
    }

    /// A reader of the stream.
    fn stream(&self) -> impl Iterator<Item = Value> + use<> {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let head = format!("GET /api/stream HTTP/1.0\r\nHost: {}\r\n\r\n", self.address);
        stream.write_all(head.as_bytes()).unwrap();
        let lines = BufReader::new(stream).lines().map_while(Result::ok);
        lines.filter_map(|line| {
            let text = line.strip_prefix("data: ")?;
            Some(serde_json::from_str(text).unwrap())
        })
    }

    /// Answers the requests of this key as done.
    fn cell(&self, key: &str) -> (Handle, mpsc::Receiver<Request>) {
        let (asked, requests) = mpsc::channel();
        let answering = move |_: &str, request: Request| {
            asked.send(request).unwrap();
            answer::done("as asked")
        };
        (self.bus.answer(key, answering).unwrap(), requests)
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.stop.trigger();
        let ended = self.thread.take().unwrap().join();
        if !std::thread::panicking() {
            ended.unwrap().unwrap();
        }
    }
}

/// The tool presses on the plane z = 0 with 5 N, at x, at a time.
fn states(cycle: u64, time_s: f64, x: f64) -> (ArmState, ControlState) {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let pose = Pose::<Base, Tool>::new(Vector3::new(x, 0.0, 0.0), down);
    let arm = ArmState {
        cycle,
        q: [0.0; 6].into_iter().collect(),
        tool_pose: (&pose).into(),
        ready: true,
        ..ArmState::default()
    };
    let control = ControlState {
        header: Header::new((time_s * 1e9) as i64, "base"),
        cycle,
        activation: 1,
        phase: Phase::Slide as u8,
        normal: (&Vector3::z()).into(),
        force_reference_n: 5.0,
        force_n: 5.0,
        ..ControlState::default()
    };
    (arm, control)
}

#[test]
fn a_page_sees_the_cell_and_the_dose_that_it_was_given() {
    let page = Page::start(|_| {});
    let arms = page.bus.publisher(&topics::ARM_STATE).unwrap();
    let controls = page.bus.publisher(&topics::CONTROL_STATE).unwrap();
    let mut snapshots = page.stream();
    for cycle in 0..500 {
        let time_s = cycle as f64 * 0.002;
        let (arm, control) = states(cycle, time_s, 0.05 * time_s);
        arms.publish(&arm);
        controls.publish(&control);
    }
    let seen = snapshots.find(|s| s["task"]["phase"] == "slide" && s["dose"][1] == 499);
    let seen = seen.unwrap();
    assert_eq!(seen["force"]["now"], 5.0);
    assert_eq!(seen["space"]["joints"].as_array().unwrap().len(), 9);
    let dose = page.get_json("/api/dose");
    // 499 steps of 2 ms with 5 N.
    let impulse = dose["impulse_n_s"].as_f64().unwrap();
    assert!((impulse - 4.99).abs() < 0.01, "{impulse}");
    let (status, csv) = page.get("/api/dose.csv");
    assert_eq!(status, 200);
    assert_eq!(
        csv.lines().count(),
        dose["cells"].as_array().unwrap().len() + 1
    );
    assert!(page.get("/api/dose.ply").1.starts_with("ply\n"));
    let about = page.get_json("/api/about");
    assert_eq!(about["tasks"][0]["file"], "wipe.toml");
    assert_eq!(about["you"]["role"], Value::Null);
    let (status, html) = page.get("/");
    assert!(status == 200 && html.contains("id=\"stop\""));
    assert_eq!(page.get("/../../etc/passwd").0, 404);
    assert_eq!(page.get("/recordings/..%2F..%2Fetc%2Fpasswd.html").0, 404);
}

#[test]
fn commands_need_a_token_and_a_stop_needs_none() {
    let page = Page::start(|_| {});
    let (_task, tasks) = page.cell(queries::CONTROL_TASK);
    let (_stop, stops) = page.cell(queries::CONTROL_STOP);
    let (_select, selects) = page.cell(queries::CONTROL_SELECT);
    let start = json!({ "action": "start", "task": "wipe.toml" });
    for token in ["", "wrong"] {
        assert_eq!(page.post("/api/command", token, &start).0, 401);
    }
    assert!(tasks.try_recv().is_err(), "nothing reached the cell");
    let (status, answer) = page.post("/api/command", &page.operator, &start);
    assert_eq!((status, &answer["done"]), (200, &json!(true)));
    let request = tasks.recv_timeout(PATIENCE).unwrap();
    assert!(request.action == "start" && request.argument.contains("name = 'wipe'"));
    let estimator = json!({ "action": "estimator", "name": "blend" });
    let (status, answer) = page.post("/api/command", &page.operator, &estimator);
    assert_eq!((status, &answer["done"]), (200, &json!(false)));
    assert!(answer["message"].as_str().unwrap().contains("engineer"));
    assert!(selects.try_recv().is_err());
    page.post("/api/command", &page.engineer, &estimator);
    assert_eq!(selects.recv_timeout(PATIENCE).unwrap().argument, "blend");
    let (status, answer) = page.post("/api/command", "", &json!({ "action": "stop" }));
    assert_eq!((status, &answer["done"]), (200, &json!(true)));
    assert_eq!(stops.recv_timeout(PATIENCE).unwrap().action, "stop");
}

#[test]
fn an_engineer_calibrates_step_by_step_and_each_step_is_recorded() {
    let page = Page::start(|_| {});
    let records = page.bus.subscribe(&topics::OPERATOR_COMMAND, 64).unwrap();
    let step =
        |token: &str, step: &str| page.post("/api/calibrate", token, &json!({ "step": step }));
    for token in ["", &page.operator] {
        let (status, answer) = step(token, "begin");
        assert_eq!(status, 401);
        assert!(
            answer["message"].as_str().unwrap().contains("engineer"),
            "{answer}"
        );
    }
    assert_eq!(step(&page.engineer, "jump").0, 400);
    let steps = ["begin", "pose", "pose", "pose"];
    let answers = steps.map(|name| step(&page.engineer, name).1);
    let poses = answers
        .each_ref()
        .map(|answer| answer["poses"].as_u64().unwrap());
    assert_eq!(poses, [0, 1, 2, 2]);
    assert_eq!(answers[3]["done"], false);
    assert_eq!(answers[3]["message"], "the arm moves");
    for (name, done) in steps.into_iter().zip([true, true, true, false]) {
        let record = records.recv_timeout(PATIENCE).unwrap().message;
        let said = (
            record.action.as_str(),
            record.argument.as_str(),
            record.done,
        );
        assert_eq!(said, ("calibrate", name, done));
        assert_eq!(record.who.as_str(), "ben");
    }
    assert_eq!(page.get_json("/api/about")["can_calibrate"], true);
}

#[test]
fn other_sites_and_rebound_names_are_refused() {
    let page = Page::start(|config| config.hosts = vec!["robot.local".to_owned()]);
    let (_stop, stops) = page.cell(queries::CONTROL_STOP);
    let json = "Content-Type: application/json";
    let stop = br#"{"action":"stop"}"#;
    let command = |head: &[&str]| page.ask("POST", "/api/command", head, stop).0;
    for (head, status) in [
        (&[json, "Host: evil.example"][..], 421),
        (&[json, "Host: evil.example:8780"], 421),
        (&[json, "Host: "], 421),
        (&[json, "Origin: http://evil.example"], 403),
        (&[json, "Origin: null"], 403),
        (&[json, "Sec-Fetch-Site: cross-site"], 403),
        // What a form of another site can send without asking first.
        (&["Content-Type: text/plain"], 415),
        (&["Content-Type: application/x-www-form-urlencoded"], 415),
        (&[], 415),
    ] {
        assert_eq!(command(head), status, "{head:?}");
    }
    assert!(stops.try_recv().is_err(), "nothing reached the cell");
    let own = format!("Origin: http://{}", page.address);
    assert_eq!(command(&[json, &own, "Sec-Fetch-Site: same-origin"]), 200);
    let named = ["Host: robot.local:8780", "Origin: http://robot.local:8780"];
    assert_eq!(command(&[json, named[0], named[1]]), 200);
    // Another site can neither read.
    let read = |head: &[&str]| page.ask("GET", "/api/about", head, b"").0;
    assert_eq!(read(&["Host: evil.example"]), 421);
    assert_eq!(read(&["Sec-Fetch-Site: cross-site"]), 403);
    assert_eq!(read(&["Sec-Fetch-Site: same-origin"]), 200);
}

#[test]
fn hostile_bodies_are_refused_and_the_page_goes_on() {
    let page = Page::start(|_| {});
    let json = ["Content-Type: application/json"];
    let huge = vec![b'['; 3 << 20];
    for path in ["/api/command", "/api/here", "/api/report"] {
        let status = page.ask("POST", path, &json, &huge).0;
        // The connection may be closed before the answer is read.
        assert!(matches!(status, 413 | 0), "{path}: {status}");
        for body in [
            &b""[..],
            b"NaN",
            b"{\"action\":NaN}",
            b"{\"page\":1e999}",
            b"\xff\xfe",
            b"[[[[[[[[",
            b"{\"action\":\"start\",\"task\":\"wipe.toml\",\"more\":1}",
        ] {
            let status = page.ask("POST", path, &json, body).0;
            assert_eq!(status, 400, "{path}: {}", String::from_utf8_lossy(body));
        }
    }
    let long = json!({ "page": "x".repeat(1000) });
    assert_eq!(page.post("/api/here", &page.operator, &long).0, 400);
    for query in ["epoch=NaN", "revision=-1", "epoch=99999999999999999999999"] {
        assert_eq!(page.get(&format!("/api/dose?{query}")).0, 400, "{query}");
    }
    assert_eq!(page.get("/api/about").0, 200);
}

#[test]
fn the_dose_is_judged_by_the_band_of_the_task_that_runs() {
    let page = Page::start(|config| config.dose_band = Some([1.0, 2.0]));
    let region = include_str!("../../../deploy/tasks/region.toml");
    let shown =
        move |_: &str, _: Request| answer::done_with("region", &json!({ "task_toml": region }));
    let _show = page.bus.answer(queries::CONTROL_SHOW, shown).unwrap();
    assert_eq!(page.get_json("/api/dose")["band"], json!([1.0, 2.0]));
    let controls = page.bus.publisher(&topics::CONTROL_STATE).unwrap();
    let until = Instant::now() + PATIENCE;
    for cycle in 0.. {
        controls.publish(&states(cycle, cycle as f64 * 0.01, 0.0).1);
        if page.get_json("/api/dose")["band"] == json!([0.8, 8.0]) {
            return;
        }
        assert!(Instant::now() < until);
    }
}

/// Browsers that never read hold up neither the cell nor a browser that reads.
#[test]
fn readers_that_sleep_hold_nothing_up() {
    let page = Page::start(|_| {});
    let asleep: Vec<TcpStream> = (0..8)
        .map(|_| {
            let mut stream = TcpStream::connect(page.address).unwrap();
            let head = format!("GET /api/stream HTTP/1.1\r\nHost: {}\r\n\r\n", page.address);
            stream.write_all(head.as_bytes()).unwrap();
            stream
        })
        .collect();
    let numbers: Vec<u64> = page
        .stream()
        .take(40)
        .map(|s| s["number"].as_u64().unwrap())
        .collect();
    assert!(
        numbers.windows(2).all(|pair| pair[0] < pair[1]),
        "{numbers:?}"
    );
    // Their number is bounded.
    let many: Vec<TcpStream> = (0..shared::STREAMS_MAX)
        .map(|_| {
            let mut stream = TcpStream::connect(page.address).unwrap();
            let head = format!("GET /api/stream HTTP/1.1\r\nHost: {}\r\n\r\n", page.address);
            stream.write_all(head.as_bytes()).unwrap();
            let mut first = [0; 12];
            stream.read_exact(&mut first).unwrap();
            stream
        })
        .collect();
    assert_eq!(page.get("/api/stream").0, 503);
    assert_eq!(page.get("/api/about").0, 200);
    drop((asleep, many));
}

#[test]
fn the_loss_of_every_page_that_commands_is_answered_as_the_cell_file_says() {
    let page = Page::start(|config| {
        config.on_lost_page = OnLostPage::Pause;
        // Longer than a busy machine makes a page wait.
        config.lost_page_after = Duration::from_millis(1500);
    });
    let (_task, tasks) = page.cell(queries::CONTROL_TASK);
    let records = page.bus.subscribe(&topics::OPERATOR_COMMAND, 16).unwrap();
    let arms = page.bus.publisher(&topics::ARM_STATE).unwrap();
    let controls = page.bus.publisher(&topics::CONTROL_STATE).unwrap();
    let publish = |cycle: u64| {
        let (arm, control) = states(cycle, cycle as f64 * 0.01, 0.0);
        arms.publish(&arm);
        controls.publish(&control);
        std::thread::sleep(Duration::from_millis(10));
    };
    let start = json!({ "action": "start", "task": "wipe.toml" });
    page.post("/api/command", &page.operator, &start);
    assert_eq!(tasks.recv_timeout(PATIENCE).unwrap().action, "start");
    let there = 250;
    for cycle in 0..there {
        publish(cycle);
        if cycle % 5 == 0 {
            page.post("/api/here", &page.operator, &json!({ "page": "a" }));
        }
    }
    assert!(tasks.try_recv().is_err(), "the page is there");
    let until = Instant::now() + PATIENCE;
    let mut cycle = there;
    let lost = loop {
        // A page that only reads does not count.
        page.post("/api/here", "", &json!({ "page": "b" }));
        publish(cycle);
        cycle += 1;
        if let Ok(request) = tasks.try_recv() {
            break request;
        }
        assert!(Instant::now() < until);
    };
    assert_eq!(lost.action, "pause");
    let who: Vec<String> = std::iter::from_fn(|| records.recv_timeout(Duration::from_secs(2)))
        .take(2)
        .map(|record| record.message.who.to_string())
        .collect();
    assert_eq!(who, ["anna", "lost page"]);
}

#[test]
fn an_address_for_others_needs_tokens() {
    let cell = CellConfig::default_cell();
    let model = ModelData::builtin(&cell.robot.model).unwrap();
    let mut open = cell.clone();
    open.ui.address = "0.0.0.0:0".parse().unwrap();
    let said = Config::from_cell(&open, &model).unwrap_err().to_string();
    assert!(said.contains("0.0.0.0") && said.contains("token"), "{said}");
    open.ui.insecure = true;
    assert!(Config::from_cell(&open, &model).is_err());
}

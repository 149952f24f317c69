//! `tangent calibrate payload` with a payload that is wrong in the cell file.

use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::process::Output;

use serde_json::Value;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::{json, number, stderr, wait_for};
use crate::terminal::Terminal;
use tangent_live::live_beside_others;

/// Wrist joint positions, rad: turned up, down and to all sides, well above the surface; the first
/// again at the end.
const POSES: [[f64; 3]; 9] = [
    [-1.57, -1.57, 0.0],
    [0.0, -1.57, 0.0],
    [1.57, -1.57, 0.5],
    [-1.57, 0.0, 0.0],
    [-1.57, -3.1, 0.0],
    [-0.7, -0.6, 1.0],
    [-2.4, -2.3, -1.0],
    [-3.1, -1.57, 0.0],
    [-1.57, -1.57, 0.0],
];

/// Moves the simulated arm as its pendant would: with another program in place of ours. Waits for
/// ours first: the bridge sends it again after every move, and would replace a program that arrived
/// at that moment.
fn move_to(cell: &Cell, observer: &Observer, wrist: [f64; 3]) {
    wait_for("the bridge's program runs", PATIENCE, || {
        observer.arm().filter(|arm| arm.ready)
    });
    let [a, b, c] = wrist;
    let q = [3.1, -1.9, 1.4, a, b, c];
    let program = format!("def go():\n  movej({q:?}, a=8, v=3)\nend\n");
    let port = 30_002 + cell.port_offset();
    let mut pendant = TcpStream::connect(("127.0.0.1", port)).unwrap();
    pendant.write_all(program.as_bytes()).unwrap();
    wait_for("the arm stands there", PATIENCE, || {
        let arm = observer.arm()?;
        let there = arm
            .q
            .iter()
            .zip(q)
            .all(|(is, wanted)| (is - wanted).abs() < 1e-3);
        let still = arm.qd.iter().all(|v| v.abs() < 1e-4);
        (there && still).then_some(())
    });
}

/// A person at the terminal, who presses Enter at every pose.
struct Person {
    terminal: Terminal,
    asked: usize,
}

impl Person {
    fn start(cell: &Cell, args: &[&str]) -> Self {
        Self {
            terminal: Terminal::start(cell, &["calibrate", "payload"], args),
            asked: 0,
        }
    }

    /// Waits for the next question.
    fn asked(&mut self) {
        self.asked += 1;
        wait_for("the next pose is asked for", PATIENCE, || {
            let said = self.terminal.said();
            (said.matches("then press Enter").count() >= self.asked).then_some(())
        });
    }

    fn enter(&mut self) {
        self.terminal.enter("");
    }

    fn ended(self) -> (Output, String) {
        self.terminal.ended()
    }
}

/// The truth is the cell file's 0.3 kg at 50 mm, and the 20 g and (1, -1, 2) mm that the scenario
/// adds.
fn assert_true(found: &Value, what: &str) {
    let mass = number(found, "/mass_kg");
    let sd = number(found, "/mass_sd_kg");
    assert!((mass - 0.32).abs() < 0.01, "{what}: {mass} kg");
    assert!(sd < 0.01, "{what}: ± {sd} kg");
    for (axis, truth) in [0.001, -0.001, 0.052].into_iter().enumerate() {
        let com = number(found, &format!("/com_in_sensor_m/{axis}"));
        assert!((com - truth).abs() < 0.003, "{what}: axis {axis}: {com} m");
    }
    assert!(number(found, "/mounting_error_deg") < 3.0, "{found}");
    assert!(number(found, "/residual_force_rms_n") < 0.3, "{found}");
    assert!(found["drift"].is_array(), "{found}");
}

#[test]
fn the_payload_is_found_live_and_from_the_recording() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&["router simulator netft rtde recorder"]);
        let observer = Observer::join(&cell);
        move_to(&cell, &observer, POSES[0]);

        let mut person = Person::start(&cell, &["--poses", "9"]);
        for pose in POSES {
            person.asked();
            move_to(&cell, &observer, pose);
            person.enter();
        }
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(0), "{said}");
        let found = json(&output);
        assert_eq!(found["poses"], 9);
        assert_true(&found, "live");

        // Six identical poses are refused, with the reason.
        let mut person = Person::start(&cell, &["--poses", "6"]);
        for _ in 0..6 {
            person.asked();
            person.enter();
        }
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(1));
        assert!(said.contains("too much alike"), "{said}");

        let name = "router simulator netft rtde recorder";
        assert_eq!(cell.process(name).terminate(PATIENCE), Some(0));
        let file = cell.files().remove(0);
        let args = ["calibrate", "payload", "--from", file.to_str().unwrap()];
        assert_true(&cell.cli_json(&args, 0), "recorded");
        let words = cell.cli(&args);
        let words = String::from_utf8_lossy(&words.stdout).into_owned();
        for line in ["[tool]", "mass_kg = 0.3", "com_in_sensor_m = [0.0"] {
            assert!(words.contains(line), "no {line} in {words}");
        }
        let tool: toml::Table = words.parse().expect("lines for the cell file");
        assert!(tool["tool"]["mass_kg"].is_float());
        nothing_to_find(&cell, &file);
    });
}

fn nothing_to_find(cell: &Cell, file: &Path) {
    let missing = cell.cli(&["calibrate", "payload", "--from", "no_such.mcap"]);
    assert_eq!(missing.status.code(), Some(2));
    assert!(stderr(&missing).contains("no_such.mcap"));
    let both = [
        "calibrate",
        "payload",
        "--poses",
        "8",
        "--from",
        file.to_str().unwrap(),
    ];
    assert_eq!(cell.cli(&both).status.code(), Some(2));
}

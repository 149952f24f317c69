//! `tangent scan` on a cell of processes with a depth camera: what it sees becomes a task, and what
//! it has seen outlives the camera.

use nalgebra::Vector3;
use serde_json::Value;
use tangent_schemas::tangent::ArmState;
use tangent_simulation::{Surface, SurfaceConfig};

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::{json, root, run, stderr, wait_for};
use crate::terminal::Terminal;
use tangent_live::live;

const TOGETHER: &str = "router simulator franka";

/// The wave that the simulated arm stands above, without the slab around it.
fn wave() -> Surface {
    let text = std::fs::read_to_string(root().join("scenarios/karacan/karacan_depth.toml"));
    let scenario: toml::Table = text.unwrap().parse().unwrap();
    let surface = scenario["plant"]["surface"].clone();
    let config: SurfaceConfig = surface.try_into().unwrap();
    Surface::new(&config.shape, &config.pose()).unwrap()
}

/// Points of a file that `tangent scan` has written.
fn points(file: &str) -> Vec<Vector3<f64>> {
    let bytes = std::fs::read(file).unwrap();
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let (numbers, rest) = bytes[at..].as_chunks::<4>();
    assert!(rest.is_empty());
    let numbers: Vec<f64> = numbers
        .iter()
        .map(|b| f32::from_le_bytes(*b).into())
        .collect();
    numbers.chunks(3).map(Vector3::from_column_slice).collect()
}

fn hears(terminal: &Terminal, words: &str) {
    wait_for(words, PATIENCE, || {
        terminal.said().contains(words).then_some(())
    });
}

fn arm(observer: &Observer) -> ArmState {
    wait_for("the arm", PATIENCE, || observer.arm())
}

fn count(written: &Value, key: &str) -> u64 {
    written[key].as_u64().unwrap()
}

#[test]
fn a_region_of_the_cameras_own_scan_becomes_a_task() {
    live(|| {
        let mut cell = Cell::with_franka();
        cell.start_all(&[TOGETHER, "camera"]);
        let observer = Observer::join(&cell);
        arm(&observer);
        let at = |name: &str| cell.file().with_file_name(name).display().to_string();
        let (file, task) = (at("wave.ply"), at("lid.toml"));

        // A folder that does not exist is told before anything is looked at.
        let refused = cell.cli(&["scan", "--output", "nowhere/wave.ply"]);
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains("no folder nowhere"));

        let mut person = Terminal::start(&cell, &["scan"], &["wave", "--output", &file]);
        hears(&person, "images kept of");
        person.enter("");
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(0), "{said}");
        let written = json(&output);
        assert!(count(&written, "images") > 10, "{written}");
        assert!(count(&written, "points") > 50_000, "{written}");
        assert!(written["area_cm2"].as_f64().unwrap() > 200.0, "{written}");
        assert_eq!(written["lost"].as_array().unwrap().len(), 0, "{written}");
        // An existing file is kept.
        let again = cell.cli(&["scan", "wave", "--duration-s", "1", "--output", &file]);
        assert_eq!(again.status.code(), Some(2));

        // The points lie on the wave: those over its inner part, without the tool and the table.
        let wave = wave();
        let inner = |p: &&Vector3<f64>| (p.x - 0.55).abs() < 0.04 && (p.y - 0.05).abs() < 0.1;
        let (mut squares, mut seen) = (0.0, 0);
        let scanned = points(&file);
        for point in scanned.iter().filter(inner) {
            squares += wave.query(point).distance.powi(2);
            seen += 1;
        }
        let rms_m = (squares / f64::from(seen)).sqrt();
        assert!(seen > 1000 && rms_m < 0.003, "{seen} points, {rms_m} m RMS");

        let outline = "0.52,0.02,0.2:0.58,0.02,0.2:0.58,0.08,0.2:0.52,0.08,0.2";
        let made = run(&[
            "region",
            &file,
            "--outline",
            outline,
            "--approach",
            "0,0,-1",
            "--radius-m",
            "0.008",
            "--edge-pass",
            "--edge-force-n",
            "3",
            "--edge-speed",
            "0.01",
            "--no-start",
            "--output",
            &task,
            "--json",
        ]);
        assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
        let made = json(&made);
        assert!(count(&made, "strokes") > 4 && count(&made, "edge_strokes") == 1);
        let area_cm2 = made["area_cm2"].as_f64().unwrap();
        assert!((34.0..=42.0).contains(&area_cm2), "{area_cm2}");
        let checked = run(&["check", &task]);
        let said = String::from_utf8_lossy(&checked.stdout).into_owned() + &stderr(&checked);
        assert_eq!(checked.status.code(), Some(0), "{said}");
        cell.assert_running(&[TOGETHER, "camera"]);
    });
}

#[test]
fn a_camera_that_dies_in_the_middle_leaves_what_it_has_seen() {
    live(|| {
        let mut cell = Cell::with_franka();
        cell.start_all(&[TOGETHER]);
        let observer = Observer::join(&cell);
        arm(&observer);
        let file = cell.file().with_file_name("wave.ply");
        let file = file.to_str().unwrap();
        // Without a camera, nothing is written.
        let blind = cell.cli(&["scan", "--duration-s", "3", "--output", file]);
        let said = stderr(&blind);
        assert_eq!(blind.status.code(), Some(1), "{said}");
        assert!(
            said.contains("no camera/depth: do the service `camera`"),
            "{said}"
        );
        assert!(!std::path::Path::new(file).exists());

        let mut person = Terminal::start(&cell, &["scan"], &["wave", "--output", file]);
        hears(&person, "no camera/depth");
        cell.start("camera");
        hears(&person, "camera and arm are there");
        cell.process("camera").kill();
        wait_for("the silence is told", PATIENCE, || {
            (person.said().matches("no camera/depth").count() > 1).then_some(())
        });
        person.enter("");
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(3), "{said}");
        let written = json(&output);
        assert!(count(&written, "points") > 10_000, "{written}");
        let lost = written["lost"][0].as_str().unwrap();
        assert!(lost.contains("camera/depth was silent"), "{lost}");
        assert!(!points(file).is_empty());
    });
}

//! `tangent scan` on a cell of processes with a depth camera: a part of what it sees is wiped, and
//! what it has seen outlives the camera.

use std::path::Path;
use std::time::Duration;

use nalgebra::Vector3;
use serde_json::Value;
use tangent_runtime::clock::now_ns;
use tangent_schemas::tangent::ArmState;
use tangent_simulation::{Surface, SurfaceConfig};

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::{json, root, stderr, wait_for};
use crate::terminal::Terminal;
use tangent_live::live_in_half;

const TOGETHER: &str = "router simulator rtde netft controller";

/// The pipe that the arm stands above.
fn pipe() -> Surface {
    let text = std::fs::read_to_string(root().join("scenarios/pipe_scan.toml"));
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

/// Longest time of the whole task: the way to its start pose is slow.
const WIPED_WITHIN: Duration = Duration::from_secs(120);

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

/// Corners of the region that is wiped, x and y in the base, m.
const REGION: [[f64; 2]; 2] = [[0.42, -0.12], [0.46, -0.08]];
/// Distance of the strokes from its edges, the radius of the pad, m.
const MARGIN_M: f64 = 0.01;

#[test]
fn a_region_of_the_cameras_own_scan_is_wiped() {
    live_in_half(|| {
        let mut cell = Cell::with_depth_camera();
        cell.start_all(&[TOGETHER, "camera", "estimator"]);
        let observer = Observer::join(&cell);
        arm(&observer);
        let at = |name: &str| cell.file().with_file_name(name).display().to_string();
        let (file, task) = (at("pipe.ply"), at("lid.toml"));

        // A folder that does not exist is told before anything is looked at.
        let refused = cell.cli(&["scan", "--output", "nowhere/pipe.ply"]);
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains("no folder nowhere"));

        let mut person = Terminal::start(&cell, &["scan"], &["pipe", "--output", &file]);
        hears(&person, "images kept of");
        person.enter("");
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(0), "{said}");
        let written = json(&output);
        assert!(count(&written, "images") > 5, "{written}");
        assert!(count(&written, "points") > 50_000, "{written}");
        assert!(written["area_cm2"].as_f64().unwrap() > 200.0, "{written}");
        assert_eq!(written["lost"].as_array().unwrap().len(), 0, "{written}");
        // An existing file is kept.
        let again = cell.cli(&["scan", "pipe", "--duration-s", "1", "--output", &file]);
        assert_eq!(again.status.code(), Some(2));

        // The points lie on the pipe, without the tool: those around the region.
        let pipe = pipe();
        let [low, high] = REGION;
        let inner = |p: &&Vector3<f64>| {
            let within = |k: usize| p[k] > low[k] - 0.02 && p[k] < high[k] + 0.02;
            within(0) && within(1)
        };
        let (mut squares, mut seen) = (0.0, 0);
        let scanned = points(&file);
        for point in scanned.iter().filter(inner) {
            squares += pipe.query(point).distance.powi(2);
            seen += 1;
        }
        let rms_m = (squares / f64::from(seen)).sqrt();
        assert!(seen > 1000 && rms_m < 0.003, "{seen} points, {rms_m} m RMS");

        let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
        let corner = |[i, j]: [usize; 2]| format!("{},{},0.25", REGION[i][0], REGION[j][1]);
        let outline = corners.map(corner).join(":");
        let region = [
            "region",
            &file,
            "--outline",
            &outline,
            "--approach",
            "0,0,-1",
            "--edge-pass",
            "--edge-force-n",
            "3",
            "--edge-speed",
            "0.02",
            "--speed",
            "0.03",
            "--clearance-m",
            "0.01",
            "--output",
            &task,
        ];
        let made = cell.cli_json(&region, 0);
        assert!(count(&made, "strokes") > 2 && count(&made, "edge_strokes") == 1);
        let area_cm2 = made["area_cm2"].as_f64().unwrap();
        assert!((15.0..=20.0).contains(&area_cm2), "{area_cm2}");
        let checked = cell.cli(&["check", &task]);
        let said = String::from_utf8_lossy(&checked.stdout).into_owned() + &stderr(&checked);
        assert_eq!(checked.status.code(), Some(0), "{said}");

        let from_ns = now_ns();
        observer.wipe_within(WIPED_WITHIN, &cell, Path::new(&task));
        let truths = observer.truths(from_ns);
        let pressed = truths.iter().filter(|t| t.message.in_contact);
        let places: Vec<Vector3<f64>> = pressed
            .map(|t| Vector3::new(t.message.point.x, t.message.point.y, t.message.point.z))
            .collect();
        // Between the margins, which are as wide as the pad, the rows are 10 mm apart at most.
        let was_at = |x: f64, y: f64| places.iter().any(|p| (p.x - x).hypot(p.y - y) < 0.007);
        for i in 0..=8 {
            for j in 0..=8 {
                let [x, y] = [0, 1].map(|k| {
                    let share = f64::from([i, j][k]) / 8.0;
                    low[k] + MARGIN_M + (high[k] - low[k] - 2.0 * MARGIN_M) * share
                });
                assert!(was_at(x, y), "{x} {y} was left out");
            }
        }
        observer.pressed_at_most(20.0, from_ns);
        cell.assert_running(&[TOGETHER, "camera", "estimator"]);
    });
}

#[test]
fn a_camera_that_dies_in_the_middle_leaves_what_it_has_seen() {
    live_in_half(|| {
        let mut cell = Cell::with_depth_camera();
        cell.start_all(&[TOGETHER]);
        let observer = Observer::join(&cell);
        arm(&observer);
        let file = cell.file().with_file_name("pipe.ply");
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

        let mut person = Terminal::start(&cell, &["scan"], &["pipe", "--output", file]);
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

//! Errors in the user's input: each is reported with its name, the value, what is allowed, and exit
//! code 2.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::net::TcpListener;
use std::process::Stdio;

use common::{json, port_offset, root, run, stderr, tangent};

/// Runs the program, and checks that the exit code is 2 and the message contains all these words.
fn refused(args: &[&str], words: &[&str]) {
    let output = run(args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{args:?}: no {word:?} in: {said}");
    }
}

/// `tangent ... | head -1`: output that is closed early is no failure.
#[test]
fn a_reader_that_leaves() {
    let mut child = tangent()
        .args(["model", "show", "ur5"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(stderr(&output), "");
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn scenarios() {
    refused(&["evaluate", "pipes"], &["pipes", "pipe_ideal"]);
    refused(
        &["evaluate", "pipe_ideal", "--estimator", "magic"],
        &["magic", "reactive"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--controller", "magic"],
        &["magic", "paper"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "plant.nothing=1"],
        &["nothing"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "duration_s=-1"],
        &["duration_s", "-1"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "duration_s"],
        &["duration_s"],
    );
    refused(&["evaluate", "pipe_ideal", "--seed", "x"], &["seed", "x"]);
}

#[test]
fn cell_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let good = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let cases = [
        ("[robot]", "[robot]\nspeeed = 1", &["speeed"][..]),
        (
            "rate_hz = 0.0                       # records",
            "rate_hz = 9000.0 # records",
            &["sensor.rate_hz", "9000"],
        ),
        (
            "rtde_port = 30004",
            "rtde_port = \"thirty\"",
            &["rtde_port"],
        ),
        ("mass_kg = 0.3", "mass_kg = -0.3", &["tool.mass_kg", "-0.3"]),
        (
            "register_base = 24",
            "register_base = 47",
            &["register_base", "47"],
        ),
        ("[tool]", "[tol]", &["tol"]),
        ("model = \"ur5\"", "model = \"ur55\"", &["ur55"]),
    ];
    for (from, to, words) in cases {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from} is not in deploy/cell.toml");
        fs::write(&path, text).unwrap();
        let file = path.to_str().unwrap();
        refused(
            &["run", "rtde", "--cell", file],
            &[&["cell.toml"], words].concat(),
        );
    }
    refused(
        &["status", "--cell", "/nowhere/cell.toml"],
        &["/nowhere/cell.toml"],
    );
}

#[test]
fn task_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("task.toml");
    let good = fs::read_to_string(root().join("deploy/tasks/raster.toml")).unwrap();
    for (from, to, word) in [
        ("reference_n = ", "reference_n = -", "force.reference_n"),
        ("[path]", "[path]\nspiral = true", "spiral"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from} is not in raster.toml");
        fs::write(&path, text).unwrap();
        let file = path.to_str().unwrap();
        refused(&["task", "start", file], &["task.toml", word]);
    }
    refused(&["task", "start", "/nowhere.toml"], &["/nowhere.toml"]);
}

/// Every file that ships passes `tangent check`, and is recognised for what it is.
#[test]
fn check_passes_what_ships() {
    let folders = [
        ("deploy", "cell"),
        ("deploy/tasks", "task"),
        ("scenarios", "scenario"),
        ("scenarios/karacan", "scenario"),
        ("scenarios/lippiello", "scenario"),
        ("core/mechanics/models", "model"),
    ];
    let mut files = Vec::new();
    for (folder, kind) in folders {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "toml") {
                files.push((path.to_str().unwrap().to_owned(), kind));
            }
        }
    }
    assert!(files.len() > 30, "only {} files", files.len());
    let mut args = vec!["check", "--json"];
    args.extend(files.iter().map(|(file, _)| file.as_str()));
    let output = run(&args);
    let found = json(&output);
    for ((file, kind), row) in files.iter().zip(found["files"].as_array().unwrap()) {
        assert_eq!(row["file"], *file);
        assert_eq!(row["kind"], *kind, "{row}");
        assert_eq!(row["good"], true, "{row}");
    }
    assert_eq!(output.status.code(), Some(0));
    // Each task is checked on a cell that runs it, from the start of the cell's scenario.
    for (task, cell) in [
        ("raster", "cell.toml"),
        ("circle", "cell.toml"),
        ("line", "cell.toml"),
        ("waypoints", "cell.toml"),
        ("object_circle", "cell.lippiello.toml"),
        ("loops", "cell.karacan.toml"),
    ] {
        let (task, cell) = (
            format!("deploy/tasks/{task}.toml"),
            format!("deploy/{cell}"),
        );
        let output = run(&["check", &task, "--cell", &cell]);
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    }
}

/// The output as text.
fn said(output: &std::process::Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        stderr(output)
    )
}

/// Wrong files of each kind: file, key, value, what is allowed or meant, and exit code 2, without a
/// cell or a network.
#[test]
fn check_refuses_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let cases: &[(&str, &str, &str, &[&str])] = &[
        (
            "deploy/cell.toml",
            "model = \"ur5\"",
            "model = \"ur5d\"",
            &["ur5d", "did you mean `ur5", "ur5e"],
        ),
        (
            "deploy/cell.toml",
            "preset = \"default\"",
            "preset = \"papre\"",
            &["papre", "`paper`", "default"],
        ),
        (
            "deploy/cell.toml",
            "force_max_n = 40.0",
            "force_max_n = -40.0",
            &["force_max_n", "-40"],
        ),
        (
            "deploy/cell.toml",
            "force_max_n = 40.0",
            "force_max = 40.0",
            &["force_max", "force_max_n"],
        ),
        (
            "deploy/cell.toml",
            "\"blend\"]",
            "\"blent\"]",
            &["blent", "`blend`", "reactive"],
        ),
        (
            "deploy/cell.toml",
            "rate_hz = 0.0                       # records",
            "rate_hz = 9000.0 # records",
            &["sensor.rate_hz", "9000", "7000"],
        ),
        (
            "deploy/cell.toml",
            "name = \"cell1\"",
            "name = \"cell 1\"",
            &["cell.name", "cell 1"],
        ),
        (
            "deploy/cell.toml",
            "kind = \"unknown\"",
            "kind = \"flt\"\nradius_m = 0.01",
            &["tool.tip.kind", "flt", "`flat`", "ring", "line"],
        ),
        (
            "deploy/cell.karacan.toml",
            "radius_m = 0.015",
            "radius_m = 15.0",
            &["tool.tip.radius_m", "15", "0.5 m"],
        ),
        (
            "deploy/cell.toml",
            "kind = \"unknown\"",
            "kind = \"round\"",
            &["line", "tool.tip.radius_m", "nothing", "metres"],
        ),
        (
            "deploy/cell.real.toml",
            "address = \"192.168.1.10\"",
            "address = \"192.168.1.10:30004\"",
            &["robot.address", "192.168.1.10:30004", "robot.port_offset"],
        ),
        (
            "deploy/cell.real.toml",
            "address = \"192.168.1.1\"",
            "address = \"http://192.168.1.1\"",
            &["sensor.address", "http://192.168.1.1", "a scheme"],
        ),
        (
            "deploy/cell.toml",
            "listen = [\"tcp/127.0.0.1:7447\"]",
            "listen = [\"tcp/0.0.0.0:7447\"]",
            &["zenoh.listen", "tcp/0.0.0.0:7447", "insecure = true"],
        ),
        ("deploy/cell.toml", "[robot]", "[robot", &["line"]),
        (
            "deploy/cell.franka.toml",
            "law = \"unified_force_impedance\"",
            "law = \"hybrid_admittance\"",
            &["panda", "7 joints"],
        ),
        (
            "deploy/cell.franka.toml",
            "torque_share = 0.8",
            "torque_share = 8.0",
            &["torque_share", "8"],
        ),
        (
            "deploy/cell.lippiello.toml",
            "viscous_nm_s_per_rad",
            "viscous_nms_per_rad",
            &["viscous_nms_per_rad"],
        ),
        (
            "deploy/cell.lippiello.toml",
            "lippiello_realistic.toml",
            "lippiello_ideal.toml",
            &["lippiello_ideal.toml"],
        ),
        (
            "deploy/cell.karacan.toml",
            "kind = \"depth\"",
            "kind = \"target\"",
            &["depth_normal", "depth camera"],
        ),
        (
            "deploy/tasks/raster.toml",
            "reference_n = 3.0",
            "reference_n = 300.0",
            &["force.reference_n", "300", "100"],
        ),
        (
            "deploy/tasks/raster.toml",
            "kind = \"raster\"",
            "kind = \"rastr\"",
            &["rastr", "raster"],
        ),
        (
            "deploy/tasks/raster.toml",
            "[\"blend\", \"reactive\"]",
            "[\"blent\", \"reactiv\", \"magic\"]",
            &["blent", "\"blend\"", "reactiv", "\"reactive\"", "magic"],
        ),
        (
            "deploy/tasks/raster.toml",
            "speed_m_per_s = 0.02\npause_s",
            "speed_m_per_s = 0.3\npause_s",
            &["path.speed_m_per_s", "0.3", "0.25"],
        ),
        (
            "deploy/tasks/circle.toml",
            "name = \"circle\"",
            "name = \"circle\"\ncontroller = \"defualt\"",
            &["defualt", "`default`", "paper"],
        ),
        (
            "scenarios/plane.toml",
            "controller = \"default\"",
            "controller = \"papr\"",
            &["papr", "`paper`"],
        ),
        (
            "scenarios/plane.toml",
            "robot = \"ur5\"",
            "robot = \"ur7\"",
            &["ur7", "ur5"],
        ),
        (
            "scenarios/plane.toml",
            "near_m = [0.4, -0.05, 0.1]",
            "near_m = [1.4, -0.05, 0.1]",
            &["start", "1.4"],
        ),
        (
            "scenarios/plane.toml",
            "length_m = 0.1",
            "length_m = 0.9",
            &["m along the path", "base axes"],
        ),
        (
            "scenarios/plane.toml",
            "reference_n = 3.0",
            "reference_n = 60.0",
            &["force.reference_n", "60 N", "40 N"],
        ),
        (
            "scenarios/karacan/karacan_wave.toml",
            "kind = \"visuo_tactile\"",
            "kind = \"visuo_tactil\"",
            &["karacan_wave.toml"],
        ),
        (
            "core/mechanics/models/ur5.toml",
            "dof = 6",
            "dof = 5",
            &["dof", "5"],
        ),
    ];
    for (file, from, to, words) in cases {
        let good = fs::read_to_string(root().join(file)).unwrap();
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from} is not in {file}");
        // Paths in a file are relative to its folder.
        let base = root().join(file);
        let scenarios = format!("\"{}/../scenarios", base.parent().unwrap().display());
        let text = text.replace("\"../scenarios", &scenarios);
        let path = folder.path().join(base.file_name().unwrap());
        fs::write(&path, text).unwrap();
        let output = run(&["check", path.to_str().unwrap()]);
        let said = said(&output);
        assert_eq!(output.status.code(), Some(2), "{file}, {to}: {said}");
        assert!(
            said.contains(path.to_str().unwrap()),
            "{file}, {to}: {said}"
        );
        for word in *words {
            assert!(said.contains(word), "{file}, {to}: no {word:?} in: {said}");
        }
    }
    for (text, word) in [
        ("colour = \"red\"", "colour"),
        ("a = = b", "TOML"),
        ("", "none"),
    ] {
        let path = folder.path().join("something.toml");
        fs::write(&path, text).unwrap();
        let output = run(&["check", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(said(&output).contains(word), "{text}: {}", said(&output));
    }
    let output = run(&["check", "/nowhere/task.toml"]);
    assert_eq!(output.status.code(), Some(2));
}

/// The shape of the tip is stated once, with the tool, and `check` shows who is told of it.
#[test]
fn check_shows_what_the_estimators_are_told_of_the_tip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let cell = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let notes = |text: String| {
        fs::write(&path, text).unwrap();
        let output = run(&["check", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let unknown = notes(cell.clone());
    assert!(unknown.contains("tool.tip: unknown"), "{unknown}");
    assert!(unknown.contains("state kind"), "{unknown}");
    let flat = notes(cell.replace("kind = \"unknown\"", "kind = \"flat\"\nradius_m = 0.008"));
    assert!(
        flat.contains("flat, radius 8 mm, for reactive, quadratic"),
        "{flat}"
    );
}

/// What may be meant but is seldom right is no refusal; `check` says what it means.
#[test]
fn check_notes_what_is_seldom_meant() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let cell = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let noted = |from: &str, to: &str| {
        let text = cell.replace(from, to);
        assert!(
            from.is_empty() || text != cell,
            "{from} is not in deploy/cell.toml"
        );
        fs::write(&path, text).unwrap();
        let output = run(&["check", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let (elsewhere, backwards) = (
        "another process must publish it",
        "points back to the flange",
    );
    let as_shipped = noted("", "");
    assert!(!as_shipped.contains(elsewhere) && !as_shipped.contains(backwards));
    let only_reactive = noted(
        "run = [\"reactive\", \"quadratic\", \"gaussian_process\", \"blend\"]",
        "run = [\"reactive\"]",
    );
    assert!(only_reactive.contains(elsewhere), "{only_reactive}");
    let turned = noted(
        "rotation_vector_rad = [0.0, 0.0, 0.0]\n",
        "rotation_vector_rad = [3.14159, 0.0, 0.0]\n",
    );
    assert!(turned.contains(backwards), "{turned}");
}

/// A task that its cell would refuse is refused offline, with the number, the limit and the place.
#[test]
fn check_holds_a_task_against_its_cell() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("task.toml");
    let raster = fs::read_to_string(root().join("deploy/tasks/raster.toml")).unwrap();
    let home = "--start=3.14,-1.57,1.57,-1.57,-1.57,0.0";
    for (from, to, words) in [
        (
            "reference_n = 3.0",
            "reference_n = 41.0",
            &["41 N", "40 N", "limits.force_max_n"][..],
        ),
        (
            "speed_m_per_s = 0.02\npause_s",
            "speed_m_per_s = 0.24\npause_s",
            &["path.speed_m_per_s", "0.24 m/s", "0.2250 m/s"],
        ),
        (
            "length_m = 0.2",
            "length_m = 1.2",
            &["m along the path", "m of its plane", "m in base axes"],
        ),
        (
            "direction = \"tool_z\"",
            "direction = [0.0, 0.0, 1.0]",
            &["approach.direction", "degrees"],
        ),
    ] {
        let text = raster.replacen(from, to, 1);
        assert_ne!(text, raster, "{from} is not in raster.toml");
        fs::write(&path, text).unwrap();
        let output = run(&[
            "check",
            path.to_str().unwrap(),
            "--cell",
            "deploy/cell.toml",
            home,
        ]);
        let said = said(&output);
        assert_eq!(output.status.code(), Some(2), "{to}: {said}");
        for word in words {
            assert!(said.contains(word), "{to}: no {word:?} in: {said}");
        }
    }
}

/// `up` refuses before it starts anything: no port is taken and nothing is recorded.
#[test]
fn up_refuses_a_task_and_a_preset_before_anything_runs() {
    let folder = tempfile::tempdir().unwrap();
    let task = folder.path().join("task.toml");
    let raster = fs::read_to_string(root().join("deploy/tasks/raster.toml")).unwrap();
    fs::write(
        &task,
        raster.replace("reference_n = 3.0", "reference_n = 41.0"),
    )
    .unwrap();
    let recordings = folder.path().join("recordings");
    let recordings = recordings.to_str().unwrap();
    let offset = port_offset().to_string();
    let common = ["--folder", recordings, "--port-offset", &offset];
    fn up<'a>(args: &[&'a str], common: &[&'a str]) -> Vec<&'a str> {
        [&["up"][..], args, common].concat()
    }
    let task = task.to_str().unwrap();
    refused(
        &up(&[task], &common),
        &["before anything moves", "41 N", "40 N"],
    );
    refused(
        &up(&["--set", "task.path.length_m=1.5"], &common),
        &["m along the path"],
    );
    refused(
        &up(&["--set", "task.estimators=[\"blent\"]"], &common),
        &["blent", "blend"],
    );
    refused(
        &up(&["--set", "controller=\"papr\""], &common),
        &["papr", "`paper`"],
    );
    let cell = folder.path().join("cell.toml");
    let text = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    fs::write(
        &cell,
        text.replace("preset = \"default\"", "preset = \"magic\""),
    )
    .unwrap();
    refused(
        &up(&["--cell", cell.to_str().unwrap()], &common),
        &["magic", "paper"],
    );
    assert!(!std::path::Path::new(recordings).exists());
}

#[test]
fn nobody_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let port = 7447 + port_offset();
    let text = fs::read_to_string(root().join("deploy/cell.toml"))
        .unwrap()
        .replace("127.0.0.1:7447", &format!("127.0.0.1:{port}"));
    fs::write(&path, text).unwrap();
    let output = run(&["status", "--cell", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("tangent up"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_busy_port_is_named() {
    let offset = port_offset();
    let _busy = TcpListener::bind(("127.0.0.1", 7447 + offset)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let output = run(&[
        "up",
        "--folder",
        folder.path().to_str().unwrap(),
        "--port-offset",
        &offset.to_string(),
    ]);
    assert!(!output.status.success());
    assert!(
        stderr(&output).contains(&(7447 + offset).to_string()),
        "{}",
        stderr(&output)
    );
}

#[test]
fn recordings() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.mcap");
    fs::write(&path, "hello").unwrap();
    for file in [path.to_str().unwrap(), "/nowhere.mcap"] {
        let output = run(&["report", file]);
        assert!(!output.status.success());
        assert!(stderr(&output).contains(file), "{}", stderr(&output));
    }
}

//! The command line itself: errors as JSON, completions, plain output in pipes, tables that fit a
//! terminal, new cells.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::io::Write;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use common::{Process, json, port_offset, root, run, stderr, tangent, wait_for};

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// With `--json`, whoever reads standard output gets an object in every case.
#[test]
fn errors_are_json_too() {
    for (args, code, words) in [
        (
            &["statsu", "--json"][..],
            2,
            &["statsu", "status", "evaluate"][..],
        ),
        (
            &["task", "strat", "--json"],
            2,
            &["strat", "start", "pause"],
        ),
        (
            &["evaluate", "pipe_idael", "--json"],
            2,
            &["pipe_idael", "`pipe_ideal`"],
        ),
        (&["status", "--jsno", "--json"], 2, &["--jsno", "--json"]),
        (
            &["status", "--cell", "/nowhere/cell.toml", "--json"],
            2,
            &["/nowhere/cell.toml"],
        ),
        (
            &["report", "/nowhere.mcap", "--json"],
            1,
            &["/nowhere.mcap"],
        ),
        (
            &[
                "evaluate",
                "plane",
                "--connect",
                "tcp/127.0.0.1:7447",
                "--json",
            ],
            2,
            &["--connect"],
        ),
        (
            &["status", "--connect", "localhost", "--json"],
            2,
            &["tcp/HOST:PORT"],
        ),
    ] {
        let output = run(args);
        assert_eq!(
            output.status.code(),
            Some(code),
            "{args:?}: {}",
            stderr(&output)
        );
        let error = json(&output);
        assert_eq!(error["exit_code"], code, "{args:?}");
        let said = error["error"].as_str().unwrap();
        for word in words {
            assert!(said.contains(word), "{args:?}: no {word:?} in: {said}");
        }
    }
}

/// A misspelt name of any kind is answered with the nearest one, and with all of them.
#[test]
fn misspelt_names_are_answered_with_the_nearest_and_the_list() {
    for (args, words) in [
        (&["statsu"][..], &["'status'", "there are: up, run"][..]),
        (&["task", "paus"], &["'pause'", "there are: start, pause"]),
        (
            &["up", "deploy/tasks/rastr.toml"],
            &["rastr", "`raster.toml`", "circle.toml", "tugal"],
        ),
        (&["up", "tugall"], &["tugall", "`tugal`", "lippiello"]),
        (
            &["task", "start", "deploy/tasks/lin.toml"],
            &["`line.toml`", "raster.toml"],
        ),
        (&["evaluate", "sphre"], &["`sphere`", "torus"]),
        (
            &["evaluate", "plane", "--estimator", "blent"],
            &["blent", "`blend`", "reactive"],
        ),
        (
            &["faults", "no_such_fault"],
            &["no_such_fault", "there are"],
        ),
        (&["model", "show", "ur5f"], &["ur5f", "`ur5", "panda"]),
        (&["run", "controler"], &["controler", "controller", "netft"]),
        (&["reproduce", "tugl"], &["tugl", "tugal", "karacan"]),
    ] {
        let output = run(args);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{args:?}: {}",
            stderr(&output)
        );
        let said = stderr(&output);
        for word in words {
            assert!(said.contains(word), "{args:?}: no {word:?} in: {said}");
        }
    }
}

/// No table is wider than a terminal of 80 columns, and nothing that is redirected has colours.
#[test]
fn redirected_output_is_plain_and_fits_eighty_columns() {
    for args in [
        &["evaluate", "list"][..],
        &["evaluate", "plane"],
        &["model", "list"],
        &["faults", "--list"],
        &[
            "evaluate",
            "karacan_wave",
            "--set",
            "task.path.duration_s=1.0",
        ],
    ] {
        let output = run(args);
        let text = stdout(&output);
        assert!(text.lines().count() > 1, "{args:?}: {}", stderr(&output));
        for line in text.lines() {
            assert!(line.chars().count() <= 80, "{args:?}: {line}");
            assert_eq!(line, line.trim_end(), "{args:?}");
        }
        assert!(
            !text.contains('\x1b') && !text.contains("-0.000"),
            "{args:?}: {text}"
        );
    }
    // A log line, whatever the terminal of the test is.
    let folder = tempfile::tempdir().unwrap();
    let cell = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let path = folder.path().join("cell.toml");
    fs::write(&path, cell.replace("127.0.0.1:7447", "127.0.0.1:9")).unwrap();
    let output = run(&["status", "--cell", path.to_str().unwrap()]);
    let said = stderr(&output);
    assert!(said.contains("waiting for a router"), "{said}");
    assert!(!said.contains('\x1b') && !said.contains(".rs:"), "{said}");
}

/// Every command that asks a cell under a wrong name is answered with the names of those that are
/// there.
#[test]
fn a_wrong_cell_name_is_answered_with_the_cells_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let port = (7447 + port_offset()).to_string();
    let text = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let file = |name: &str| {
        let text = text.replace("7447", &port).replacen("cell1", name, 1);
        let path = folder.path().join(format!("{name}.toml"));
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (there, wrong) = (file("cell1"), file("cell2"));
    let _router = Process::start("router", &["run", "router", "--cell", &there]);
    wait_for("the router", Duration::from_secs(60), || {
        let output = run(&["health", "router", "--cell", &there]);
        (output.status.code() == Some(0)).then_some(())
    });
    for args in [
        &["status"][..],
        &["task", "status"],
        &["task", "start", "deploy/tasks/raster.toml"],
        &[
            "task",
            "start",
            "deploy/tasks/raster.toml",
            "--wait-s",
            "0.2",
        ],
        &[
            "task",
            "start",
            "deploy/tasks/raster.toml",
            "--follow",
            "--wait-s",
            "0.2",
        ],
        &["topic", "list", "--seconds", "0.2"],
        &["topic", "echo", "arm/state", "--wait-s", "0.2"],
        &["topic", "hz", "arm/state"],
        &["estimator", "list"],
        &["estimator", "use", "blend"],
        &["param", "get"],
        &["param", "get", "rtde"],
        &["tare"],
        &["robot", "status"],
        &["health", "rtde", "--patience-s", "0.2"],
    ] {
        let output = run(&[args, &["--cell", &wrong, "--json"]].concat());
        let error = json(&output)["error"].as_str().unwrap_or("").to_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {output:?}");
        for word in ["`cell2`", "did you mean `cell1`", "there are: cell1"] {
            assert!(error.contains(word), "{args:?}: no {word:?} in: {error}");
        }
    }
}

/// What `check` says fits a terminal of 80 columns; a pipe gets each message as one line.
#[test]
fn messages_of_check_are_wrapped_on_a_terminal_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("task.toml");
    let text = fs::read_to_string(root().join("deploy/tasks/raster.toml")).unwrap();
    fs::write(
        &path,
        text.replace("reference_n = 3.0", "reference_n = 3e9"),
    )
    .unwrap();
    let output = run(&["check", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    let whole = stdout(&output);
    let message = whole.lines().find(|line| line.contains("reference_n"));
    let message = message.unwrap_or_else(|| panic!("{whole}")).trim();

    // `script` gives the command a terminal.
    let command = format!(
        "stty cols 80; {} check {}",
        env!("CARGO_BIN_EXE_tangent"),
        path.display()
    );
    let shown = Command::new("script")
        .args(["-qec", &command, "/dev/null"])
        .stdin(Stdio::null())
        .output();
    let Ok(shown) = shown else {
        eprintln!("skipped, because `script` (util-linux) is not here");
        return;
    };
    let shown = stdout(&shown).replace('\r', "");
    assert!(message.chars().count() > 78, "{message}");
    for line in shown.lines().filter(|line| !line.contains("/task.toml")) {
        assert!(line.chars().count() <= 80, "{line}");
    }
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words(&shown).contains(&words(message)), "{shown}");
}

/// The completions know every verb; bash accepts its script.
#[test]
fn completions_for_the_shells() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = run(&["completions", shell]);
        assert_eq!(output.status.code(), Some(0));
        let script = stdout(&output);
        for verb in ["topic", "estimator", "watch", "reproduce"] {
            assert!(script.contains(verb), "{shell}: no {verb}");
        }
        if shell == "bash" {
            bash_accepts(&script);
        }
    }
    assert_eq!(run(&["completions", "csh"]).status.code(), Some(2));
}

fn bash_accepts(script: &str) {
    let Ok(mut bash) = Command::new("bash").arg("-n").stdin(Stdio::piped()).spawn() else {
        eprintln!("skipped, because there is no bash");
        return;
    };
    bash.stdin
        .take()
        .unwrap()
        .write_all(script.as_bytes())
        .unwrap();
    assert!(bash.wait().unwrap().success());
}

/// `cell new` asks for what is not given, writes only what passes the check, and keeps files.
#[test]
fn a_new_cell_is_asked_for_and_checked() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kitchen.toml");
    let path = file.to_str().unwrap();
    let mut asked = tangent()
        .args(["cell", "new", path])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first model is misspelt, and asked for again.
    let answers = "kitchen\nur5f\nur5\n192.168.1.10\n\n\n";
    asked
        .stdin
        .take()
        .unwrap()
        .write_all(answers.as_bytes())
        .unwrap();
    let output = asked.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("did you mean `ur5`"),
        "{}",
        stderr(&output)
    );
    assert!(stdout(&output).contains("doctor --cell"));
    let text = fs::read_to_string(&file).unwrap();
    for line in [
        "name = \"kitchen\"",
        "model = \"ur5\"",
        "\"192.168.1.10\"",
        "\"192.168.1.1\"",
    ] {
        assert!(text.contains(line), "no {line} in:\n{text}");
    }
    assert_eq!(run(&["check", path]).status.code(), Some(0));

    // The file is kept, unless it is asked for.
    let given = [
        "cell",
        "new",
        path,
        "--yes",
        "--model",
        "ur5e",
        "--robot-address",
        "10.0.0.2",
        "--sensor",
        "ur",
    ];
    let kept = run(&given);
    assert_eq!(kept.status.code(), Some(2));
    assert!(stderr(&kept).contains("--force"), "{}", stderr(&kept));
    let written = run(&[&given[..], &["--force", "--json"]].concat());
    assert_eq!(json(&written)["good"], true);
    assert!(
        fs::read_to_string(&file)
            .unwrap()
            .contains("driver = \"ur\"")
    );

    for (args, word) in [
        (&["--yes", "--model", "ur5"][..], "--robot-address"),
        (
            &[
                "--yes",
                "--model",
                "panda",
                "--robot-address",
                "x",
                "--sensor",
                "netft",
            ],
            "joints",
        ),
        (
            &["--yes", "--model", "pnada", "--robot-address", "x"],
            "`panda`",
        ),
    ] {
        let other = folder.path().join("other.toml");
        let args = [&["cell", "new", other.to_str().unwrap()][..], args].concat();
        let output = run(&args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(
            stderr(&output).contains(word),
            "{args:?}: {}",
            stderr(&output)
        );
        assert!(!other.exists());
    }
}

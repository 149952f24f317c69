//! The compose file with real containers: it wipes, switches the estimator, survives a restart of
//! the router and a disconnected network cable, and stops in order.
//!
//! No image is pulled. The program under test, its libraries and the files that the Dockerfile
//! ships make up a substitute image, with the Dockerfile's settings. Without Docker the tests
//! report that and are skipped; TANGENT_REQUIRE_DOCKER makes that a failure.

#![allow(clippy::unwrap_used)]

mod common;
#[path = "docker/engine.rs"]
mod engine;
#[path = "docker/stand_in.rs"]
mod stand_in;

use std::time::Duration;

use serde_json::Value;

use common::{number, wait_for};
use engine::{Project, Said, engine};
use tangent_live::{alone, live};

/// Longest wait for a step that takes seconds on an idle machine.
const PATIENCE: Duration = Duration::from_secs(90);
/// The services of the simulated cell that keep running.
const SERVICES: [&str; 6] = [
    "router",
    "simulator",
    "netft",
    "robot",
    "estimator",
    "recorder",
];
/// A task that slides for minutes, so that the arm slides during every test step.
const LONG_TASK: &str = r#"
name = "long"
estimators = ["blend"]
[force]
reference_n = 3.0
[path]
kind = "line"
to_m = [0.04, 0.0]
strokes = 150
speed_m_per_s = 0.01
[timeouts]
task_s = 900.0
"#;

fn parsed(said: &Said) -> Value {
    serde_json::from_str(&said.stdout).unwrap_or_else(|e| panic!("{e}: {said:?}"))
}

/// Phase and estimator of the running task.
fn status(project: &Project) -> Option<(String, String)> {
    let said = project.tangent(&["task", "status", "--json"]);
    let value: Value = serde_json::from_str(&said.stdout).ok()?;
    let text = |key: &str| Some(value["data"][key].as_str()?.to_owned());
    Some((text("phase")?, text("estimator")?))
}

fn wait_for_phase(project: &Project, wanted: &[&str]) -> String {
    wait_for(&format!("phase {wanted:?}"), PATIENCE, || {
        status(project)
            .map(|(phase, _)| phase)
            .filter(|phase| wanted.contains(&phase.as_str()))
    })
}

/// Starts the long task and waits until it slides. A busy machine can starve the simulated cell
/// until the controller correctly reports a fault. The task is then started again from the start
/// pose of the scenario.
fn slide(project: &Project) {
    let task = project.file("long.toml", LONG_TASK);
    for attempt in 1..=4 {
        let mut start = vec!["task", "start", task.to_str().unwrap(), "--wait-s", "60"];
        if attempt > 1 {
            // The new arm hangs free, even if the previous arm was in contact.
            start.push("--clear");
        }
        let said = project.tangent(&start);
        if said.code == Some(0) && wait_for_phase(project, &["slide", "fault"]) == "slide" {
            return;
        }
        eprintln!(
            "attempt {attempt} did not slide: {said:?}, {:?}",
            project.tangent(&["task", "status"])
        );
        back_to_the_start(project);
    }
    panic!("no attempt came to slide");
}

/// Puts the simulated arm into the start pose of the scenario. A path begins where the tool is:
/// from where a fault has left the arm, it may not reach the path's end, and the start is refused.
fn back_to_the_start(project: &Project) {
    project.compose(&["restart", "simulator"]);
}

/// Switches the estimator as soon as it is allowed; false if the task has ended before.
fn use_estimator(project: &Project, name: &str) -> bool {
    wait_for(&format!("{name} in use"), PATIENCE, || {
        let said = project.tangent(&["estimator", "use", name]);
        // It is refused while the estimate is not fresh or disagrees; then it is requested again.
        if said.code == Some(0) {
            return Some(true);
        }
        let (phase, _) = status(project)?;
        (phase == "fault").then_some(false)
    })
}

#[test]
fn the_compose_file_runs_a_cell() {
    live(|| {
        let Some(engine) = engine() else { return };
        let project = Project::new(engine, false);
        project.up();
        it_wipes_and_records(&project);
        an_estimator_is_swapped(&project);
        the_router_restarts(&project);
        a_container_is_cut_off(&project);
        a_new_container_knows_that_the_tool_pressed(&project);
        it_stops_in_order(&project);
    });
}

/// The shipped Dockerfile, built for real on base images that are made from this host, and the
/// compose file run on the result.
#[test]
#[ignore = "compiles the whole program in a container, for about ten minutes: on request"]
fn the_shipped_dockerfile_builds_and_its_image_runs_a_cell() {
    // Not repeated on a disturbed machine: a build does not depend on time.
    let _places = alone();
    let Some(engine) = engine() else { return };
    let project = Project::without_image(engine, false);
    let [build, run] = ["build", "run"].map(|of| format!("tangent-test-base-of-{of}:stand-in"));
    if stand_in::build_image(&build, project.folder()).is_none() {
        return;
    }
    stand_in::run_image(&run, project.folder(), env!("CARGO_BIN_EXE_tangent"));
    project.build(&build, &run);
    project.up();
    it_wipes_and_records(&project);
    project.compose(&["down"]);
    engine::must(std::process::Command::new("docker").args(["rmi", "-f", &build, &run]));
}

/// The cell of the compose file under mutual TLS: it wipes, and an identity without a certificate
/// gets no answer.
#[test]
fn the_compose_files_run_a_secured_cell() {
    live(|| {
        let Some(engine) = engine() else { return };
        let project = Project::new(engine, true);
        project.up();
        it_wipes_and_records(&project);
        let viewer = project.tangent(&["task", "stop", "--identity", "viewer"]);
        assert_eq!(viewer.code, Some(1), "{viewer:?}");
        assert!(viewer.stderr.contains("no answer on"), "{viewer:?}");
        assert_eq!(project.tangent(&["task", "stop"]).code, Some(0));
        project.compose(&["down"]);
    });
}

fn it_wipes_and_records(project: &Project) {
    let mut code = wait_for("the task's end", 2 * PATIENCE, || {
        let state = &project.inspect("task")["State"];
        (state["Status"] == "exited").then(|| state["ExitCode"].as_i64())
    });
    for attempt in 1..4 {
        if code == Some(0) {
            break;
        }
        eprintln!("attempt {attempt} of the task ended with code {code:?}");
        back_to_the_start(project);
        // The new arm hangs free, even if the previous arm was in contact.
        let start = ["task", "start", "deploy/tasks/raster.toml", "--follow"];
        let said = project.inside(&[&start[..], &["--wait-s", "120", "--clear"]].concat());
        code = said.code.map(i64::from);
    }
    assert_eq!(code, Some(0), "the task never ended in order");
    // The recorder still writes: the end of the task is in its file a moment later.
    let figures = wait_for("the task's end in the recording", PATIENCE, || {
        let figures = parsed(&project.inside(&["report", "recordings", "--no-html", "--json"]));
        (figures["phase"] == "done").then_some(figures)
    });
    println!("{figures:#}");
    assert!(number(&figures, "/normal_error_deg/mean") < 2.0);
    assert!(number(&figures, "/force/rmse_n") < 0.5);
    assert!((number(&figures, "/force/mean_n") - 3.0).abs() < 0.3);
    assert!(number(&figures, "/path/rmse_m") < 5e-3);
    // Health of the services according to the engine, by `tangent health` inside each container.
    for service in SERVICES {
        wait_for(&format!("{service} healthy"), PATIENCE, || {
            (project.inspect(service)["State"]["Health"]["Status"] == "healthy").then_some(())
        });
    }
}

fn an_estimator_is_swapped(project: &Project) {
    let swapped = (1..=4).any(|attempt| {
        slide(project);
        let slid = swap_there_and_back(project);
        if !slid {
            eprintln!("attempt {attempt} to swap did not slide to its end");
        }
        slid
    });
    assert!(swapped, "no attempt slid through both swaps");
    // The state stays on the bus while it is read, so the service counts as running during a wait.
    assert_eq!(project.tangent(&["health", "estimator"]).code, Some(0));
}

/// Starts another estimator, uses it alone, and returns to the first. Returns whether the tool slid
/// all the time.
fn swap_there_and_back(project: &Project) -> bool {
    let activation = || {
        let said = parsed(&project.tangent(&["task", "status", "--json"]));
        said["data"]["activation"].as_u64().unwrap()
    };
    let slides = || status(project).is_some_and(|(phase, _)| phase == "slide");
    let task = activation();
    project.compose(&["up", "--no-build", "-d", "spare"]);
    let used = use_estimator(project, "quadratic");
    project.compose(&["stop", "estimator"]);
    let alone = used && slides();
    let list = parsed(&project.tangent(&["estimator", "list", "--json"]));
    let names: Vec<&str> = list["estimators"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|e| e["name"].as_str())
        .collect();
    assert_eq!(names, ["quadratic"]);
    project.compose(&["start", "estimator"]);
    let back = use_estimator(project, "blend");
    project.compose(&["stop", "spare"]);
    alone && back && slides() && activation() == task
}

fn started(project: &Project, service: &str) -> String {
    let state = &project.inspect(service)["State"]["StartedAt"];
    state.as_str().unwrap().to_owned()
}

fn the_router_restarts(project: &Project) {
    let others = &SERVICES[1..];
    let before: Vec<String> = others.iter().map(|s| started(project, s)).collect();
    project.compose(&["restart", "router"]);
    // The wrench came through the router: the arm retracts, and does not continue by itself.
    wait_for_phase(project, &["fault"]);
    for service in ["netft", "rtde", "estimator", "recorder", "simulator"] {
        wait_for(&format!("{service} is back"), PATIENCE, || {
            (project.tangent(&["health", service]).code == Some(0)).then_some(())
        });
    }
    let after: Vec<String> = others.iter().map(|s| started(project, s)).collect();
    assert_eq!(before, after, "a service was restarted with the router");
    slide(project);
}

fn a_container_is_cut_off(project: &Project) {
    project.cable("netft", false);
    wait_for_phase(project, &["fault"]);
    assert_eq!(project.tangent(&["health", "netft"]).code, Some(1));
    project.cable("netft", true);
    wait_for("netft is back", PATIENCE, || {
        (project.tangent(&["health", "netft"]).code == Some(0)).then_some(())
    });
    slide(project);
}

/// The container of the control loop is killed while the tool presses. The next one knows that from
/// the volume, and moves off before the tare.
fn a_new_container_knows_that_the_tool_pressed(project: &Project) {
    project.compose(&["kill", "robot"]);
    project.compose(&["rm", "-f", "robot"]);
    // As after a deployment: a new container that shares only the volume with the one before.
    project.compose(&["up", "--no-build", "-d", "robot"]);
    wait_for("the robot's container", PATIENCE, || {
        (project.tangent(&["health", "controller"]).code == Some(0)).then_some(())
    });
    let logs = project.compose(&["logs", "--no-color", "robot"]);
    assert!(logs.contains("did not end in free space"), "{logs}");
    slide(project);
}

fn it_stops_in_order(project: &Project) {
    assert_eq!(project.tangent(&["task", "stop"]).code, Some(0));
    wait_for_phase(project, &["done", "fault", "idle"]);
    // If it is stopped while the tool slides, the task's container retracts before the others end.
    project.compose(&["restart", "task"]);
    wait_for_phase(project, &["slide", "fault"]);
    project.compose(&["stop"]);
    for service in SERVICES {
        assert_eq!(
            project.inspect(service)["State"]["ExitCode"],
            0,
            "{service}"
        );
    }
    project.compose(&["down"]);
    // The volume still exists, and its newest recording is complete.
    let said = project.inside(&["report", "recordings", "--no-html", "--json"]);
    assert!(matches!(said.code, Some(0 | 3)), "{said:?}");
    assert!(!said.stderr.contains("the end is missing"), "{said:?}");
    let phase = parsed(&said)["phase"].clone();
    assert!(phase == "done" || phase == "fault", "{phase}");
}

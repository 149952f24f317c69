//! The files in `deploy/` and the compose file: each loads, and agrees with the others.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use tangent_runtime::CellConfig;

use common::root;

fn load(name: &str) -> CellConfig {
    CellConfig::load(&root().join("deploy").join(name)).unwrap()
}

/// Every cell file loads, and the one for containers equals the shipped one except for addresses,
/// rates and scheduling.
#[test]
fn cell_files() {
    let shipped = load("cell.toml");
    let mut compose = load("cell.compose.toml");
    assert_eq!(compose.robot.address, "simulator");
    assert_eq!(compose.sensor.address, "simulator");
    assert_eq!(compose.zenoh.connect, ["tcp/router:7447"]);
    assert!(compose.simulator.address.is_unspecified());
    // Insecure on purpose: open to the containers of its own network, and to loopback by a
    // published port.
    assert!(compose.zenoh.insecure && compose.zenoh.open_to_anybody().is_some());
    compose.robot.address.clone_from(&shipped.robot.address);
    compose.sensor.address.clone_from(&shipped.sensor.address);
    compose.simulator.address = shipped.simulator.address;
    assert_eq!(compose.cell, shipped.cell);
    assert_eq!(compose.robot, shipped.robot);
    // Messages that cross a router have lower rates.
    for (ours, theirs) in [
        (&mut compose.sensor.rate_hz, shipped.sensor.rate_hz),
        (&mut compose.sensor.raw_rate_hz, shipped.sensor.raw_rate_hz),
        (
            &mut compose.sensor.tool_rate_hz,
            shipped.sensor.tool_rate_hz,
        ),
    ] {
        *ours = theirs;
    }
    assert_eq!(compose.sensor, shipped.sensor);
    assert_eq!(compose.tool, shipped.tool);
    assert_eq!(compose.limits, shipped.limits);
    assert_eq!(compose.estimators, shipped.estimators);
    // Containers on a laptop get longer timeouts; no other setting of the law differs.
    let patience = compose.controller.settings.remove("patience").unwrap();
    assert_eq!(patience, toml::from_str("wrench_retract_s = 0.4").unwrap());
    assert_eq!(compose.controller, shipped.controller);
    assert_eq!(compose.recorder, shipped.recorder);
    assert_eq!(compose.simulator, shipped.simulator);
    // The viewers' server listens in its container; its port is published on loopback only.
    assert!(compose.foxglove.address.ip().is_unspecified() && compose.foxglove.insecure);
    let compose = fs::read_to_string(root().join("docker-compose.yml")).unwrap();
    let port = "\"127.0.0.1:${TANGENT_FOXGLOVE_PORT:-8765}:8765\"";
    assert!(compose.contains(port), "{port}");

    let franka = load("cell.karacan.toml");
    assert!(franka.simulator.scenario.is_some_and(|file| file.is_file()));
    let scanned = load("cell.scan.toml");
    assert!(scanned.camera.is_some());
    assert!(
        scanned
            .simulator
            .scenario
            .is_some_and(|file| file.is_file())
    );
    let object = load("cell.lippiello.toml");
    assert!(object.camera.is_some());
    assert!(object.simulator.scenario.is_some_and(|file| file.is_file()));

    let secured = fs::read_to_string(root().join("deploy/cell.compose.tls.toml")).unwrap();
    load("cell.compose.tls.toml");
    let mut secured: toml::Table = secured.parse().unwrap();
    let clear = fs::read_to_string(root().join("deploy/cell.compose.toml")).unwrap();
    let mut clear: toml::Table = clear.parse().unwrap();
    assert_ne!(secured.remove("zenoh"), clear.remove("zenoh"));
    assert_eq!(secured, clear);

    let real = load("cell.real.toml");
    assert!(!real.robot.power_on, "a real arm is powered by hand");
    assert!(real.realtime.enabled);
    assert_eq!(real.zenoh.open_to_anybody(), None);
    assert!(!real.zenoh.insecure);
    tangent_rtde::Config::from_cell(&real).unwrap();
}

/// The Franka's file shows every default of its own table, and configures a bridge; no other file
/// does.
#[test]
fn the_cell_of_a_franka() {
    let cell = load("cell.franka.toml");
    let shown = cell.robot.franka.clone().unwrap();
    assert_eq!(shown, tangent_runtime::config::FrankaConfig::default());
    let config = tangent_franka::Config::from_cell(&cell).unwrap();
    assert_eq!(config.port, tangent_franka::fci::PORT);
    assert!(tangent_rtde::Config::from_cell(&cell).is_err());
    assert!(tangent_franka::Config::from_cell(&load("cell.toml")).is_err());
}

/// The cell of an arm with its own sensor configures the bridge to read it, and the sensor service
/// to take it from there.
#[test]
fn the_cell_of_an_e_series_arm() {
    use tangent_netft::Driver;
    use tangent_schemas::topics::ARM_WRENCH;

    let cell = load("cell.ur5e.toml");
    assert!(!cell.robot.power_on, "a real arm is powered by hand");
    let bridge = tangent_rtde::Config::from_cell(&cell).unwrap();
    let own = bridge.bridge.wrench.unwrap();
    assert_eq!(Some(own.reading), cell.sensor.ur_reading());
    assert!(own.needed);
    let sensor = tangent_netft::Config::from_cell(&cell);
    assert!(
        matches!(&sensor.driver, Driver::Bus(source) if source.key == ARM_WRENCH.key()),
        "{:?}",
        sensor.driver
    );
    assert_eq!(sensor.rate_hz, 500.0);
    let shipped = tangent_rtde::Config::from_cell(&load("cell.toml")).unwrap();
    let compared = shipped.bridge.wrench.unwrap();
    assert!(!compared.needed, "only compared with the sensor");
}

/// `NAME` and its default in each `${NAME:-DEFAULT}` of the compose file, and what it is started
/// from.
#[test]
fn the_image_is_pinned_small_and_not_root() {
    let text = fs::read_to_string(root().join("Dockerfile")).unwrap();
    let bases: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("ARG "))
        .filter_map(|line| line.split_once('='))
        .map(|(_, base)| base)
        .collect();
    assert_eq!(bases.len(), 2, "{bases:?}");
    for base in bases {
        let tag = base.split_once(':').unwrap().1;
        assert!(
            tag != "latest" && tag.starts_with(char::is_numeric),
            "{base}"
        );
    }
    let (_, last) = text.rsplit_once("\nFROM ").unwrap();
    assert!(last.contains("\nUSER 10001:10001\n"));
    // Volumes are mounted where the image's user may write.
    let owned = last
        .lines()
        .find_map(|line| line.strip_prefix("RUN install -d -o 10001 -g 10001 "))
        .unwrap();
    for folder in ["/tangent/recordings", "/tangent/state"] {
        assert!(owned.split_whitespace().any(|f| f == folder), "{owned}");
    }
    for line in last
        .lines()
        .filter(|l| l.starts_with("COPY ") && !l.contains("--from"))
    {
        let from = line.split_whitespace().nth(1).unwrap();
        assert!(root().join(from).exists(), "{line}");
    }
}

/// Cargo finds every manifest and source file that it asks for in what `.dockerignore` lets
/// through.
#[test]
fn the_image_is_built_from_what_the_dockerignore_lets_through() {
    let ignored = fs::read_to_string(root().join(".dockerignore")).unwrap();
    let context = tempfile::tempdir().unwrap();
    for path in ignored.lines().filter_map(|line| line.strip_prefix('!')) {
        assert!(root().join(path).exists(), ".dockerignore: !{path}");
        let to = context.path().join(path);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        let copied = Command::new("cp")
            .arg("-r")
            .arg(root().join(path))
            .arg(&to)
            .status();
        assert!(copied.unwrap().success(), "{path}");
    }
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--offline", "--locked", "--format-version", "1"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(context.path())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Whether the service gets the state's folder, and mounts this volume there. Compose writes a
/// volume as `NAME:PATH` or as a table.
fn keeps_state_in(config: &str, service: &str, volume: &str) -> bool {
    let Some((_, block)) = config.split_once(&format!("\n  {service}:\n")) else {
        return false;
    };
    let lines: Vec<&str> = block
        .lines()
        .take_while(|line| line.starts_with("   "))
        .map(|line| line.trim().trim_start_matches("- "))
        .collect();
    let short = format!("{volume}:/tangent/state");
    let mounted = lines.iter().any(|line| line.starts_with(&short))
        || (lines.contains(&format!("source: {volume}").as_str())
            && lines.contains(&"target: /tangent/state"));
    mounted && lines.contains(&"STATE_DIRECTORY: /tangent/state")
}

/// The installed version of Compose accepts the file, and gives each profile the services that it
/// should have.
#[test]
fn the_compose_file_is_accepted() {
    let mut taken = 0;
    for compose in [&["docker-compose"][..], &["docker", "compose"]] {
        let here = |arguments: &[&str]| {
            let mut command = Command::new(compose[0]);
            command
                .args(&compose[1..])
                .args(arguments)
                .current_dir(root());
            command.output()
        };
        if !here(&["version"]).is_ok_and(|o| o.status.success()) {
            eprintln!("skipped, because `{}` is not here", compose.join(" "));
            continue;
        }
        taken += 1;
        let all = [
            "--profile",
            "sim",
            "--profile",
            "real",
            "--profile",
            "viewer",
            "--profile",
            "ros2",
            "--profile",
            "real-ros2",
            "--profile",
            "foxglove",
            "--profile",
            "real-foxglove",
        ];
        let output = here(&[&all[..], &["config"]].concat()).unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let secured = here(&[
            "-f",
            "docker-compose.yml",
            "-f",
            "docker-compose.tls.yml",
            "config",
        ]);
        let secured = secured.unwrap();
        assert!(
            secured.status.success(),
            "{}",
            String::from_utf8_lossy(&secured.stderr)
        );
        let secured = String::from_utf8_lossy(&secured.stdout).into_owned();
        // Each container of a real cell gets its own identity's files, and no other's key.
        let real = here(&[
            "-f",
            "docker-compose.yml",
            "-f",
            "docker-compose.tls.yml",
            "--profile",
            "real",
            "--profile",
            "real-foxglove",
            "config",
        ]);
        let real = String::from_utf8_lossy(&real.unwrap().stdout).into_owned();
        for (service, own) in [
            ("real-router", "router"),
            ("real-netft", "netft.cell1"),
            ("real-robot", "robot.cell1"),
            ("real-estimator", "estimator.cell1"),
            ("real-recorder", "recorder"),
            ("real-foxglove", "foxglove.cell1"),
        ] {
            let (_, block) = real.split_once(&format!("\n  {service}:\n")).unwrap();
            let lines = block.lines().take_while(|line| line.starts_with("   "));
            let keys: BTreeSet<&str> = lines
                .filter_map(|line| line.split("/cell/").nth(1)?.split(".key").next())
                .filter(|name| !name.contains(".pem") && !name.contains(".toml"))
                .filter(|name| !name.contains(".json5"))
                .collect();
            assert_eq!(keys, BTreeSet::from([own, "viewer"]), "{service}");
        }
        assert!(secured.contains("cell.compose.tls.toml") && !secured.contains("compose.toml"));
        // State that has to outlast a container has a volume: otherwise a restarted container would
        // not know that the tool presses.
        for (all, service, volume) in [
            (&*text, "netft", "simulated-state"),
            (&*text, "robot", "simulated-state"),
            (&*text, "real-netft", "state"),
            (&*text, "real-robot", "state"),
            (&*secured, "netft", "simulated-state"),
            (&*secured, "robot", "simulated-state"),
            (&*real, "real-netft", "state"),
            (&*real, "real-robot", "state"),
        ] {
            assert!(keeps_state_in(all, service, volume), "{service}: {all}");
        }
        let services: BTreeSet<&str> = text
            .lines()
            .filter_map(|l| l.strip_prefix("  ")?.strip_suffix(':'))
            .filter(|l| !l.starts_with(' '))
            .collect();
        for service in [
            "router",
            "simulator",
            "netft",
            "robot",
            "estimator",
            "recorder",
            "task",
            "real-robot",
            "viewer",
            "ros2",
            "real-ros2",
            "foxglove",
            "real-foxglove",
        ] {
            assert!(
                services.contains(service),
                "{service} is not in {services:?}"
            );
        }
    }
    assert!(
        taken > 0 || std::env::var_os("TANGENT_REQUIRE_DOCKER").is_none(),
        "TANGENT_REQUIRE_DOCKER is set, but Compose is not here"
    );
}

/// systemd's own check of the units, with the built program in place of the installed one.
#[test]
fn systemd_accepts_the_units() {
    if !Command::new("systemd-analyze")
        .arg("--version")
        .output()
        .is_ok_and(|o| o.status.success())
    {
        eprintln!("skipped, because systemd-analyze is not here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for name in ["tangent@.service", "tangent.target"] {
        let text = fs::read_to_string(root().join("deploy/systemd").join(name)).unwrap();
        let text = text.replace("/usr/local/bin/tangent", env!("CARGO_BIN_EXE_tangent"));
        fs::write(folder.path().join(name), text).unwrap();
    }
    for unit in ["tangent@robot.service", "tangent.target"] {
        let output = Command::new("systemd-analyze")
            .args(["verify", "--man=no"])
            .arg(folder.path().join(unit))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        let ours: Vec<&str> = said
            .lines()
            .filter(|line| line.contains("tangent"))
            .collect();
        assert!(output.status.success() && ours.is_empty(), "{unit}: {said}");
    }
}

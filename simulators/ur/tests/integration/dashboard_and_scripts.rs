//! The cell's other servers over real sockets: dashboard, script ports and the real-time port.

use std::io::{Read, Write};
use std::net::TcpStream;

use crate::common::{PATIENCE, cb3, connect, start, start_at, start_model};
use tangent_live::timed;
use tangent_simulated_device::Ports;
use tangent_simulated_ur::modes::{RobotMode, RuntimeState, SafetyMode};
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour, SimulatedUr};

fn lines(cell: &SimulatedUr) -> impl FnMut(&str) -> String + use<> {
    let mut stream = connect(cell.endpoints().dashboard);
    let mut read = {
        let mut stream = stream.try_clone().unwrap();
        move || {
            let mut line = Vec::new();
            let mut byte = [0];
            while stream.read(&mut byte).unwrap() == 1 && byte[0] != b'\n' {
                line.push(byte[0]);
            }
            String::from_utf8(line).unwrap()
        }
    };
    assert_eq!(read(), "Connected: Universal Robots Dashboard Server");
    move |command| {
        stream.write_all(format!("{command}\n").as_bytes()).unwrap();
        read()
    }
}

#[test]
fn the_dashboard_powers_up_and_reports() {
    timed(|| {
        let cell = start(ControllerConfig {
            running: false,
            power_step_s: 0.05,
            ..ControllerConfig::default()
        });
        let mut ask = lines(&cell);
        assert_eq!(ask("robotmode"), "Robotmode: POWER_OFF");
        assert_eq!(ask("power on"), "Powering on");
        assert!(cell.wait_for(PATIENCE, |s| s.summary.robot_mode == RobotMode::Idle));
        assert_eq!(ask("brake release"), "Brake releasing");
        assert!(cell.wait_for(PATIENCE, |s| s.summary.robot_mode == RobotMode::Running));
        assert_eq!(ask("robotmode"), "Robotmode: RUNNING");
        assert_eq!(ask("safetymode"), "Safetymode: NORMAL");
        assert_eq!(
            ask("PolyscopeVersion"),
            "URSoftware 3.15.8.106339 (Jun 20 2022)"
        );
        assert_eq!(ask("running"), "Program running: false");
        assert_eq!(ask("play"), "Failed to execute: play");
        // Clients stop whatever runs before they start their own, and expect this answer.
        assert_eq!(ask("stop"), "Stopped");
        assert!(ask("is in remote control").starts_with("could not understand"));
        cell.fault(Fault::ProtectiveStop);
        assert!(cell.wait_for(PATIENCE, |s| s.summary.safety == SafetyMode::ProtectiveStop));
        assert!(
            ask("unlock protective stop").starts_with("Cannot unlock protective stop until 5s")
        );
        assert_eq!(ask("quit"), "Disconnected");
    });
}

/// Kind and body of the next package of a robot-state port.
fn robot_package(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let mut head = [0; 4];
    stream.read_exact(&mut head).unwrap();
    let mut body = vec![0; u32::from_be_bytes(head) as usize - 4];
    stream.read_exact(&mut body).unwrap();
    (body.remove(0), body)
}

#[test]
fn the_primary_port_accepts_scripts_and_reports_their_outcome() {
    timed(|| {
        let cell = cb3();
        let mut stream = connect(cell.endpoints().primary);
        let (kind, body) = robot_package(&mut stream);
        assert_eq!((kind, body[9]), (20, 3), "the version comes first");
        assert_eq!(&body[11..20], b"URControl");
        let mut parts = Vec::new();
        let (kind, body) = robot_package(&mut stream);
        assert_eq!(kind, 16);
        let mut rest = body.as_slice();
        while rest.len() >= 5 {
            parts.push(rest[4]);
            rest = &rest[u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize..];
        }
        assert_eq!(parts, [0, 1, 4, 5, 6]);
        let next = |stream: &mut TcpStream| loop {
            let (kind, body) = robot_package(stream);
            if kind == 20 {
                return (body[9], String::from_utf8_lossy(&body[10..]).into_owned());
            }
        };
        stream
            .write_all(b"def hello():\n  textmsg(\"hi\")\n  sync()\nend\n")
            .unwrap();
        let (kind, text) = next(&mut stream);
        assert!(
            kind == 7 && text.contains("PROGRAM_XXX_STARTEDhello"),
            "{text}"
        );
        assert_eq!(next(&mut stream), (0, "hi".to_owned()));
        let (kind, text) = next(&mut stream);
        assert!(
            kind == 7 && text.contains("PROGRAM_XXX_STOPPEDhello"),
            "{text}"
        );
        stream
            .write_all(b"def bad():\n  nothing_like_it()\nend\n")
            .unwrap();
        let (kind, text) = next(&mut stream);
        assert!(
            kind == 10 && text.contains("name_not_found:nothing_like_it"),
            "{text}"
        );
    });
}

#[test]
fn a_program_moves_the_arm_and_a_stop_ends_it() {
    timed(|| {
        let cell = cb3();
        let mut stream = connect(cell.endpoints().secondary);
        stream
        .write_all(
            b"def go():\n  while True:\n    speedj([0.1, 0, 0, 0, 0, 0], 2, 0.008)\n  end\nend\n",
        )
        .unwrap();
        assert!(cell.wait_for(PATIENCE, |s| s.summary.qd[0] > 0.09));
        assert_eq!(cell.snapshot().unwrap().program.as_deref(), Some("go"));
        stream.write_all(b"stop program\n").unwrap();
        assert!(cell.wait_for(PATIENCE, |s| {
            s.summary.runtime == RuntimeState::Stopped && s.summary.qd.amax() < 1e-3
        }));
        assert_eq!(cell.snapshot().unwrap().summary.safety, SafetyMode::Normal);
    });
}

#[test]
fn the_realtime_port_streams_packages_of_the_right_length() {
    timed(|| {
        for (flavour, bytes) in [(Flavour::Cb3, 1116), (Flavour::ESeries, 1220)] {
            let cell = start(ControllerConfig {
                flavour,
                ..ControllerConfig::default()
            });
            let mut stream = connect(cell.endpoints().realtime);
            for _ in 0..3 {
                let (_, body) = robot_package(&mut stream);
                assert_eq!(body.len() + 5, bytes);
            }
        }
    });
}

#[test]
fn read_only_ports_and_local_control_take_no_script() {
    timed(|| {
        let cell = start(ControllerConfig {
            flavour: Flavour::ESeries,
            remote_control: false,
            ..ControllerConfig::default()
        });
        let endpoints = *cell.endpoints();
        for address in [endpoints.primary_read_only, endpoints.primary] {
            let mut stream = connect(address);
            stream.write_all(b"def go():\n  sync()\nend\n").unwrap();
            loop {
                let (kind, body) = robot_package(&mut stream);
                if kind == 20 && body[9] == 6 {
                    assert_eq!(body[10..14], 210i32.to_be_bytes());
                    break;
                }
            }
        }
        let mut ask = lines(&cell);
        assert_eq!(ask("is in remote control"), "false");
        assert!(ask("power off").contains("remote control"));
    });
}

/// The bridge moves no arm of another size than its model.
#[test]
fn the_controller_says_which_arm_it_is() {
    timed(|| {
        for (model, said, number) in [
            ("ur3e", "UR3", 3i32),
            ("ur5", "UR5", 1),
            ("ur10", "UR10", 2),
            ("ur16e", "UR16", 4),
            ("ur7e", "UR5", 1),
            ("ur12e", "UR10", 2),
            ("ur15", "UR15", 9),
            ("ur18", "UR18", 5),
            ("ur20", "UR20", 7),
            ("ur30", "UR30", 8),
            ("smart3s_substitute", "UR5", 1),
        ] {
            let cell = start_model(
                "127.0.0.1".parse().unwrap(),
                Ports::Ephemeral,
                &ControllerConfig::default(),
                model,
            )
            .unwrap();
            let mut ask = lines(&cell);
            assert_eq!(ask("get robot model"), said, "{model}");
            let mut stream = connect(cell.endpoints().primary);
            let state = loop {
                let (kind, body) = robot_package(&mut stream);
                if kind == 16 {
                    break body;
                }
            };
            // The last part ends with the robot's type and sub type.
            let end = state.len();
            assert_eq!(state[end - 8..end - 4], number.to_be_bytes(), "{model}");
        }
    });
}

#[test]
fn a_busy_port_is_named() {
    timed(|| {
        let taken = std::net::TcpListener::bind("127.0.0.83:30004").unwrap();
        let error = start_at(
            "127.0.0.83".parse().unwrap(),
            Ports::Offset(0),
            &ControllerConfig::default(),
        )
        .err()
        .unwrap()
        .to_string();
        assert!(
            error.contains("127.0.0.83:30004") && error.contains("RTDE"),
            "{error}"
        );
        drop(taken);
    });
}

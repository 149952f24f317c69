//! ur_rtde from PyPI against the simulated cell. Skipped if Python or the package is missing.

use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::start_at;
use tangent_live::interop::{python, root};
use tangent_live::timed;
use tangent_simulated_device::Ports;
use tangent_simulated_ur::modes::SafetyMode;
use tangent_simulated_ur::{ControllerConfig, Fault, Flavour};

/// Reason why the client cannot run here.
fn missing() -> Option<String> {
    let output = Command::new(python())
        .args([
            "-c",
            "import rtde_control, rtde_receive, rtde_io, dashboard_client",
        ])
        .output();
    match output {
        Err(error) => Some(format!("{} does not start: {error}", python().display())),
        Ok(output) if !output.status.success() => Some(format!(
            "{} has no ur-rtde (pip install -r tests/interop/requirements.txt)",
            python().display()
        )),
        Ok(_) => None,
    }
}

/// The client's ports cannot be changed, so each flavour has an address of its own.
fn converse(flavour: Flavour, address: &str) {
    if let Some(reason) = missing() {
        println!("skipped, because {reason}");
        return;
    }
    let config = ControllerConfig {
        flavour,
        boot_s: 0.5,
        ..ControllerConfig::default()
    };
    let cell = start_at(address.parse().unwrap(), Ports::Offset(0), &config).unwrap();
    let mut client = Command::new(python())
        .arg(root().join("tests/interop/ur_rtde_client.py"))
        .arg(address)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .unwrap();
    let mut to = client.stdin.take().unwrap();
    let patience = Duration::from_secs(30);
    for line in BufReader::new(client.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        println!("{line}");
        // The client prints the disturbance that it expects, and waits for the answer.
        match line.as_str() {
            "please: restart" => {
                cell.fault(Fault::Restart);
                assert!(cell.wait_for(patience, |s| s.summary.time_s < 40.0));
            }
            "please: protective stop" => {
                cell.fault(Fault::ProtectiveStop);
                assert!(
                    cell.wait_for(patience, |s| s.summary.safety == SafetyMode::ProtectiveStop)
                );
            }
            _ => continue,
        }
        writeln!(to, "done").unwrap();
    }
    let status = client.wait().unwrap();
    assert!(
        status.success(),
        "{status}; the controller's log:\n{}",
        cell.log().join("\n")
    );
}

#[test]
fn cb3() {
    timed(|| {
        converse(Flavour::Cb3, "127.0.0.71");
    });
}

#[test]
fn e_series() {
    timed(|| {
        converse(Flavour::ESeries, "127.0.0.72");
    });
}

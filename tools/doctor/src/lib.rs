//! Checks whether this machine can run a cell, and reports what to change if it cannot.
//!
//! [`examine`] runs every check and returns a [`Diagnosis`]. A check reads files of the operating
//! system or queries a device, and returns a [`Finding`]: what was found, what it means for the
//! cell, what to do. A diagnosis changes nothing: it claims no register, takes over no stream and
//! writes no setting. `tangent doctor` prints it; `docs/doctor.md` lists the checks.
//!
//! ```no_run
//! let cell = tangent_runtime::CellConfig::default_cell();
//! print!("{}", tangent_doctor::examine(&cell, tangent_doctor::Scope::Machine));
//! ```
//!
//! Each file has one check, or one subject that several checks read: `system` reads the files of
//! `/proc`, `/sys` and `/etc` below a root that tests replace, `processes` and `ethtool` read from
//! it and from the kernel, `on_the_bus` subscribes to the topics of a running cell.

mod camera;
mod cell_arm;
mod clock;
mod devices;
mod disk;
mod ethtool;
mod finding;
mod franka;
mod machine;
mod network;
mod on_the_bus;
mod ports;
mod processes;
mod system;
mod units;

use tangent_runtime::CellConfig;

use crate::cell_arm::CellArm;
use crate::on_the_bus::RunningCell;
use crate::system::System;

pub use finding::{Diagnosis, Finding, Level};

/// Scope of the checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// This machine only.
    Machine,
    /// This machine, the cell's robot, sensor and camera, and the network between them.
    Cell,
}

/// Runs every check for the cell. Waiting for devices takes up to a few seconds.
pub fn examine(config: &CellConfig, scope: Scope) -> Diagnosis {
    let system = System::here();
    let mut findings = Vec::new();
    findings.extend(machine::check(&system, config));
    findings.extend(clock::check(&system));
    findings.extend(units::check(&system, config));
    findings.extend(ports::check(&system, config));
    findings.extend(disk::check(config));
    if scope == Scope::Cell {
        findings.extend(network::check(&system, config));
        findings.extend(devices(config));
    }
    Diagnosis::of(&config.cell.name, findings)
}

fn devices(config: &CellConfig) -> Vec<Finding> {
    let arm = CellArm::of(config);
    // Devices with a protocol of their own are queried without the bus.
    let bus_matters = arm != CellArm::UniversalRobots || config.camera.is_some();
    let cell = bus_matters.then(|| RunningCell::join(config));
    let mut findings = match (arm, &cell) {
        (CellArm::Franka, Some(cell)) => franka::check(config, cell),
        (CellArm::OnTheBus, Some(cell)) => on_the_bus::arm(config, cell),
        _ => devices::robot(config),
    };
    if arm.has_sensor_box(config) {
        findings.extend(devices::sensor(config));
    } else {
        findings.push(Finding::ok(
            "sensor",
            "none: the robot estimates the wrench itself",
        ));
    }
    if let (Some(camera), Some(cell)) = (&config.camera, &cell) {
        findings.extend(camera::check(camera, cell));
    }
    findings
}

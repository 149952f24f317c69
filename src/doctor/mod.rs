//! `tangent doctor`: can this machine do it, and if not, what to do about it.
//!
//! Each check reads files of the system or asks a device, and comes to findings: what was found,
//! what it means, what to do. Nothing is changed: no register claimed, no stream taken, no setting
//! written.

mod camera;
mod clock;
mod devices;
mod disk;
mod ethtool;
mod franka;
mod machine;
mod network;
mod on_the_bus;
mod ports;
mod processes;
mod system;
mod units;

use anyhow::Result;
use serde::Serialize;
use tangent_runtime::CellConfig;
use tangent_runtime::config::{Law, RobotDriver};

use crate::cli::Doctor;
use crate::output::{Outcome, print_json};
use on_the_bus::RunningCell;
use system::System;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// As it should be.
    Ok,
    /// Works, with less margin than it could have.
    Warning,
    /// Does not work, or not safely in time.
    Problem,
}

/// What one check came to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Which check.
    pub check: &'static str,
    /// How bad it is.
    pub level: Level,
    /// What was found.
    pub found: String,
    /// What that means for a cell; empty when all is well.
    pub meaning: String,
    /// What to do; empty when all is well.
    pub advice: String,
}

impl Finding {
    /// All is well.
    pub fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            level: Level::Ok,
            found: found.into(),
            meaning: String::new(),
            advice: String::new(),
        }
    }

    /// Less margin than there could be.
    pub fn warning(
        check: &'static str,
        found: impl Into<String>,
        meaning: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            check,
            level: Level::Warning,
            found: found.into(),
            meaning: meaning.into(),
            advice: advice.into(),
        }
    }

    /// Does not work like this.
    pub fn problem(
        check: &'static str,
        found: impl Into<String>,
        meaning: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Problem,
            ..Self::warning(check, found, meaning, advice)
        }
    }
}

/// How the cell's arm is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Arm {
    /// RTDE, with a force/torque sensor's box beside it.
    UniversalRobots,
    /// FCI; it says itself what it feels.
    Franka,
    /// An arm that takes torques and speaks on the bus: there is only the simulated one. The box
    /// beside it is simulated too.
    OnTheBus,
}

impl Arm {
    fn of(config: &CellConfig) -> Self {
        match (config.robot.driver, config.controller.law) {
            (RobotDriver::Franka, _) => Self::Franka,
            (RobotDriver::Rtde, Law::HybridAdmittance) => Self::UniversalRobots,
            (RobotDriver::Rtde, _) => Self::OnTheBus,
        }
    }

    fn has_sensor_box(self) -> bool {
        self != Self::Franka
    }
}

#[derive(Serialize)]
struct Diagnosis {
    cell: String,
    verdict: Level,
    findings: Vec<Finding>,
}

/// Looks at everything. Exit code 1 when there is a problem, 0 with warnings only.
///
/// # Errors
/// When the answer cannot be written as JSON.
pub fn run(args: &Doctor, config: &CellConfig, json: bool) -> Result<Outcome> {
    let system = System::here();
    let mut findings = Vec::new();
    findings.extend(machine::check(&system, config));
    findings.extend(clock::check(&system));
    findings.extend(units::check(&system, config));
    findings.extend(ports::check(&system, config));
    findings.extend(disk::check(config));
    if !args.machine {
        findings.extend(network::check(&system, config));
        findings.extend(devices(config));
    }
    let diagnosis = Diagnosis {
        cell: config.cell.name.clone(),
        verdict: findings.iter().map(|f| f.level).max().unwrap_or(Level::Ok),
        findings,
    };
    if json {
        print_json(&diagnosis)?;
    } else {
        print(&diagnosis);
    }
    Ok(match diagnosis.verdict {
        Level::Problem => Outcome::Failed,
        Level::Ok | Level::Warning => Outcome::Done,
    })
}

fn devices(config: &CellConfig) -> Vec<Finding> {
    let arm = Arm::of(config);
    // Devices that are asked by their own protocol need no bus.
    let bus_matters = arm != Arm::UniversalRobots || config.camera.is_some();
    let cell = bus_matters.then(|| RunningCell::join(config));
    let mut findings = match (arm, &cell) {
        (Arm::Franka, Some(cell)) => franka::check(config, cell),
        (Arm::OnTheBus, Some(cell)) => on_the_bus::arm(config, cell),
        _ => devices::robot(config),
    };
    if arm.has_sensor_box() {
        findings.extend(devices::sensor(config));
    } else {
        findings.push(Finding::ok("sensor", "none: the robot says what it feels"));
    }
    if let (Some(camera), Some(cell)) = (&config.camera, &cell) {
        findings.extend(camera::check(camera, cell));
    }
    findings
}

fn print(diagnosis: &Diagnosis) {
    for f in &diagnosis.findings {
        let level = match f.level {
            Level::Ok => "ok",
            Level::Warning => "warning",
            Level::Problem => "PROBLEM",
        };
        println!("{level:<8} {:<20} {}", f.check, f.found);
        for line in [&f.meaning, &f.advice]
            .into_iter()
            .filter(|l| !l.is_empty())
        {
            println!("{:29}{line}", "");
        }
    }
    let count = |level| {
        diagnosis
            .findings
            .iter()
            .filter(|f| f.level == level)
            .count()
    };
    println!(
        "cell {}: {} checks, {} warnings, {} problems",
        diagnosis.cell,
        diagnosis.findings.len(),
        count(Level::Warning),
        count(Level::Problem)
    );
}

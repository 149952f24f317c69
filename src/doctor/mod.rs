//! `tangent doctor`: can this machine do it, and if not, what to do about it.
//!
//! Each check reads files of the system or asks a device, and comes to findings: what was found, what it means, what to do.
//! Nothing is changed: no register claimed, no stream taken, no setting written.

mod clock;
mod devices;
mod disk;
mod ethtool;
mod machine;
mod network;
mod ports;
mod processes;
mod system;
mod units;

use anyhow::Result;
use serde::Serialize;
use tangent_runtime::CellConfig;

use crate::cli::Doctor;
use crate::output::{Outcome, print_json};
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
        findings.extend(devices::robot(config));
        findings.extend(devices::sensor(config));
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

//! Checks the systemd units of `tangent` and the services that already run: whether they have the
//! privileges and scheduling that the control loop needs.

use tangent_runtime::CellConfig;

use crate::finding::Finding;
use crate::processes::{self, FIFO};
use crate::system::System;

/// Folders in which systemd looks for units, highest precedence first.
const FOLDERS: [&str; 5] = [
    "/etc/systemd/system",
    "/run/systemd/system",
    "/usr/local/lib/systemd/system",
    "/usr/lib/systemd/system",
    "/lib/systemd/system",
];
/// Names of the threads that ask for real-time scheduling.
const LOOPS: [&str; 2] = ["rtde-loop", "netft"];

/// Checks installed units and running services.
pub fn check(system: &System, config: &CellConfig) -> Vec<Finding> {
    let mut findings = installed(system, config);
    findings.extend(running(system, config));
    findings
}

fn installed(system: &System, config: &CellConfig) -> Vec<Finding> {
    const CHECK: &str = "systemd units";
    let mut seen: Vec<String> = Vec::new();
    let mut findings = Vec::new();
    for folder in FOLDERS {
        for name in system.names(folder) {
            let ours = name.starts_with("tangent") && name.ends_with(".service");
            if !ours || seen.contains(&name) {
                continue;
            }
            let text = with_drop_ins(system, folder, &name);
            findings.push(judge(&name, &text, config));
            seen.push(name);
        }
    }
    if findings.is_empty() {
        findings.push(Finding::ok(
            CHECK,
            "no unit of tangent is installed; units are needed only without containers (docs/deploy.md)",
        ));
    }
    findings
}

/// Text of a unit followed by its drop-ins, which override it.
fn with_drop_ins(system: &System, folder: &str, name: &str) -> String {
    let mut text = system.text(&format!("{folder}/{name}")).unwrap_or_default();
    for folder in FOLDERS.iter().rev() {
        for file in system.names(&format!("{folder}/{name}.d")) {
            if file.ends_with(".conf") {
                text.push('\n');
                text.push_str(
                    &system
                        .text(&format!("{folder}/{name}.d/{file}"))
                        .unwrap_or_default(),
                );
            }
        }
    }
    text
}

/// The last value of a key.
fn value<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines()
        .filter_map(|line| line.trim().split_once('='))
        .filter(|(name, _)| name.trim() == key)
        .map(|(_, value)| value.trim())
        .next_back()
}

fn judge(name: &str, text: &str, config: &CellConfig) -> Finding {
    const CHECK: &str = "systemd units";
    let wish = &config.realtime;
    let mut missing = Vec::new();
    if wish.enabled {
        let priority = wish.loop_priority.max(wish.sensor_priority);
        let granted = value(text, "LimitRTPRIO").map_or(Some(0), |v| match v {
            "infinity" => Some(99),
            number => number.parse::<u8>().ok(),
        });
        if granted.is_none_or(|granted| granted < priority) {
            missing.push(format!("LimitRTPRIO={priority}"));
        }
        if value(text, "LimitMEMLOCK") != Some("infinity") {
            missing.push("LimitMEMLOCK=infinity".to_owned());
        }
    }
    if !matches!(value(text, "Restart"), Some("on-failure" | "always")) {
        missing.push("Restart=on-failure".to_owned());
    }
    if missing.is_empty() {
        return Finding::ok(CHECK, format!("{name} has all required settings"));
    }
    Finding::problem(
        CHECK,
        format!("{name} lacks {}", missing.join(", ")),
        "without the limits the loop gets normal scheduling; without the restart a failed service stays down",
        format!(
            "systemctl edit {name}: [Service], then these lines; or install deploy/systemd/ again"
        ),
    )
}

/// Checks the services that run now, and whether their loops have real-time scheduling.
fn running(system: &System, config: &CellConfig) -> Vec<Finding> {
    const CHECK: &str = "running services";
    if !config.realtime.enabled {
        return Vec::new();
    }
    let mut findings = Vec::new();
    for process in processes::named(system, "tangent") {
        for thread in process.threads(system) {
            if !LOOPS.contains(&thread.name.as_str()) {
                continue;
            }
            let who = format!("{} in process {}", thread.name, process.pid);
            findings.push(if thread.policy == FIFO {
                Finding::ok(CHECK, format!("{who} runs under SCHED_FIFO"))
            } else {
                Finding::warning(
                    CHECK,
                    format!("{who} runs under normal scheduling"),
                    "SCHED_FIFO was refused when it started, or its cell file has [realtime] enabled = false",
                    "`tangent status` shows the reason",
                )
            });
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use crate::system::tests::machine;

    const GOOD: &str = "[Service]\nLimitRTPRIO=95\nLimitMEMLOCK=infinity\nRestart=on-failure\n";

    fn with(files: &[(&str, &str)]) -> Vec<Finding> {
        installed(&machine(files).1, &CellConfig::default_cell())
    }

    #[test]
    fn what_a_unit_lacks_is_named() {
        let path = "/etc/systemd/system/tangent@.service";
        assert_eq!(with(&[(path, GOOD)])[0].level, Level::Ok);
        let low = GOOD.replace("95", "10").replace("infinity", "64M");
        let finding = &with(&[(path, &low)])[0];
        assert_eq!(finding.level, Level::Problem);
        for word in ["LimitRTPRIO=80", "LimitMEMLOCK=infinity"] {
            assert!(finding.found.contains(word), "{}", finding.found);
        }
        assert!(!finding.found.contains("Restart"), "{}", finding.found);
        assert_eq!(with(&[])[0].level, Level::Ok);
    }

    #[test]
    fn a_drop_in_wins_over_the_unit() {
        let found = with(&[
            ("/usr/lib/systemd/system/tangent@.service", GOOD),
            (
                "/etc/systemd/system/tangent@.service.d/limits.conf",
                "[Service]\nLimitRTPRIO=0\n",
            ),
        ]);
        assert_eq!(found.len(), 1);
        assert!(
            found[0].found.contains("LimitRTPRIO=80"),
            "{}",
            found[0].found
        );
    }

    #[test]
    fn the_units_that_ship_have_what_they_need() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/systemd");
        let mut units = 0;
        for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let name = entry.file_name().into_string().unwrap();
            if !name.ends_with(".service") {
                continue;
            }
            let text = std::fs::read_to_string(entry.path()).unwrap();
            let finding = judge(&name, &text, &CellConfig::default_cell());
            assert_eq!(finding.level, Level::Ok, "{finding:?}");
            units += 1;
        }
        assert!(units > 0);
    }

    #[test]
    fn a_loop_without_real_time_scheduling_is_reported() {
        let stat = |policy| {
            format!(
                "7 (rtde-loop) S 1 1 1 0 -1 0 1 0 0 0 1 2 0 0 -81 0 1 0 100 1 1 1 1 1 1 1 1 0 0 0 0 0 0 0 17 0 80 {policy} 0 0 0"
            )
        };
        let level = |policy| {
            let stat = stat(policy);
            let (_folder, system) = machine(&[
                ("/proc/7/comm", "tangent\n"),
                ("/proc/7/task/7/stat", &stat),
            ]);
            running(&system, &CellConfig::default_cell())[0].level
        };
        assert_eq!(level(1), Level::Ok);
        assert_eq!(level(0), Level::Warning);
    }
}

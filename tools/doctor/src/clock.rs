//! Checks the host's clock: stamps of several hosts are comparable only if each clock is
//! synchronized.

use crate::finding::Finding;
use crate::processes;
use crate::system::System;

/// Programs that synchronize a clock, and the source of each one's accuracy.
const KEEPERS: [(&str, &str); 5] = [
    ("chronyd", "`chronyc tracking` shows its offset"),
    ("ntpd", "`ntpq -p` shows its offset"),
    ("phc2sys", "its log shows its offset"),
    ("ptp4l", "its log shows its offset"),
    (
        "systemd-timesyn",
        "`timedatectl timesync-status` shows its offset",
    ),
];

/// Checks the clock's source and its synchronization.
pub fn check(system: &System) -> Vec<Finding> {
    let mut findings = vec![kept(system)];
    findings.extend(source(system));
    findings
}

fn kept(system: &System) -> Finding {
    const CHECK: &str = "clock";
    // The kernel truncates process names to 15 characters.
    let keeper = KEEPERS
        .iter()
        .find(|(name, _)| processes::named(system, name).next().is_some());
    let in_step = system.exists("/run/systemd/timesync/synchronized");
    match keeper {
        Some(("systemd-timesyn", advice)) if !in_step => Finding::warning(
            CHECK,
            "systemd-timesyncd runs, but has reached no time server",
            "ages of messages between hosts are wrong by as much as the clocks differ; ages within this host are right",
            format!(
                "a time server in the cell's network (NTP= in /etc/systemd/timesyncd.conf); {advice}"
            ),
        ),
        Some((name, words)) => Finding::ok(CHECK, format!("synchronised by {name}; {words}")),
        None if in_step => Finding::ok(CHECK, "was set by systemd-timesyncd"),
        None => Finding::warning(
            CHECK,
            "no program that synchronises the clock was found (chronyd, ntpd, ptp4l, phc2sys, systemd-timesyncd)",
            "with services on several hosts, ages of messages are wrong by as much as the clocks differ; on one host they are right",
            "run chrony on every host, all with the same server; in a container, check the host",
        ),
    }
}

fn source(system: &System) -> Option<Finding> {
    const CHECK: &str = "clock source";
    let path = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
    let source = system.text(path)?;
    Some(match source.as_str() {
        "hpet" | "acpi_pm" | "jiffies" | "refined-jiffies" => Finding::warning(
            CHECK,
            source,
            "each reading of the clock takes about a microsecond, and the loop reads it often",
            "the kernel found the processor's own counter unstable: update the BIOS, or try `tsc=reliable` on the \
             kernel's command line",
        ),
        _ => Finding::ok(CHECK, source),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use crate::system::tests::machine;

    #[test]
    fn an_unsynchronised_clock_is_reported() {
        assert_eq!(kept(&machine(&[]).1).level, Level::Warning);
        let chrony = kept(&machine(&[("/proc/77/comm", "chronyd\n")]).1);
        assert_eq!(chrony.level, Level::Ok);
        assert!(chrony.found.contains("chronyc tracking"));
    }

    #[test]
    fn timesyncd_counts_once_it_reached_a_server() {
        let running = ("/proc/9/comm", "systemd-timesyn\n");
        let reached = ("/run/systemd/timesync/synchronized", "");
        assert_eq!(kept(&machine(&[running]).1).level, Level::Warning);
        assert_eq!(kept(&machine(&[running, reached]).1).level, Level::Ok);
    }

    #[test]
    fn a_slow_clock_source_is_reported() {
        let path = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
        let with = |source| super::source(&machine(&[(path, source)]).1).unwrap().level;
        assert_eq!(with("tsc\n"), Level::Ok);
        assert_eq!(with("hpet\n"), Level::Warning);
    }
}

//! Router, recorder, disk and processor.

use crate::faults::evidence::Evidence;

use super::{Case, HEALTH_MS, Outcome, WRENCH_MS, case};

pub(super) fn of_the_machine() -> Vec<Case> {
    vec![
        Case {
            provoke: |s| s.cell.kill("router"),
            noticed_within_ms: Some(WRENCH_MS),
            // Nobody hears the controller: the arm itself shows it.
            by_motion: true,
            noticed: Evidence::slowed_ns,
            watch_s: 1.0,
            ..case(
                "router_restart",
                "kill -9 of the router, started again a second later",
                "controller",
            )
        },
        Case {
            provoke: |s| s.cell.kill("recorder"),
            outcome: Outcome::GoesOn,
            ..case(
                "recorder_killed",
                "kill -9 of the recorder, started again a second later",
                "nobody has to",
            )
        },
        Case {
            provoke: |s| s.disk()?.fill(),
            repair: |s| s.disk()?.empty(),
            outcome: Outcome::GoesOn,
            noticed_within_ms: Some(2.0 * HEALTH_MS),
            noticed: |e, t| e.service_ns("recorder", t, |_, now| now.state == 2),
            watch_s: 3.0,
            ..case(
                "disk_full",
                "not a megabyte left under the recordings",
                "recorder",
            )
        },
        Case {
            provoke: |s| s.disk()?.freeze(),
            repair: |s| s.disk()?.thaw(),
            outcome: Outcome::GoesOn,
            watch_s: 2.0,
            ..case(
                "disk_hangs",
                "every write to the recordings' disk waits for 2 s",
                "nobody has to",
            )
        },
        Case {
            provoke: |s| s.cell.hog(),
            repair: |s| {
                s.cell.end_hogs();
                Ok(())
            },
            outcome: Outcome::GoesOn,
            watch_s: 3.0,
            ..case("cpu_hog", "two busy processes per core", "nobody has to")
        },
    ]
}

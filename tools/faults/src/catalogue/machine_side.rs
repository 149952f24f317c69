//! Faults of router, recorder, disk and processor.

use crate::evidence::Evidence;
use crate::stage::Stage;

use tangent_control::Phase;
use tangent_runtime::config::RealtimeConfig;

use super::{Case, ESTIMATE_MS, HEALTH_MS, Outcome, PATH_STOP_MS, STOP_MS, WRENCH_MS, case};

pub(super) fn of_the_machine() -> Vec<Case> {
    vec![
        Case {
            provoke: |s| s.cell.kill("router"),
            noticed_within_ms: Some(WRENCH_MS),
            // No message of the controller arrives; the motion of the arm shows the reaction.
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
                "none needed",
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
                "less than a megabyte free for the recordings",
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
                "none needed",
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
            ..case("cpu_hog", "two busy processes per core", "none needed")
        },
        Case {
            provoke: |s| s.take_processors(RealtimeConfig::default().estimator_priority - 1),
            outcome: Outcome::GoesOn,
            watch_s: 1.5,
            ..taken(
                "cpu_taken_below_ours",
                "every core taken for 0.5 s with SCHED_FIFO, a priority below the estimator's",
                "none needed",
            )
        },
        Case {
            provoke: |s| s.take_processors(RealtimeConfig::default().estimator_priority + 1),
            outcome: Outcome::Waits,
            noticed_within_ms: Some(ESTIMATE_MS),
            stop_ms: PATH_STOP_MS + STOP_MS,
            noticed: |e, t| e.phase_ns(Phase::Hold, t),
            watch_s: 1.5,
            ..taken(
                "cpu_taken_above_estimator",
                "every core taken for 0.5 s with SCHED_FIFO, a priority between the estimator's and the bus's",
                "controller",
            )
        },
    ]
}

fn taken(name: &'static str, what: &'static str, notices: &'static str) -> Case {
    Case {
        repair: Stage::leave_processors,
        ..case(name, what, notices)
    }
}

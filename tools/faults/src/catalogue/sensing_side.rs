//! Sensor and estimator that die, hang, are cut off or send invalid data; clocks that step; a
//! surface that ends.

use tangent_control::Phase;

use crate::evidence::Evidence;
use crate::host_clock::Host;
use crate::impostor::Lie;
use crate::layout::Layout;
use crate::wire::{Cut, Damage};

use super::{
    CYCLE_MS, Case, ESTIMATE_MS, FROZEN_MS, HEALTH_MS, Outcome, PATH_STOP_MS, SILENCE_MS, STOP_MS,
    WRENCH_MS, case,
};

pub(super) fn of_the_sensor() -> Vec<Case> {
    let ends = |name, what| Case {
        noticed_within_ms: Some(WRENCH_MS),
        noticed: Evidence::left_path_ns,
        ..case(name, what, "controller")
    };
    let frozen = |name, what| Case {
        noticed_within_ms: Some(FROZEN_MS),
        noticed: |e: &Evidence, t| e.sensor_ns(t, |_, now| now.validity != 0),
        ..case(name, what, "netft, controller")
    };
    let goes_on = |name, what| Case {
        outcome: Outcome::GoesOn,
        notices: "netft",
        noticed: |e, t| e.sensor_ns(t, |before, now| now.lost > before.lost),
        ..case(name, what, "netft")
    };
    vec![
        Case {
            provoke: |s| s.cell.kill("netft"),
            ..ends("sensor_service_killed", "kill -9 of netft")
        },
        Case {
            provoke: |s| s.cell.signal("netft", "STOP"),
            repair: |s| s.cell.signal("netft", "CONT"),
            ..ends("sensor_service_hung", "SIGSTOP of netft")
        },
        Case {
            provoke: |s| s.wire(Damage::Unplugged),
            repair: |s| s.wire(Damage::None),
            noticed_within_ms: Some(SILENCE_MS),
            notices: "netft, controller",
            noticed: |e, t| e.sensor_ns(t, |_, now| now.validity != 0),
            ..ends("sensor_unplugged", "no datagram passes to or from the box")
        },
        Case {
            // Status bit 17, and the summary bit.
            provoke: |s| s.wire(Damage::Status { word: 0x8002_0000 }),
            repair: |s| s.wire(Damage::None),
            ..ends("sensor_saturated", "every record reports a saturated gauge")
        },
        Case {
            provoke: |s| s.wire(Damage::Status { word: 0x8000_8000 }),
            repair: |s| s.wire(Damage::None),
            ..ends(
                "sensor_error",
                "every record reports an error of the sensor",
            )
        },
        Case {
            provoke: |s| s.wire(Damage::Frozen),
            repair: |s| s.wire(Damage::None),
            ..frozen(
                "sensor_frozen",
                "every record repeats, while the sequence advances",
            )
        },
        Case {
            provoke: |s| s.wire(Damage::AxisStuck { axis: 2 }),
            repair: |s| s.wire(Damage::None),
            ..frozen("sensor_axis_stuck", "Fz repeats in every record")
        },
        Case {
            provoke: |s| s.wire(Damage::Implausible { one_of: 20 }),
            repair: |s| s.wire(Damage::None),
            noticed: |e, t| e.sensor_ns(t, |before, now| now.implausible > before.implausible),
            ..goes_on(
                "sensor_datagrams_plausible_corrupt",
                "one of 20 records is well-formed and contains false loads",
            )
        },
        Case {
            provoke: |s| s.wire(Damage::Lost { per_mille: 10 }),
            repair: |s| s.wire(Damage::None),
            ..goes_on("sensor_datagrams_lost", "1 % of the datagrams lost")
        },
        Case {
            provoke: |s| s.wire(Damage::Corrupted { one_of: 20 }),
            repair: |s| s.wire(Damage::None),
            noticed: |e, t| {
                e.service_ns("netft", t, |before, now| {
                    figure(now, "datagrams_malformed") > figure(before, "datagrams_malformed")
                })
            },
            noticed_within_ms: Some(HEALTH_MS),
            watch_s: 1.5,
            ..goes_on(
                "sensor_datagrams_corrupted",
                "before one of 20 datagrams: a truncated, an overlong and a random one",
            )
        },
        Case {
            provoke: |s| s.wire(Damage::Replayed { one_of: 20 }),
            repair: |s| s.wire(Damage::None),
            noticed: |e, t| e.sensor_ns(t, |before, now| now.out_of_order > before.out_of_order),
            ..goes_on(
                "sensor_datagrams_replayed",
                "after one of 20 datagrams, one of half a second ago",
            )
        },
        Case {
            provoke: |s| {
                s.cell.signal("netft", "STOP")?;
                s.lie(Lie::WrenchNotFinite)
            },
            repair: |s| {
                s.tell_no_more_lies()?;
                s.cell.signal("netft", "CONT")
            },
            impostor: Some("/wrench/"),
            ..ends(
                "wrench_not_finite",
                "NaN on wrench/tool in place of netft's numbers",
            )
        },
        Case {
            provoke: |s| s.lie(Lie::WrenchOfAnother),
            repair: |s| s.tell_no_more_lies(),
            impostor: Some("/wrench/"),
            outcome: Outcome::GoesOn,
            notices: "controller",
            noticed: |e, t| {
                e.service_ns("controller", t, |before, now| {
                    figure(now, REFUSED) > figure(before, REFUSED)
                })
            },
            noticed_within_ms: Some(HEALTH_MS),
            watch_s: 1.5,
            ..case(
                "wrench_of_another",
                "zeros on wrench/tool, 1000 a second beside netft's numbers",
                "controller",
            )
        },
    ]
}

/// Figure in the health of a service that reads the wrench: samples from a second publisher.
const REFUSED: &str = "wrench/tool_refused";

fn figure(service: &crate::evidence::Service, name: &str) -> f64 {
    service
        .figures
        .iter()
        .find(|(n, _)| n == name)
        .map_or(0.0, |(_, value)| *value)
}

pub(super) fn of_the_estimator() -> Vec<Case> {
    let base = |name, what| Case {
        noticed_within_ms: Some(ESTIMATE_MS),
        stop_ms: PATH_STOP_MS + STOP_MS,
        noticed: |e: &Evidence, t| e.phase_ns(Phase::Hold, t),
        watch_s: 1.6,
        ..case(name, what, "controller")
    };
    vec![
        Case {
            provoke: |s| s.cell.kill("estimator"),
            ..base("estimator_killed", "kill -9 of the estimator")
        },
        Case {
            provoke: |s| s.cell.signal("estimator", "STOP"),
            repair: |s| s.cell.signal("estimator", "CONT"),
            ..base("estimator_hung", "SIGSTOP of the estimator")
        },
        Case {
            provoke: |s| {
                s.cell.estimator.set(Cut::Unplugged);
                Ok(())
            },
            repair: |s| {
                s.cell.estimator.set(Cut::None);
                Ok(())
            },
            ..base(
                "estimator_unplugged",
                "no message passes between the estimator and the router",
            )
        },
        Case {
            provoke: |s| {
                s.cell.estimator.set(Cut::Closed);
                Ok(())
            },
            repair: |s| {
                s.cell.estimator.set(Cut::None);
                Ok(())
            },
            ..base(
                "estimator_cut",
                "the estimator's connection closed, and every new one",
            )
        },
        Case {
            provoke: |s| s.lie(Lie::NormalNotFinite),
            repair: |s| s.tell_no_more_lies(),
            impostor: Some("/estimate/blend/normal"),
            outcome: Outcome::GoesOn,
            noticed: |e, t| e.fallen_back_ns(t),
            watch_s: 1.0,
            ..base(
                "estimate_not_finite",
                "NaN as the active estimator's normal, beside the true ones",
            )
        },
    ]
}

pub(super) fn of_clocks() -> Vec<Case> {
    let nobody = |name, what, provoke| Case {
        layout: Layout::Relayed,
        provoke,
        outcome: Outcome::GoesOn,
        watch_s: 1.5,
        ..case(name, what, "none needed")
    };
    vec![
        nobody(
            "clock_set_forward",
            "the clock of netft's host is set forward by 1 s",
            |s| s.step_clock(Host::Sensor, 1.0),
        ),
        Case {
            noticed_within_ms: Some(WRENCH_MS),
            noticed: Evidence::left_path_ns,
            outcome: Outcome::Ends,
            notices: "controller",
            // The host's clock is trusted again after two seconds.
            watch_s: 2.5,
            ..nobody(
                "clock_set_back",
                "the clock of netft's host is set back by 1 s",
                |s| s.step_clock(Host::Sensor, -1.0),
            )
        },
        nobody(
            "estimator_clock_set_forward",
            "the clock of the estimator's host is set forward by 1 s",
            |s| s.step_clock(Host::Estimator, 1.0),
        ),
        nobody(
            "estimator_clock_set_back",
            "the clock of the estimator's host is set back by 2 s",
            |s| s.step_clock(Host::Estimator, -2.0),
        ),
        nobody(
            "loop_clock_set_forward",
            "the clock of the hard loop's host is set forward by 1 s",
            |s| s.step_clock(Host::Loop, 1.0),
        ),
        nobody(
            "loop_clock_set_back",
            "the clock of the hard loop's host is set back by 2 s",
            |s| s.step_clock(Host::Loop, -2.0),
        ),
    ]
}

pub(super) fn of_the_surface() -> Vec<Case> {
    vec![Case {
        layout: Layout::Ledge,
        provoke: |s| s.wait_for_the_edge(),
        outcome: Outcome::Waits,
        // Three cycles, and the one in which it is observed; the additional time is that of the
        // wrench filter.
        noticed_within_ms: Some(4.0 * CYCLE_MS + 5.0),
        noticed: |e, t| e.phase_ns(Phase::Seek, t),
        watch_s: 3.0,
        ..case(
            "contact_lost",
            "the tool slides over an edge 6 mm high",
            "controller",
        )
    }]
}

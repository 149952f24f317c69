//! Every fault: what is done, who has to notice it and how soon, and when the arm has to be safe.

use anyhow::Result;
use tangent_control::Phase;

use super::evidence::Evidence;
use super::impostor::Lie;
use super::private_cell::Layout;
use super::stage::Stage;
use super::wire::{Cut, Damage};

/// One cycle of the simulated robot, a CB3, ms.
const CYCLE_MS: f64 = 8.0;
/// From a command of zero to an arm at rest: ramp at the cell's limits from the sliding speed, the robot's own delay, and the
/// cycle in which it is seen, ms.
const STOP_MS: f64 = 120.0;
/// From a command to a joint velocity that can be seen, 3 to 5 cycles of a CB3: what is noticed by the arm's own motion is
/// noticed later by this, ms.
const ARM_MS: f64 = 5.0 * CYCLE_MS;
/// The path slows down from the sliding speed at its own acceleration: 20 mm/s at 0.1 m/s², ms.
const PATH_STOP_MS: f64 = 200.0;
/// A service speaks of itself at least once a second, ms.
const HEALTH_MS: f64 = 1000.0;

/// What has to become of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The tool stops sliding, or leaves the surface, and nothing moves again by itself.
    Ends,
    /// The path stops and goes on when the fault is over.
    Waits,
    /// The task goes on through it.
    GoesOn,
}

/// One fault.
pub struct Case {
    /// Name on the command line and in the table.
    pub name: &'static str,
    /// What is done.
    pub what: &'static str,
    /// Who has to notice.
    pub notices: &'static str,
    /// Spread over processes as the fault needs it.
    pub layout: Layout,
    /// What has to become of the task.
    pub outcome: Outcome,
    /// How soon it has to be noticed, ms; none where nobody has to.
    pub noticed_within_ms: Option<f64>,
    /// Lets it happen.
    pub provoke: fn(&mut Stage) -> Result<()>,
    /// It is noticed by the arm's motion, which comes later than what moves it.
    pub by_motion: bool,
    /// From then until the arm is safe, ms.
    pub stop_ms: f64,
    /// When it was first noticed.
    pub noticed: fn(&Evidence, i64) -> Option<i64>,
    /// Ends it.
    pub repair: fn(&mut Stage) -> Result<()>,
    /// How long it is watched, s.
    pub watch_s: f64,
    /// Topic on which this program speaks too, out of the real publisher's count.
    pub impostor: Option<&'static str>,
}

impl Case {
    /// How soon it has to be seen that it was noticed, ms.
    pub fn seen_within_ms(&self) -> Option<f64> {
        let arm_ms = if self.by_motion { ARM_MS } else { 0.0 };
        self.noticed_within_ms.map(|ms| ms + arm_ms)
    }

    /// How soon the arm has to be safe, ms.
    pub fn safe_within_ms(&self) -> Option<f64> {
        match self.outcome {
            Outcome::GoesOn => None,
            _ => self.noticed_within_ms.map(|ms| ms + self.stop_ms),
        }
    }
}

fn case(name: &'static str, what: &'static str, notices: &'static str) -> Case {
    Case {
        name,
        what,
        notices,
        layout: Layout::Composed,
        outcome: Outcome::Ends,
        noticed_within_ms: None,
        by_motion: false,
        stop_ms: STOP_MS,
        provoke: |_| Ok(()),
        noticed: |_, _| None,
        repair: |_| Ok(()),
        watch_s: 1.0,
        impostor: None,
    }
}

/// Two cycles, the wrench's allowance for jitter, and the cycle in which it is seen.
const WRENCH_MS: f64 = 3.0 * CYCLE_MS + 4.0;
/// Two held, ramped to zero by the fifth.
const PROGRAM_MS: f64 = 5.0 * CYCLE_MS;
/// The estimate's patience, and the cycle in which it is seen.
const ESTIMATE_MS: f64 = 100.0 + CYCLE_MS;
/// The bridge's patience with the controller, and the cycle in which it is seen.
const COMMAND_MS: f64 = 3.0 * CYCLE_MS;
/// A packet of the robot that says so, and the controller's or bridge's answer.
const PACKET_MS: f64 = 2.0 * CYCLE_MS;
/// The sensor's patience.
const SILENCE_MS: f64 = 50.0;

/// All of them, those that share a layout together.
pub fn catalogue() -> Vec<Case> {
    let mut all = Vec::new();
    all.extend(of_the_bridge());
    all.extend(of_the_robot());
    all.extend(of_the_sensor());
    all.extend(of_the_estimator());
    all.extend(of_the_machine());
    all.extend(of_commands());
    all.extend(of_the_controller());
    all.extend(of_clocks());
    all.extend(of_the_surface());
    all
}

fn of_the_bridge() -> Vec<Case> {
    let base = |name, what| Case {
        noticed_within_ms: Some(PROGRAM_MS),
        by_motion: true,
        noticed: Evidence::slowed_ns,
        ..case(name, what, "robot program")
    };
    vec![
        Case {
            provoke: |s| s.cell.kill(s.cell.layout().bridge()),
            ..base("bridge_killed", "kill -9 of the hard loop's process")
        },
        Case {
            provoke: |s| s.cell.signal(s.cell.layout().bridge(), "STOP"),
            repair: |s| s.cell.signal(s.cell.layout().bridge(), "CONT"),
            ..base("bridge_hung", "SIGSTOP of the hard loop's process")
        },
        Case {
            provoke: |s| s.cell.robot("disconnect", ""),
            ..base(
                "robot_connection_cut",
                "every TCP connection to the robot closed",
            )
        },
    ]
}

fn of_the_robot() -> Vec<Case> {
    let not_ready = |e: &Evidence, t| e.arm_ns(t, |_, now| !now.ready);
    let base = |name, what| Case {
        noticed_within_ms: Some(PACKET_MS),
        noticed: not_ready,
        ..case(name, what, "rtde")
    };
    vec![
        Case {
            provoke: |s| s.cell.robot("freeze", "0.5"),
            noticed_within_ms: Some(PROGRAM_MS),
            by_motion: true,
            noticed: Evidence::slowed_ns,
            ..base(
                "robot_packets_stop",
                "no state from the robot for 0.5 s, connection open",
            )
        },
        Case {
            provoke: |s| s.cell.robot("drop_packets", "0.02"),
            repair: |s| s.cell.robot("drop_packets", "0"),
            noticed_within_ms: None,
            noticed: |e, t| e.arm_ns(t, |before, now| now.lost > before.lost),
            outcome: Outcome::GoesOn,
            ..base("robot_packets_lost", "2 % of the robot's packets lost")
        },
        Case {
            provoke: |s| s.cell.robot("protective_stop", ""),
            repair: |s| s.unlock(),
            ..base("protective_stop", "protective stop, as after a collision")
        },
        Case {
            provoke: |s| s.cell.robot("emergency_stop", "on"),
            repair: |s| {
                s.cell.robot("emergency_stop", "off")?;
                s.cell.robot("power_on", "")
            },
            ..base("emergency_stop", "emergency button")
        },
        Case {
            provoke: |s| s.cell.robot("restart", ""),
            repair: |s| s.cell.robot("power_on", ""),
            noticed_within_ms: Some(PROGRAM_MS),
            by_motion: true,
            noticed: Evidence::slowed_ns,
            notices: "the robot itself",
            watch_s: 2.0,
            ..base("robot_restart", "the robot's controller restarts")
        },
    ]
}

fn of_the_sensor() -> Vec<Case> {
    let ends = |name, what| Case {
        noticed_within_ms: Some(WRENCH_MS),
        noticed: Evidence::left_path_ns,
        ..case(name, what, "controller")
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
            // Bit 17, and the summary.
            provoke: |s| s.wire(Damage::Status { word: 0x8002_0000 }),
            repair: |s| s.wire(Damage::None),
            ..ends("sensor_saturated", "every record says a gauge is saturated")
        },
        Case {
            provoke: |s| s.wire(Damage::Status { word: 0x8000_8000 }),
            repair: |s| s.wire(Damage::None),
            ..ends("sensor_error", "every record says the sensor has an error")
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
                "before one of 20 datagrams: cut short, too long, and noise",
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
    ]
}

fn figure(service: &super::evidence::Service, name: &str) -> f64 {
    service
        .figures
        .iter()
        .find(|(n, _)| n == name)
        .map_or(0.0, |(_, value)| *value)
}

fn of_the_estimator() -> Vec<Case> {
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
                "nothing passes between the estimator and the router",
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

fn of_commands() -> Vec<Case> {
    let base = |name, what| Case {
        // They come every 10 ms, and a packet later the bridge says so.
        noticed_within_ms: Some(10.0 + PACKET_MS + CYCLE_MS),
        noticed: |e: &Evidence, t| e.arm_ns(t, |before, now| now.refused > before.refused),
        layout: Layout::Apart,
        impostor: Some("/arm/command"),
        ..case(name, what, "rtde")
    };
    let mad = |name, what, provoke| Case {
        provoke,
        repair: |s| {
            s.tell_no_more_lies()?;
            s.cell.signal("controller", "CONT")
        },
        ..base(name, what)
    };
    vec![
        mad(
            "command_not_finite",
            "the controller commands NaN, 100 a second",
            |s| s.lie(Lie::CommandNotFinite),
        ),
        mad(
            "command_beyond_limits",
            "the controller commands 8 rad/s",
            |s| s.lie(Lie::CommandBeyondLimits),
        ),
        mad(
            "command_replayed",
            "the controller answers the 50th packet before",
            |s| s.lie(Lie::CommandOld),
        ),
        Case {
            provoke: |s| s.lie(Lie::CommandOfAnother),
            repair: |s| s.tell_no_more_lies(),
            outcome: Outcome::GoesOn,
            ..base(
                "second_controller",
                "another controller's commands for the same task, 100 a second beside the true ones",
            )
        },
    ]
}

fn of_the_machine() -> Vec<Case> {
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

fn of_the_controller() -> Vec<Case> {
    let base = |name, what| Case {
        layout: Layout::Apart,
        noticed_within_ms: Some(COMMAND_MS),
        noticed: |e: &Evidence, t| e.arm_ns(t, |before, now| now.missed > before.missed),
        ..case(name, what, "rtde")
    };
    vec![
        Case {
            provoke: |s| s.cell.kill("controller"),
            ..base(
                "controller_killed",
                "kill -9 of a controller in a process of its own",
            )
        },
        Case {
            provoke: |s| s.cell.signal("controller", "STOP"),
            repair: |s| s.cell.signal("controller", "CONT"),
            ..base(
                "controller_hung",
                "SIGSTOP of a controller in a process of its own",
            )
        },
    ]
}

fn of_clocks() -> Vec<Case> {
    let base = |name, what| Case {
        layout: Layout::Relayed,
        ..case(name, what, "controller")
    };
    vec![
        Case {
            provoke: |s| s.set_sensor_clock(1.0),
            outcome: Outcome::GoesOn,
            notices: "nobody has to",
            watch_s: 1.5,
            ..base(
                "clock_set_forward",
                "the clock of netft's host is set forward by 1 s",
            )
        },
        Case {
            provoke: |s| s.set_sensor_clock(0.0),
            noticed_within_ms: Some(WRENCH_MS),
            noticed: Evidence::left_path_ns,
            // The host's clock is believed again after two seconds.
            watch_s: 2.5,
            ..base(
                "clock_set_back",
                "the clock of netft's host is set back by 1 s",
            )
        },
    ]
}

fn of_the_surface() -> Vec<Case> {
    vec![Case {
        layout: Layout::Ledge,
        provoke: |s| s.wait_for_the_edge(),
        outcome: Outcome::Waits,
        // Three cycles, and the one in which it is seen; the wrench is filtered.
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

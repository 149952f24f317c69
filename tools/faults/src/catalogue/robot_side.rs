//! Bridge, robot and controller that die, hang, stop or send bad commands.

use crate::evidence::Evidence;
use crate::impostor::Lie;
use crate::layout::Layout;

use super::{COMMAND_MS, CYCLE_MS, Case, Outcome, PACKET_MS, PROGRAM_MS, case};

pub(super) fn of_the_bridge() -> Vec<Case> {
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

pub(super) fn of_the_robot() -> Vec<Case> {
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
                s.power_on()
            },
            ..base("emergency_stop", "emergency button")
        },
        Case {
            provoke: |s| s.cell.robot("restart", ""),
            repair: |s| s.power_on(),
            noticed_within_ms: Some(PROGRAM_MS),
            by_motion: true,
            noticed: Evidence::slowed_ns,
            notices: "the robot itself",
            watch_s: 2.0,
            ..base("robot_restart", "the robot's controller restarts")
        },
    ]
}

pub(super) fn of_the_controller() -> Vec<Case> {
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

pub(super) fn of_commands() -> Vec<Case> {
    let base = |name, what| Case {
        // They are sent every 10 ms, and the bridge reports them one packet later.
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
            "the controller answers the packet of 50 cycles before",
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

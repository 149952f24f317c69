//! The bridge against a small scripted controller that speaks through the codec's other side.

mod bench;
mod guided;
mod hostile;

use bench::{Cell, posture};
use tangent_runtime::config::UrReading;

use crate::codec::*;
use crate::link::OwnWrench;
use crate::link_error::LinkError;
use crate::reason::Reason;
use crate::scripted_robot::{Program, Robot};

#[test]
fn from_connection_to_motion_on_both_series() {
    for series in [Series::Cb3, Series::ESeries] {
        let mut cell = Cell::ready(series);
        assert_eq!(cell.uploads, 1);
        assert!(cell.rests());
        cell.task();
        cell.until("motion", Cell::moves);
        cell.steps(100);
        assert!(cell.moves());
        assert_eq!(cell.bridge.packets_lost(), 0);
        assert_eq!(cell.bridge.gate().admission.missed(), 0);
        // Sent after one state, used in the next cycle, reported in that cycle's state.
        let latency = cell.bridge.latency_s();
        assert!((latency - series.period_s()).abs() < 1e-9, "{latency}");
    }
}

#[test]
fn nothing_is_allocated_between_packet_and_command() {
    for series in [Series::Cb3, Series::ESeries] {
        let mut cell = Cell::ready(series);
        cell.task();
        cell.until("motion", Cell::moves);
        let before = cell.allocations;
        cell.steps(1000);
        assert_eq!(cell.allocations, before);
    }
}

#[test]
fn protocol_1_is_fallen_back_to() {
    let mut robot = Robot::new(ControllerVersion::new(3, 10, 0));
    robot.v2 = false;
    let mut cell = Cell::new(robot, Some(Series::Cb3));
    cell.connect();
    cell.until("ready", |c| c.bridge.is_ready());
    assert_eq!(cell.bridge.link().protocol(), Protocol::V1);
    cell.task();
    cell.until("motion", Cell::moves);
}

fn refused(robot: Robot, series: Option<Series>) -> LinkError {
    let mut cell = Cell::new(robot, series);
    cell.connect();
    for _ in 0..100 {
        if let Err(error) = cell.step() {
            return error;
        }
    }
    panic!("nothing was refused");
}

#[test]
fn settings_that_cannot_work_are_refused_by_name() {
    let robot = Robot::new(ControllerVersion::new(3, 8, 1));
    let text = refused(robot, None).to_string();
    assert!(
        text.contains("3.8.1.0") && text.contains("needs 3.9"),
        "{text}"
    );

    let robot = Robot::new(ControllerVersion::new(5, 11, 0));
    let text = refused(robot, Some(Series::Cb3)).to_string();
    assert!(text.contains("model = \"ur5\" is a CB3 robot"), "{text}");

    let mut robot = Robot::new(ControllerVersion::new(3, 15, 8));
    robot.refuse = Some(("input_double_register_27", Slot::InUse));
    let text = refused(robot, None).to_string();
    assert!(
        text.starts_with(
            "input_double_register_27 is in use by another client, probably a second bridge"
        ),
        "{text}"
    );

    let mut robot = Robot::new(ControllerVersion::new(3, 15, 8));
    robot.refuse = Some(("output_int_register_30", Slot::NotFound));
    let text = refused(robot, None).to_string();
    assert_eq!(
        text,
        "the controller (3.15.8.0) does not have output_int_register_30"
    );
}

/// Every robot has `actual_TCP_force`, but not everything that speaks its protocol.
#[test]
fn a_controller_without_a_force_of_its_own_is_taken_unless_the_cell_needs_it() {
    let cell = |needed: bool, has_force: bool| {
        let mut robot = Robot::new(ControllerVersion::new(3, 15, 8));
        if !has_force {
            robot.refuse = Some(("actual_TCP_force", Slot::NotFound));
        }
        let own = OwnWrench {
            reading: UrReading::ActualTcpForce,
            needed,
        };
        let mut cell = Cell::with_wrench(robot, None, Some(own));
        cell.connect();
        for _ in 0..50 {
            if let Err(error) = cell.step() {
                return Err(error.to_string());
            }
        }
        assert!(cell.bridge.link().is_streaming());
        Ok::<_, String>(cell.bridge.sample().wrench.map(|wrench| wrench[2]))
    };
    assert_eq!(cell(false, true), Ok(Some(12.0)));
    assert_eq!(cell(true, true), Ok(Some(12.0)));
    assert_eq!(cell(false, false), Ok(None));
    assert_eq!(
        cell(true, false),
        Err("the controller (3.15.8.0) does not have actual_TCP_force".to_owned())
    );
}

#[test]
fn a_silent_controller_is_detected() {
    let mut cell = Cell::new(Robot::new(ControllerVersion::new(3, 15, 8)), None);
    cell.connect();
    assert!(cell.bridge.check(1.9).is_ok());
    let text = cell.bridge.check(2.1).unwrap_err().to_string();
    assert_eq!(
        text,
        "the controller did not answer which protocol it speaks within 2 s"
    );

    let mut cell = Cell::ready(Series::Cb3);
    cell.robot.streaming = false;
    let error = (0..1000).find_map(|_| cell.step().err()).unwrap();
    assert_eq!(error, LinkError::Silent { after_s: 1.0 });
}

#[test]
fn after_a_reconnection_nothing_moves_until_a_task_is_started() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    let session = cell.bridge.supervisor().session();
    cell.bridge.close();
    assert_eq!(cell.bridge.reason(), Some(Reason::NoLink));
    // The controller restarts and loses registers and program. The old task continues to send
    // commands.
    cell.robot = Robot::new(cell.robot.version);
    cell.connect();
    cell.until("ready again", |c| c.bridge.is_ready());
    assert_eq!(cell.uploads, 2);
    assert_ne!(cell.bridge.supervisor().session(), session);
    for _ in 0..200 {
        cell.step().unwrap();
        assert!(cell.rests());
    }
    assert!(cell.bridge.gate().admission.refused() > 0);
    cell.task();
    cell.until("motion", Cell::moves);
}

#[test]
fn a_protective_stop_is_reported_and_survived_without_moving() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.robot.sample.safety_mode = 3;
    cell.robot.sample.runtime_state = 4;
    cell.robot.sample.qd_commanded = [0.0; 6];
    cell.steps(2);
    assert_eq!(cell.bridge.reason(), Some(Reason::Safety(3)));
    assert_eq!(cell.bridge.reason().unwrap().to_string(), "protective stop");
    cell.steps(700);
    assert_eq!(cell.uploads, 1, "nothing is sent into a stop");
    cell.robot.sample.safety_mode = 1;
    cell.until("ready again", |c| c.bridge.is_ready());
    assert_eq!(cell.uploads, 2);
    cell.steps(50);
    assert!(cell.rests());
    cell.task();
    cell.until("motion", Cell::moves);
}

#[test]
fn a_program_that_replaced_ours_is_left_alone_until_a_reset() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.robot.program = Program::None;
    cell.robot.sample.ident = 77;
    cell.steps(2);
    assert_eq!(cell.bridge.reason(), Some(Reason::Replaced));
    cell.steps(500);
    assert_eq!(cell.uploads, 1);
    cell.bridge.reset();
    cell.until("ready again", |c| c.bridge.is_ready());
    assert_eq!(cell.uploads, 2);
}

#[test]
fn a_foreign_program_at_the_start_is_not_killed() {
    let mut robot = Robot::new(ControllerVersion::new(3, 15, 8));
    robot.sample.runtime_state = 2;
    let mut cell = Cell::new(robot, None);
    cell.connect();
    cell.steps(300);
    assert_eq!(cell.uploads, 0);
    assert_eq!(cell.bridge.reason(), Some(Reason::OtherProgram));
}

/// An operator's program runs after ours has ended: our registers keep their values, and no program
/// updates them.
#[test]
fn a_foreign_program_under_our_registers_is_not_killed() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.robot.program = Program::None;
    cell.robot.sample.runtime_state = 1;
    cell.steps(2);
    cell.robot.sample.runtime_state = 2;
    cell.steps(500);
    assert_eq!(cell.bridge.reason(), Some(Reason::OtherProgram));
    assert_eq!(cell.uploads, 1);
    // A new connection detects this too.
    cell.connect();
    cell.steps(500);
    assert_eq!(cell.uploads, 1);
    cell.robot.sample.runtime_state = 1;
    cell.until("ready again", |c| c.bridge.is_ready());
    assert_eq!(cell.uploads, 2);
}

#[test]
fn a_program_that_never_starts_is_tried_again_at_growing_intervals() {
    let mut cell = Cell::new(Robot::new(ControllerVersion::new(5, 11, 0)), None);
    cell.connect();
    let mut at = Vec::new();
    for _ in 0..20_000 {
        cell.step().unwrap();
        if cell.uploads as usize > at.len() {
            at.push(cell.now_s);
        }
        cell.robot.program = Program::None;
        cell.robot.sample.runtime_state = 1;
    }
    assert!((3..=5).contains(&at.len()), "{at:?}");
    assert!(at[2] - at[1] > at[1] - at[0], "{at:?}");
    let text = cell.bridge.reason().unwrap().to_string();
    assert!(
        text == "robot program is starting" || text.contains("remote control"),
        "{text}"
    );
}

#[test]
fn a_slow_slider_ramps_down_and_is_reported() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.robot.sample.target_speed_fraction = 0.2;
    cell.until("rest", Cell::rests);
    let text = cell.bridge.reason().unwrap().to_string();
    assert!(text.starts_with("robot runs at 20 % speed"), "{text}");
    cell.robot.sample.target_speed_fraction = 1.0;
    cell.steps(100);
    assert!(cell.bridge.is_ready() && cell.rests());
}

#[test]
fn skipped_packets_are_counted_and_a_long_gap_stops() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.robot.sample.timestamp_s += 3.0 * 0.008;
    cell.steps(20);
    assert_eq!(cell.bridge.packets_lost(), 3);
    assert!(cell.moves(), "three lost packets are no reason to stop");
    cell.robot.sample.timestamp_s += 6.0 * 0.008;
    cell.steps(30);
    assert_eq!(cell.bridge.packets_lost(), 9);
    assert!(cell.rests());
    assert_eq!(
        cell.bridge.gate().admission.activation_latched(),
        cell.activation
    );
}

#[test]
fn a_clock_that_goes_back_is_a_restart() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.robot.sample.timestamp_s = 0.0;
    let error = (0..5).find_map(|_| cell.step().err()).unwrap();
    assert!(matches!(error, LinkError::Restarted { .. }), "{error}");
}

#[test]
fn a_hung_program_is_noticed() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.robot.program = Program::None;
    cell.steps(8);
    assert_eq!(cell.bridge.reason(), Some(Reason::Hung));
    assert!(!cell.bridge.supervisor().is_alive());
}

#[test]
fn a_stop_latches_the_robot_and_it_is_armed_again_at_rest() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.bridge.stop();
    cell.until("latched", |c| c.robot.sample.program_state == 4);
    cell.until("armed", |c| c.bridge.is_ready());
    cell.steps(50);
    assert!(cell.rests());
    assert_eq!(cell.uploads, 1);
    cell.task();
    cell.until("motion", Cell::moves);
}

#[test]
fn a_foreign_session_needs_an_operator() {
    let mut cell = Cell::ready(Series::Cb3);
    (cell.robot.sample.program_state, cell.robot.sample.cause) = (4, 4);
    cell.steps(100);
    assert_eq!(cell.bridge.reason(), Some(Reason::ResetNeeded { cause: 4 }));
    cell.bridge.reset();
    cell.until("armed", |c| c.bridge.is_ready());
}

#[test]
fn the_end_is_ramp_exit_pause() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.bridge.end(cell.now_s);
    let finished = (0..200).any(|_| cell.step().unwrap());
    assert!(finished && cell.bridge.is_finished() && cell.robot.paused);
    assert_eq!(
        (cell.robot.sample.program_state, cell.robot.sample.cause),
        (9, 3)
    );
}

#[test]
fn without_a_connection_the_end_is_at_once() {
    let mut cell = Cell::new(Robot::new(ControllerVersion::new(3, 15, 8)), None);
    cell.bridge.end(0.0);
    assert!(cell.bridge.is_finished());
}

#[test]
fn a_silent_controller_task_ramps_down() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    cell.mute = true;
    cell.steps(40);
    assert!(cell.rests());
    assert_eq!(cell.bridge.gate().admission.activation_latched(), 1);
    assert!(cell.bridge.gate().admission.missed() > 2);
}

#[test]
fn a_silent_robot_is_no_missed_cycle() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    // The heartbeat continues while the robot's packets are late.
    let mut bytes = Vec::new();
    for _ in 0..40 {
        cell.now_s += 0.008;
        cell.bridge
            .command(&posture(&cell.bridge), None, cell.now_s, &mut bytes)
            .unwrap();
        cell.robot
            .receive(&std::mem::take(&mut bytes), &mut Vec::new());
        cell.robot.cycle(&mut Vec::new());
    }
    assert!(cell.rests());
    assert_eq!(cell.bridge.gate().admission.activation_latched(), 1);
    assert_eq!(cell.bridge.gate().admission.missed(), 0);
}

//! Hand guiding through the bridge: what makes the arm free, and what makes it hold itself again.

use super::bench::Cell;
use crate::bridge::GuideRefusal;
use crate::codec::{ControllerVersion, Series};
use crate::guiding::{GuideEnd, KEEP_ALIVE_S};
use crate::program::IDENT;
use crate::reason::Reason;
use crate::scripted_robot::Robot;

impl Cell {
    fn guided(series: Series) -> Self {
        let mut cell = Self::ready(series);
        cell.bridge.guide(cell.now_s).unwrap();
        cell.until("guided", Self::is_guided);
        cell
    }

    fn is_guided(&self) -> bool {
        self.robot.sample.program_state == 5
    }
}

#[test]
fn the_arm_is_free_until_the_client_ends_it_or_falls_silent() {
    for series in [Series::Cb3, Series::ESeries] {
        let mut cell = Cell::guided(series);
        assert_eq!(cell.bridge.reason(), Some(Reason::Guided));
        let keep = (0.5 * KEEP_ALIVE_S / series.period_s()) as usize;
        for _ in 0..4 {
            cell.steps(keep);
            cell.bridge.guide(cell.now_s).unwrap();
        }
        assert!(cell.is_guided());
        cell.bridge.end_guiding();
        cell.until("ready", |c| c.bridge.is_ready());

        cell.bridge.guide(cell.now_s).unwrap();
        cell.until("guided", Cell::is_guided);
        cell.steps(2 * keep + 5);
        assert!(cell.bridge.is_ready() && !cell.is_guided());
        assert_eq!(cell.bridge.guiding().ended(), GuideEnd::Silent);
    }
}

#[test]
fn no_task_moves_a_guided_arm_and_none_continues_afterwards() {
    let mut cell = Cell::guided(Series::Cb3);
    cell.task();
    cell.steps(50);
    assert!(cell.is_guided() && cell.rests());
    cell.bridge.end_guiding();
    cell.until("ready", |c| c.bridge.is_ready());
    cell.steps(50);
    assert!(cell.rests(), "a task from before would move the arm");
    cell.task();
    cell.until("motion", Cell::moves);
}

#[test]
fn a_task_or_a_robot_that_is_not_ready_refuses_it() {
    let mut cell = Cell::ready(Series::Cb3);
    cell.task();
    cell.until("motion", Cell::moves);
    let refusal = cell.bridge.guide(cell.now_s).unwrap_err();
    assert_eq!(refusal, GuideRefusal::TaskRuns);
    cell.steps(20);
    assert!(cell.moves());
    cell.robot.sample.safety_mode = 5;
    cell.steps(2);
    let words = cell.bridge.guide(cell.now_s).unwrap_err().to_string();
    assert_eq!(words, "the arm is not ready: safeguard stop");
}

#[test]
fn a_stop_a_fault_and_a_lost_link_end_it_for_good() {
    type End = fn(&mut Cell);
    let ends: [(&str, End, End); 3] = [
        ("stop", |cell| cell.bridge.stop(), |_| {}),
        (
            "safeguard stop",
            |cell| cell.robot.sample.safety_mode = 5,
            |cell| cell.robot.sample.safety_mode = 1,
        ),
        (
            "lost link",
            |cell| {
                cell.bridge.close();
                cell.connect();
            },
            |_| {},
        ),
    ];
    for (what, end, recover) in ends {
        let mut cell = Cell::guided(Series::Cb3);
        end(&mut cell);
        cell.steps(5);
        recover(&mut cell);
        assert!(!cell.bridge.guiding().is_asked(), "{what}");
        cell.until("ready", |c| c.bridge.is_ready());
        cell.steps(50);
        assert!(!cell.is_guided(), "{what}");
    }
}

#[test]
fn nothing_is_allocated_while_a_hand_guides() {
    let mut cell = Cell::guided(Series::Cb3);
    let before = cell.allocations;
    cell.steps(200);
    assert_eq!(cell.allocations, before);
}

#[test]
fn a_program_of_version_1_serves_tasks_and_refuses_guiding() {
    let mut cell = Cell::new(Robot::new(ControllerVersion::new(3, 15, 8)), None);
    cell.robot.ident = IDENT - 1;
    cell.connect();
    cell.until("ready", |c| c.bridge.is_ready());
    let refusal = cell.bridge.guide(cell.now_s).unwrap_err();
    assert_eq!(refusal, GuideRefusal::OldProgram(1));
    cell.task();
    cell.until("motion", Cell::moves);

    let mut newer = Cell::new(Robot::new(ControllerVersion::new(3, 15, 8)), None);
    newer.robot.ident = IDENT + 1;
    newer.connect();
    newer.steps(500);
    assert!(!newer.bridge.is_ready());
}

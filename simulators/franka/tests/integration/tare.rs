//! The zero of the wrench estimate: from which readings it is taken, and when it is refused.

use std::time::{Duration, Instant};

use tangent_control::Phase;
use tangent_live::timed;
use tangent_schemas::tangent::ControlState;
use tangent_schemas::topics;
use tangent_simulated_franka::FciFault;

use crate::rig::*;

#[test]
fn its_wrench_is_the_environments_and_can_be_tared() {
    timed(|| {
        let cell = Cell::new();
        let mut wrenches = cell.bus.latest(&topics::WRENCH_TOOL).unwrap();
        let mut statuses = cell.bus.latest(&topics::WRENCH_STATUS).unwrap();
        cell.ready();
        cell.states(300);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 6.0]));
        cell.states(1500);
        let pushed = wrenches.get().unwrap().message.wrench.force.clone();
        // The tool points down: up in the base is -z of the tool.
        assert!((pushed.z + 6.0).abs() < 0.5, "{pushed:?}");
        assert!(pushed.x.abs() < 0.5 && pushed.y.abs() < 0.5, "{pushed:?}");
        assert_eq!(statuses.get().unwrap().message.validity, 0);
        assert!(statuses.get().unwrap().message.bias_age_s < 0.0);
        // A contact force must not become the zero: the estimate is off by one or two newtons, not
        // by six.
        let refused = cell.try_ask(topics::queries::NETFT_TARE);
        assert!(
            !refused.done && refused.message.contains("touches"),
            "{}",
            refused.message
        );
        assert!(statuses.get().unwrap().message.bias_age_s < 0.0);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 2.0]));
        cell.states(1500);
        cell.ask(topics::queries::NETFT_TARE);
        cell.states(100);
        let tared = wrenches.get().unwrap().message.wrench.force.clone();
        assert!(tared.z.abs() < 0.2, "{tared:?}");
        assert!(statuses.get().unwrap().message.bias_age_s >= 0.0);
    });
}

/// The bug: a restarted bridge had lost the controller's last state, and took the force of a
/// pressing tool for its zero.
#[test]
fn a_tare_after_a_restart_is_refused_while_the_tool_presses() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::keeping(Some(folder.path()));
        cell.ready();
        cell.push(3.0);
        let control = cell.bus.publisher(&topics::CONTROL_STATE).unwrap();
        let deadline = Instant::now() + PATIENCE;
        // Written to the disk while the task runs, because a crash writes nothing.
        let file = folder.path().join("franka.json");
        while !std::fs::read_to_string(&file)
            .unwrap_or_default()
            .contains("\"contact_possible\": true")
        {
            assert!(Instant::now() < deadline, "nothing is written down");
            control.publish(&ControlState {
                phase: Phase::Slide as u8,
                contact_possible: true,
                ..ControlState::default()
            });
            std::thread::park_timeout(Duration::from_millis(5));
        }
        cell.again();
        cell.ready();
        cell.states(1500);
        let refused = cell.tare("tare", "");
        assert!(!refused.done, "{}", refused.message);
        for words in ["publishes nothing", "slide", "tare --clear"] {
            assert!(refused.message.contains(words), "{}", refused.message);
        }
        let (force_n, status) = cell.felt();
        assert!((force_n + 3.0).abs() < 0.5, "{force_n} N of 3 N are left");
        assert!(status.bias_age_s < 0.0);
        // A person has checked that the tool hangs free.
        cell.push(0.0);
        let tared = cell.tare("tare", "clear");
        assert!(tared.done, "{}", tared.message);
        assert!(cell.felt().1.bias_said_clear);
    });
}

/// The bug: 3 N were accepted as a zero, because only 5 N were refused.
#[test]
fn a_zero_that_jumps_is_refused_over_a_restart_too() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::keeping(Some(folder.path()));
        cell.ready();
        cell.states(1500);
        let (_, status) = cell.felt();
        assert!(status.reference_age_s < 0.0 && status.rated_share >= 0.0);
        let tared = cell.tare("tare", "");
        assert!(tared.done, "{}", tared.message);
        let (_, status) = cell.felt();
        assert!(status.bias_age_s >= 0.0 && status.reference_age_s >= 0.0);
        assert_eq!(status.reference, status.bias);
        let jumps = |cell: &Cell| {
            cell.push(3.0);
            let refused = cell.tare("tare", "");
            assert!(!refused.done, "{}", refused.message);
            assert!(
                refused.message.contains("would differ by"),
                "{}",
                refused.message
            );
            let (force_n, status) = cell.felt();
            assert!((force_n + 3.0).abs() < 0.5, "{force_n} N of 3 N are left");
            // The reading before the tare shows a force that a zero could hide.
            let beyond_n = status.untared.force.z - status.reference.force.z;
            assert!((beyond_n + 3.0).abs() < 0.5, "{beyond_n} N");
            assert!(
                (0.04..0.1).contains(&status.rated_share),
                "{}",
                status.rated_share
            );
        };
        jumps(&cell);
        cell.again();
        cell.ready();
        let (_, status) = cell.felt();
        assert!(status.bias_age_s > 1.0, "{} s", status.bias_age_s);
        jumps(&cell);
        cell.push(0.0);
        let tared = cell.tare("tare", "");
        assert!(tared.done, "{}", tared.message);
        // The tool is in contact after all: the confirmation is withdrawn, in the file too.
        assert!(cell.tare("withdraw", "").done);
        let (_, status) = cell.felt();
        assert!(status.bias_age_s < 0.0 && status.reference_age_s > 1.0);
    });
}

/// The mean estimate of a moving arm must not become a zero.
#[test]
fn an_arm_that_moves_is_not_tared() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        let refused = cell.tare("tare", "");
        assert!(
            !refused.done && refused.message.contains("moved"),
            "{}",
            refused.message
        );
        assert!(cell.felt().1.bias_age_s < 0.0);
    });
}

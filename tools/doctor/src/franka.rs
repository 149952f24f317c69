//! Checks a Franka: its connection, mode and errors, and the arrival of its states. The check
//! neither moves the arm nor changes a setting.

use std::time::Duration;

use tangent_franka::fci::{LOST_MAX, PERIOD_S, RobotMode};
use tangent_franka::inquiry::{Found, InquiryError, inquire};
use tangent_runtime::realtime::in_scheduled_thread;
use tangent_runtime::{CellConfig, State};
use tangent_schemas::tangent::Health;
use tangent_schemas::topics;

use crate::finding::Finding;
use crate::on_the_bus::RunningCell;

/// Time for which the robot's states are observed.
const LISTEN: Duration = Duration::from_secs(1);
/// Share of states lost or late from which a warning is given.
const MISSED_SOME: f64 = 0.01;
/// Share of states lost or late from which the arm cannot be controlled.
const MISSED_TOO_MANY: f64 = 0.1;

/// Checks the robot, or the bridge that is connected to it.
pub fn check(config: &CellConfig, cell: &RunningCell) -> Vec<Finding> {
    const CHECK: &str = "robot";
    let settings = match tangent_franka::Config::from_cell(config) {
        Ok(settings) => settings,
        Err(error) => {
            return vec![Finding::problem(
                CHECK,
                error.to_string(),
                "the bridge does not start",
                "correct the cell file",
            )];
        }
    };
    // The robot accepts one client at a time, and the bridge is connected.
    if let Some(instance) = cell.instance_of(tangent_franka::SERVICE) {
        return held(&instance, cell);
    }
    let (host, port, timeout) = (&settings.host, settings.port, settings.connect_timeout);
    let wish = &config.realtime;
    let ask = || inquire(host, port, timeout, LISTEN);
    // Uses the scheduling of the bridge's loop, so that the measured lateness applies to it too.
    let found = if wish.enabled {
        in_scheduled_thread(wish.loop_priority, |_| ask())
    } else {
        Some(ask())
    };
    match found {
        Some(Ok(found)) => judge(&found, config.tool.mass_kg),
        Some(Err(error)) => vec![refused(&format!("{host}:{port}: {error}"), &error)],
        None => vec![Finding::problem(
            CHECK,
            "the thread that queried it panicked",
            "this is a defect",
            "report it",
        )],
    }
}

fn refused(found: &str, error: &InquiryError) -> Finding {
    let (meaning, advice) = match error {
        InquiryError::Closed => (
            "another client is connected, or FCI is not activated: the bridge is rejected as well",
            "activate FCI in Desk; end the other client (a bridge of another cell, a program with libfranka)",
        ),
        InquiryError::Silent(_) => (
            "its states are sent over UDP, and none arrives",
            "check the firewalls on this machine: any UDP port, from the robot's address",
        ),
        InquiryError::Session(_) => (
            "the bridge cannot communicate with it",
            "a Franka Emika Robot (\"Panda\") with system 4.2 or newer is supported; for another robot correct [robot]",
        ),
        InquiryError::Io(_) | InquiryError::Frame(_) | InquiryError::Codec(_) => (
            "FCI does not answer: the bridge cannot connect",
            "is the robot on, the cable connected to its control box, [robot] address right, FCI activated in Desk? For a simulated cell: \
             `tangent run router simulator`",
        ),
    };
    Finding::problem("robot", found, meaning, advice)
}

fn judge(found: &Found, tool_kg: f64) -> Vec<Finding> {
    let mut findings = vec![
        Finding::ok("robot's software", "FCI version 5"),
        mode(found),
        states(found),
    ];
    if found.end_effector_kg > 0.0 && tool_kg > 0.0 {
        findings.push(Finding::warning(
            "robot's end effector",
            format!(
                "{:.2} kg as set in Desk, and [tool] mass_kg = {tool_kg}",
                found.end_effector_kg
            ),
            "the robot adds the two: if both describe the same tool, its weight counts twice",
            "set the end effector's mass to 0 in Desk, or [tool] mass_kg to the mass that Desk does not include",
        ));
    }
    findings
}

fn mode(found: &Found) -> Finding {
    const CHECK: &str = "robot's mode";
    let words = if found.errors.is_empty() {
        found.mode.to_string()
    } else {
        format!("{}: {}", found.mode, found.errors)
    };
    let (meaning, advice) = match found.mode {
        RobotMode::Idle if found.errors.is_empty() => return Finding::ok(CHECK, words),
        RobotMode::Idle => ("the robot refuses a motion", "see the reason in Desk"),
        RobotMode::Move => (
            "a program other than this cell moves it",
            "wait until it ends, or end it in Desk",
        ),
        RobotMode::Guiding => (
            "the arm does not take commands",
            "release the enabling buttons; select execution in Desk, not programming",
        ),
        RobotMode::Reflex => (
            "the arm does not move until it has recovered",
            "look for the cause; then `tangent robot unlock`, or the first task recovers it (docs/services/franka.md)",
        ),
        RobotMode::UserStopped => (
            "the arm does not move",
            "release the external activation device",
        ),
        RobotMode::AutomaticErrorRecovery => ("the arm does not move yet", "look again"),
        RobotMode::Other => (
            "the arm does not move",
            "unlock the joints in Desk, and see the reason there",
        ),
    };
    Finding::warning(CHECK, words, meaning, advice)
}

fn states(found: &Found) -> Finding {
    const CHECK: &str = "robot's states";
    let words = format!(
        "of {} in {:.1} s {} lost and {} late; longest pause {:.1} ms",
        found.states,
        found.states as f64 * PERIOD_S,
        found.lost,
        found.late,
        found.pause_max_s * 1e3
    );
    let share = found.missed_share();
    let stops = found.pause_max_s >= f64::from(LOST_MAX) * PERIOD_S;
    if share <= MISSED_SOME && !stops {
        return Finding::ok(CHECK, words);
    }
    let advice = "connect the control box directly to this machine's network card, without a switch; and follow the \
        findings above on scheduling, kernel and processor";
    if stops || share > MISSED_TOO_MANY {
        Finding::problem(
            CHECK,
            words,
            format!("the robot stops by itself when {LOST_MAX} answers in a row are late"),
            advice,
        )
    } else {
        Finding::warning(
            CHECK,
            words,
            "in each such cycle the arm keeps the torque of the cycle before",
            advice,
        )
    }
}

/// Findings from the reports of the bridge that is connected to the robot.
fn held(instance: &str, cell: &RunningCell) -> Vec<Finding> {
    const CHECK: &str = "robot";
    let found = format!("held by the cell's own bridge, {instance}");
    let Ok(Some(heard)) = cell.receive(&topics::health(tangent_franka::SERVICE)) else {
        return vec![Finding::warning(
            CHECK,
            format!("{found}, which publishes no health message"),
            "the state of the robot is not known",
            "tangent status",
        )];
    };
    let health: Health = heard.last;
    if health.state == State::Running as u8 {
        return vec![Finding::ok(
            CHECK,
            format!("{found}: healthy, {} states lost so far", health.lost),
        )];
    }
    vec![Finding::warning(
        CHECK,
        format!("{found}: {}", health.fault),
        "the arm does not move",
        "docs/services/franka.md lists the messages and what to do",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use tangent_franka::fci::ErrorFlags;
    use tangent_runtime::config::FrankaConfig;
    use tangent_runtime::{Bus, HealthReporter};
    use tangent_simulated_device::Ports;
    use tangent_simulated_franka::{FciConfig, FciFault, SimulatedFranka};

    const PATIENCE: Duration = Duration::from_secs(20);

    fn simulated() -> SimulatedFranka {
        SimulatedFranka::start(&FciConfig {
            ports: Ports::Ephemeral,
            ..FciConfig::default()
        })
        .unwrap()
    }

    fn cell_of(port: u16) -> CellConfig {
        let text = include_str!("../../../deploy/cell.franka.toml");
        let mut config = CellConfig::parse("cell.franka.toml", text).unwrap();
        config.realtime.enabled = false;
        config.robot.franka = Some(FrankaConfig {
            fci_port: port,
            ..FrankaConfig::default()
        });
        config
    }

    fn nobody() -> RunningCell {
        RunningCell::on(Bus::in_process("test"))
    }

    fn found<'a>(findings: &'a [Finding], check: &str) -> &'a Finding {
        findings
            .iter()
            .find(|f| f.check == check)
            .unwrap_or_else(|| panic!("nothing about {check} in {findings:?}"))
    }

    #[test]
    fn the_simulated_robot_is_well_and_stays_where_it_is() {
        let robot = simulated();
        let before = robot.snapshot().map(|s| s.state.q);
        let findings = check(&cell_of(robot.address().port()), &nobody());
        assert_eq!(found(&findings, "robot's software").level, Level::Ok);
        assert_eq!(found(&findings, "robot's mode").found, "idle");
        // The number that arrives in time depends on the machine.
        assert!(found(&findings, "robot's states").found.contains("lost"));
        let after = robot.snapshot().unwrap();
        assert_eq!(after.torque_step_max_nm, 0.0);
        if let Some(before) = before {
            let moved = before.iter().zip(after.state.q).map(|(a, b)| (a - b).abs());
            assert!(moved.fold(0.0, f64::max) < 1e-3);
        }
    }

    #[test]
    fn a_pressed_user_stop_and_lost_states_are_reported() {
        let robot = simulated();
        robot.fault(FciFault::UserStop(true));
        let config = cell_of(robot.address().port());
        let findings = std::thread::scope(|scope| {
            let asking = scope.spawn(|| check(&config, &nobody()));
            assert!(robot.wait_for(PATIENCE, |s| s.connected));
            let cycles = robot.snapshot().unwrap().cycles;
            assert!(robot.wait_for(PATIENCE, |s| s.cycles > cycles + 100));
            robot.fault(FciFault::DropStates(150));
            asking.join().unwrap()
        });
        let mode = found(&findings, "robot's mode");
        assert_eq!(mode.level, Level::Warning);
        assert!(mode.advice.contains("activation device"), "{mode:?}");
        let states = found(&findings, "robot's states");
        assert_eq!(states.level, Level::Problem, "{states:?}");
        assert!(states.found.contains("150 lost"), "{states:?}");
    }

    #[test]
    fn a_robot_in_use_and_an_absent_robot_are_distinguished() {
        let robot = simulated();
        let config = cell_of(robot.address().port());
        let _other = std::net::TcpStream::connect(robot.address()).unwrap();
        assert!(robot.wait_for(PATIENCE, |s| s.connections == 1));
        let second = &check(&config, &nobody())[0];
        assert_eq!(second.level, Level::Problem);
        assert!(second.meaning.contains("another client"), "{second:?}");
        drop(robot);
        let gone = &check(&config, &nobody())[0];
        assert!(gone.meaning.contains("does not answer"), "{gone:?}");
    }

    #[test]
    fn a_bridge_that_runs_is_asked_in_the_robot_s_place() {
        let bus = Bus::in_process("test");
        let health = HealthReporter::start(&bus, tangent_franka::SERVICE).unwrap();
        health.running();
        let cell = RunningCell::on(bus);
        // No process listens on port 1; a connection attempt would be reported.
        let well = &check(&cell_of(1), &cell)[0];
        assert_eq!(well.level, Level::Ok, "{well:?}");
        health.fault(format_args!("no connection to the robot"));
        let ill = &check(&cell_of(1), &cell)[0];
        assert_eq!(ill.level, Level::Warning);
        assert!(ill.found.contains("no connection"), "{ill:?}");
    }

    #[test]
    fn states_are_judged_by_share_and_by_the_longest_pause() {
        let with = |lost, late, pause_max_s| {
            states(&Found {
                mode: RobotMode::Idle,
                errors: ErrorFlags::default(),
                end_effector_kg: 0.0,
                states: 1000,
                lost,
                late,
                pause_max_s,
            })
            .level
        };
        assert_eq!(with(0, 3, 0.004), Level::Ok);
        assert_eq!(with(10, 30, 0.006), Level::Warning);
        assert_eq!(with(0, 19, 0.02), Level::Problem);
        assert_eq!(with(200, 0, 0.006), Level::Problem);
    }

    #[test]
    fn a_tool_that_is_set_at_the_robot_too_counts_twice() {
        let mut robot = Found {
            mode: RobotMode::Idle,
            errors: ErrorFlags::default(),
            end_effector_kg: 0.73,
            states: 1000,
            lost: 0,
            late: 0,
            pause_max_s: 0.001,
        };
        let twice = judge(&robot, 0.3);
        assert_eq!(found(&twice, "robot's end effector").level, Level::Warning);
        robot.end_effector_kg = 0.0;
        assert!(judge(&robot, 0.3).iter().all(|f| f.level == Level::Ok));
    }
}

//! Safety and power: stops, and what leads out of them.

use crate::dashboard::Dashboard;
use crate::modes::RobotMode;
use crate::rig::Rig;

#[test]
fn unlocking_takes_five_seconds_and_the_dashboard_lags() {
    let mut rig = Rig::cb3();
    let mut dashboard = Dashboard::default();
    rig.controller.protective_stop(157, 0, "test");
    rig.cycles(10);
    assert_eq!(
        dashboard.answer("safetymode", &mut rig.controller),
        "Safetymode: NORMAL"
    );
    rig.cycles(75);
    assert_eq!(
        dashboard.answer("safetymode", &mut rig.controller),
        "Safetymode: PROTECTIVE_STOP"
    );
    let mut ask = |rig: &mut Rig| dashboard.answer("unlock protective stop", &mut rig.controller);
    rig.cycles(530);
    assert!(ask(&mut rig).starts_with("Cannot unlock protective stop until 5s"));
    rig.cycles(15);
    assert_eq!(ask(&mut rig), "Protective stop releasing");
    assert!(rig.controller.safety().allows_motion());
}

#[test]
fn an_emergency_stop_takes_the_power_and_keeps_it() {
    let mut rig = Rig::cb3();
    rig.run(
        "def go():\n while True:\n  speedj([0.5,0,0,0,0,0], 4, 0.008)\n end\nend\n",
        60,
    );
    rig.controller.emergency_stop(true, true);
    rig.cycles(60);
    assert_eq!(rig.controller.robot_mode(), RobotMode::PowerOff);
    assert!(rig.speed() < 1e-6 && !rig.controller.is_playing());
    rig.controller.release_brakes();
    rig.cycles(300);
    assert_eq!(
        rig.controller.robot_mode(),
        RobotMode::PowerOff,
        "while the button is pressed"
    );
    rig.controller.emergency_stop(true, false);
    rig.controller.release_brakes();
    rig.cycles(300);
    assert_eq!(rig.controller.robot_mode(), RobotMode::Running);
}

#[test]
fn a_safeguard_stop_pauses_and_resumes() {
    let mut rig = Rig::cb3();
    rig.run(
        "def go():\n while True:\n  speedj([0.2,0,0,0,0,0], 4, 0.008)\n end\nend\n",
        60,
    );
    rig.controller.safeguard(true);
    rig.cycles(60);
    assert!(rig.speed() < 1e-6);
    rig.controller.safeguard(false);
    rig.cycles(60);
    assert!(rig.speed() > 0.19);
}

#[test]
fn the_slider_raised_from_zero_is_a_protective_stop() {
    let mut rig = Rig::cb3();
    rig.controller.set_slider(0.01);
    rig.controller.set_slider(1.0);
    assert!(rig.controller.safety().allows_motion());
    rig.controller.set_slider(0.0);
    rig.controller.set_slider(0.5);
    assert!(!rig.controller.safety().allows_motion());
}

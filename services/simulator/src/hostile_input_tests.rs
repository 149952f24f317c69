//! Random and malformed input on every way in: no panic, and the next well-formed request is
//! answered.

use proptest::prelude::*;
use tangent_rtde::codec::{Framer, Protocol, Reply};

use crate::config::{ControllerConfig, Flavour};
use crate::dashboard::Dashboard;
use crate::rig::Rig;
use crate::rtde_server::{Ownership, Session};
use crate::script_ports::Collector;
use crate::urscript::Program;

/// A package of a kind that exists, with any payload.
fn package() -> impl Strategy<Value = (u8, Vec<u8>)> {
    let kind = prop::sample::select(b"VvMUOISP?".to_vec());
    let names = "[a-z_0-9,]{0,60}".prop_map(String::into_bytes);
    let real = prop::sample::select(vec![
        "input_int_register_0,",
        "timestamp,actual_q",
        ",,,,",
        "speed_slider_mask,speed_slider_fraction",
    ]);
    let real = real.prop_map(|s| s.as_bytes().to_vec());
    let payload = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..80),
        names,
        real.clone(),
        (any::<f64>(), real).prop_map(|(f, names)| [f.to_be_bytes().to_vec(), names].concat()),
        Just(vec![0, 2]),
    ];
    (kind, payload)
}

proptest! {
    #[test]
    fn rtde(packages in prop::collection::vec(package(), 0..30)) {
        let mut rig = Rig::cb3();
        let mut ownership = Ownership::default();
        let mut session = Session::new(1, Flavour::Cb3.version());
        let mut out = Vec::new();
        for (kind, payload) in &packages {
            session.handle(*kind, payload, &mut ownership, &mut out);
            rig.cycle();
            let summary = rig.controller.summary();
            session.package(1, &rig.controller, &summary);
        }
        out.clear();
        session.handle(b'v', &[], &mut ownership, &mut out);
        let mut framer = Framer::new(65_535);
        framer.push(&out);
        let package = framer.next_package().unwrap().unwrap();
        let reply = Reply::decode(package.kind, package.payload, Protocol::V2).unwrap();
        prop_assert_eq!(reply, Reply::ControllerVersion(Flavour::Cb3.version()));
    }

    #[test]
    fn dashboard(lines in prop::collection::vec("\\PC{0,40}", 0..10)) {
        let mut rig = Rig::new(ControllerConfig::default());
        let mut dashboard = Dashboard::default();
        for line in &lines {
            prop_assert!(!dashboard.answer(line, &mut rig.controller).is_empty());
        }
        prop_assert!(dashboard.answer("robotmode", &mut rig.controller).starts_with("Robotmode: "));
    }

    #[test]
    fn scripts(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "\\PC{0,100}") {
        let mut rig = Rig::cb3();
        let mut collector = Collector::default();
        for item in collector.push(&bytes).unwrap() {
            rig.run(&item, 1);
        }
        let _ = Program::compile(&text, true);
    }
}

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
    use crate::modes::RobotMode;
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

//! The program that `rtde` uploads, run by the controller: what the arm does when the bridge
//! behaves and when it does not.

use tangent_rtde::codec::{Series, Value};
use tangent_rtde::program::{IDENT, ProgramConfig, RegisterMap};

use crate::config::{ControllerConfig, Flavour};
use crate::modes::SafetyMode;
use crate::rig::Rig;

const SESSION: i32 = 77_001;

struct Bridge {
    rig: Rig,
    seq: i32,
    session: i32,
    flags: i32,
    step_s: f64,
}

impl Bridge {
    fn new(flavour: Flavour) -> Self {
        let mut rig = Rig::new(ControllerConfig {
            flavour,
            program_start_s: 0.0,
            compile_s_per_line: 0.0,
            ..ControllerConfig::default()
        });
        let series = match flavour {
            Flavour::Cb3 => Series::Cb3,
            Flavour::ESeries => Series::ESeries,
        };
        let program = ProgramConfig {
            registers: RegisterMap::new(24).unwrap(),
            session: SESSION,
            series,
            speed_max_rad_per_s: 1.0,
            acceleration_max_rad_per_s2: 8.0,
            stop_deceleration_rad_per_s2: 4.0,
            watchdog: true,
        };
        rig.controller.upload(&program.render().unwrap());
        Self {
            rig,
            seq: 100,
            session: SESSION,
            flags: 0,
            step_s: flavour.period_s(),
        }
    }

    /// One package and one cycle.
    fn send(&mut self, command: i32, qd: f64) {
        self.seq += 1;
        let names: Vec<String> = RegisterMap::new(24).unwrap().input_names();
        let mut values: Vec<Value> = [command, self.seq, self.session, self.flags]
            .map(Value::Int32)
            .to_vec();
        values.push(Value::Double(qd));
        values.extend([Value::Double(0.0); 5]);
        values.push(Value::Double(8.0));
        self.rig.controller.write_inputs(&names, &values);
        self.rig.cycle();
    }

    fn seconds(&mut self, s: f64, command: i32, qd: f64) {
        for _ in 0..(s / self.step_s) as usize {
            self.send(command, qd);
        }
    }

    fn silence(&mut self, s: f64) {
        self.rig.cycles((s / self.step_s) as usize);
    }

    fn state(&self) -> i32 {
        self.rig.out(24)
    }

    fn cause(&self) -> i32 {
        self.rig.out(28)
    }

    fn armed(flavour: Flavour) -> Self {
        let mut bridge = Self::new(flavour);
        bridge.seconds(0.2, 0, 0.0);
        assert_eq!(bridge.rig.exceptions(), Vec::<&str>::new());
        assert_eq!((bridge.state(), bridge.rig.out(26)), (1, IDENT));
        assert_eq!(bridge.rig.out(27), SESSION);
        bridge
    }

    fn moving(flavour: Flavour) -> Self {
        let mut bridge = Self::armed(flavour);
        bridge.seconds(0.3, 1, 0.5);
        assert_eq!(bridge.state(), 2);
        assert!((bridge.rig.speed() - 0.5).abs() < 1e-6);
        assert_eq!(
            bridge.rig.out(25),
            bridge.seq,
            "every sequence is used in its cycle"
        );
        bridge
    }
}

#[test]
fn silence_ramps_latches_and_ends_without_a_protective_stop() {
    for flavour in [Flavour::Cb3, Flavour::ESeries] {
        let mut bridge = Bridge::moving(flavour);
        bridge.silence(0.016);
        assert!(bridge.rig.speed() > 0.49, "held for two CB3 cycles");
        bridge.silence(0.050);
        assert_eq!((bridge.cause(), bridge.state()), (1, 3), "{flavour:?}");
        bridge.silence(0.2);
        assert_eq!((bridge.cause(), bridge.state()), (1, 4));
        assert!(bridge.rig.speed() < 1e-6);
        assert!(bridge.rig.controller.is_playing());
        bridge.silence(0.5);
        assert_eq!(bridge.state(), 9);
        assert!(!bridge.rig.controller.is_playing());
        bridge.silence(2.0);
        assert_eq!(
            bridge.rig.controller.safety(),
            SafetyMode::Normal,
            "the watchdog went with the program"
        );
    }
}

#[test]
fn a_latched_stop_is_left_only_by_a_rising_flag() {
    let mut bridge = Bridge::moving(Flavour::Cb3);
    bridge.seconds(0.4, 2, 0.5);
    assert_eq!((bridge.state(), bridge.cause()), (4, 3));
    bridge.seconds(0.1, 1, 0.5);
    assert_eq!(bridge.state(), 4, "data alone never moves the arm again");
    bridge.flags = 1;
    bridge.seconds(0.1, 1, 0.5);
    assert_eq!(bridge.state(), 4, "nor while a velocity is commanded");
    bridge.seconds(0.1, 0, 0.0);
    assert_eq!((bridge.state(), bridge.cause()), (1, 0));
    bridge.seconds(0.2, 1, 0.3);
    assert!((bridge.rig.speed() - 0.3).abs() < 1e-6);
}

#[test]
fn a_wrong_session_never_arms_and_a_changed_one_stops() {
    let mut bridge = Bridge::new(Flavour::Cb3);
    bridge.session = 5;
    bridge.seconds(2.5, 0, 0.0);
    assert_eq!((bridge.state(), bridge.cause()), (9, 4));
    assert!(!bridge.rig.controller.is_playing());

    let mut bridge = Bridge::moving(Flavour::Cb3);
    bridge.session = 5;
    bridge.seconds(0.3, 1, 0.5);
    assert_eq!((bridge.state(), bridge.cause()), (4, 4));
    assert!(bridge.rig.speed() < 1e-6);
}

#[test]
fn what_is_not_a_number_stops_and_what_is_too_fast_is_scaled() {
    for bad in [f64::NAN, f64::INFINITY, 1e7] {
        let mut bridge = Bridge::moving(Flavour::Cb3);
        bridge.seconds(0.3, 1, bad);
        assert_eq!((bridge.state(), bridge.cause()), (4, 5), "{bad}");
        assert!(bridge.rig.speed() < 1e-6);
        assert_eq!(bridge.rig.exceptions(), Vec::<&str>::new());
    }
    let mut bridge = Bridge::moving(Flavour::Cb3);
    bridge.seconds(0.3, 1, 5.0);
    assert_eq!((bridge.state(), bridge.cause()), (2, 2));
    assert!((bridge.rig.speed() - 1.0).abs() < 1e-6);
}

#[test]
fn exit_stops_the_arm_and_ends_the_program() {
    let mut bridge = Bridge::moving(Flavour::Cb3);
    bridge.seconds(0.4, 3, 0.0);
    assert_eq!((bridge.state(), bridge.cause()), (9, 3));
    assert!(!bridge.rig.controller.is_playing());
    assert!(bridge.rig.speed() < 1e-6);
    assert_eq!(bridge.rig.controller.safety(), SafetyMode::Normal);
}

#[test]
fn a_hung_program_is_caught_by_the_watchdog() {
    let mut rig = Rig::cb3();
    let program = "def hung():\n rtde_set_watchdog(\"input_int_register_25\", 0.8, \"stop\")\n while True:\n  speedj([0.2, 0, 0, 0, 0, 0], 2, 0.008)\n end\nend\n";
    rig.run(program, 100);
    assert_eq!(rig.controller.safety(), SafetyMode::Normal);
    for _ in 0..200 {
        rig.set("input_int_register_25", Value::Int32(0));
        rig.cycle();
    }
    assert_eq!(
        rig.controller.safety(),
        SafetyMode::Normal,
        "an unchanged value feeds it too"
    );
    rig.cycles(170);
    assert_eq!(rig.controller.safety(), SafetyMode::ProtectiveStop);
    assert!(rig.speed() < 1e-6);
}

#[test]
fn a_hand_guides_the_arm_while_every_package_asks_for_it() {
    for flavour in [Flavour::Cb3, Flavour::ESeries] {
        let mut bridge = Bridge::armed(flavour);
        let hand = [0.0, 10.0, 0.0, 0.0, 0.0, 0.0];
        bridge.rig.controller.push(hand);
        bridge.seconds(0.2, 0, 0.0);
        assert!(bridge.rig.speed() < 1e-9);
        bridge.seconds(0.3, 4, 0.0);
        assert_eq!((bridge.state(), bridge.cause()), (5, 0));
        assert!(bridge.rig.speed() > 0.02, "{flavour:?}");
        // A velocity is not followed before the arm has held itself.
        bridge.send(1, 0.5);
        assert_eq!(bridge.state(), 1);
        bridge.seconds(0.2, 0, 0.0);
        assert!(bridge.rig.speed() < 1e-9, "{}", bridge.rig.speed());

        // Silence ends it like any motion.
        bridge.seconds(0.3, 4, 0.0);
        assert!(bridge.rig.speed() > 0.02);
        bridge.silence(0.2);
        assert_eq!((bridge.state(), bridge.cause()), (4, 1));
        assert!(bridge.rig.speed() < 1e-9);
        assert_eq!(bridge.rig.controller.safety(), SafetyMode::Normal);
        assert_eq!(bridge.rig.exceptions(), Vec::<&str>::new());
    }
}

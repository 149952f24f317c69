use super::*;
use tangent_actuation::Refusal;
use tangent_mechanics::ModelData;
use tangent_schemas::convert::joint_array;
use tangent_simulation::{TorqueArm, TorqueArmConfig};

struct Bench {
    gate: TorqueGate,
    arm: TorqueArm<6>,
    cycle: u64,
    speeds: Vec<f64>,
    torques: Vec<Joints<6>>,
}

fn source(id: u8) -> Source {
    Source {
        publisher: [id; 16],
        ..Source::default()
    }
}

impl Bench {
    fn new() -> Self {
        let model = Arm::<6>::new(&ModelData::builtin("smart3s_substitute").unwrap()).unwrap();
        let q = model.home();
        Self {
            gate: TorqueGate::new(model, &q, 1e-3),
            arm: TorqueArm::new(model, &TorqueArmConfig::default(), q),
            cycle: 10,
            speeds: Vec::new(),
            torques: Vec::new(),
        }
    }

    /// A command that moves joint 1 at 0.3 rad/s.
    fn command(&self) -> ArmCommand {
        let mut wanted = Joints::<6>::zeros();
        wanted[0] = 0.3;
        let (mass, bias) = self
            .arm
            .model()
            .mass_matrix_and_bias(&self.arm.q, &self.arm.qd);
        let torque = mass * ((wanted - self.arm.qd) * 20.0) + bias;
        ArmCommand {
            cycle: self.cycle,
            kind: 2,
            values: joint_array(&torque),
            activation: 2,
            ..ArmCommand::default()
        }
    }

    fn cycle(&mut self, command: Option<&ArmCommand>) {
        self.cycle_of(1, command);
    }

    /// One period, in which `id` sends `command`.
    fn cycle_of(&mut self, id: u8, command: Option<&ArmCommand>) {
        let now_s = self.cycle as f64 * 1e-3;
        let admitted = command.filter(|c| self.gate.admit(&source(id), c.activation, now_s));
        let torque = self
            .gate
            .step(admitted, self.cycle, &self.arm.q, &self.arm.qd);
        for _ in 0..4 {
            self.arm.step(&torque, &Joints::<6>::zeros(), 0.25e-3);
        }
        self.cycle += 1;
        self.speeds.push(self.arm.qd.amax());
        self.torques.push(torque);
    }

    /// The command of a controller before a task is started.
    fn hold(&self, activation: u64) -> ArmCommand {
        ArmCommand {
            kind: 0,
            activation,
            ..self.command()
        }
    }

    fn refusal(&self) -> Refusal {
        *self.gate.admission().refusal().unwrap()
    }

    fn moving(mut self) -> Self {
        let before = self.hold(1);
        self.cycle(Some(&before));
        for _ in 0..500 {
            let command = self.command();
            self.cycle(Some(&command));
        }
        assert!(self.arm.qd[0] > 0.25);
        self
    }
}

#[test]
fn the_arm_holds_until_a_motion_is_commanded() {
    let mut bench = Bench::new();
    let start = bench.arm.q;
    for _ in 0..1000 {
        bench.cycle(None);
    }
    assert!((bench.arm.q - start).amax() < 1e-6);
    assert_eq!(bench.gate.admission().missed(), 0);
}

#[test]
fn silence_is_tolerated_then_the_arm_comes_to_rest_smoothly_and_stays() {
    let mut bench = Bench::new().moving();
    bench.cycle(None);
    bench.cycle(None);
    assert!(bench.speeds.last().unwrap() > &0.25);
    let torques = bench.torques.len();
    for _ in 0..400 {
        bench.cycle(None);
    }
    assert!(bench.speeds.last().unwrap() < &1e-3);
    let effort = bench.gate.effort;
    for pair in bench.torques[torques..].windows(2) {
        let step = (pair[1] - pair[0]).component_div(&effort).amax();
        assert!(step < 0.05, "{step} of the effort at once");
    }
    assert_eq!(bench.gate.admission().activation_latched(), 2);
    let late = bench.command();
    bench.cycle(Some(&late));
    assert!(matches!(
        bench.refusal(),
        Refusal::Latched { activation: 2, .. }
    ));
    let mut anew = bench.command();
    anew.activation = 3;
    bench.cycle(Some(&anew));
    assert_eq!(bench.gate.rest, None);
}

#[test]
fn an_invalid_command_is_refused_with_the_reason_and_ends_the_motion() {
    type Spoil = fn(&mut ArmCommand);
    let bad: [(Spoil, &str); 6] = [
        (|c| c.values[2] = f64::NAN, "finite"),
        (|c| c.values[1] = 1e9, "joint 2"),
        (|c| c.values.truncate(5), "5 joint values"),
        (|c| c.kind = 1, "kind 1"),
        (|c| c.cycle -= 50, "cycle"),
        (|c| c.cycle += 5, "cycle"),
    ];
    for (corrupt, word) in bad {
        let mut bench = Bench::new().moving();
        let mut command = bench.command();
        corrupt(&mut command);
        bench.cycle(Some(&command));
        let reason = bench.refusal().to_string();
        assert!(reason.contains(word), "{reason}");
        for _ in 0..400 {
            bench.cycle(None);
        }
        assert!(bench.speeds.last().unwrap() < &1e-3, "{word}");
    }
}

#[test]
fn a_second_source_is_refused_and_the_first_goes_on() {
    let mut bench = Bench::new().moving();
    let command = bench.command();
    let now_s = bench.cycle as f64 * 1e-3;
    assert!(!bench.gate.admit(&source(2), 2, now_s));
    bench.cycle(Some(&command));
    let refusal = bench.gate.lease().refusal_of(&source(2));
    assert!(refusal.contains("drives this arm"));
    assert_eq!(bench.gate.lease().rival(now_s), Some(&source(2)));
    assert_eq!(bench.gate.rest, None);
}

#[test]
fn a_new_holder_cannot_go_on_with_what_it_brings() {
    // A controller that returns in the middle of its task, or another one, with any activation.
    for brought in [1, 2, 3, 1_000_000] {
        let mut bench = Bench::new().moving();
        for _ in 0..600 {
            bench.cycle(None);
        }
        let start = bench.arm.q;
        for _ in 0..200 {
            let mut command = bench.command();
            command.activation = brought;
            bench.cycle_of(2, Some(&command));
        }
        assert_eq!(bench.gate.lease().holder(), Some(&source(2)));
        let moved = (bench.arm.q - start).amax();
        assert!(moved < 1e-3, "activation {brought} moved {moved} rad");
        let latched = bench.gate.admission().activation_latched();
        assert!(
            matches!(bench.refusal(), Refusal::Latched { activation, .. } if activation == brought)
        );
        let mut anew = bench.command();
        anew.activation = latched + 1;
        bench.cycle_of(2, Some(&anew));
        assert_eq!(bench.gate.rest, None);
    }
}

#[test]
fn no_source_takes_the_arm_over_while_it_brakes() {
    let mut bench = Bench::new().moving();
    for _ in 0..=PATIENCE {
        bench.cycle(None);
    }
    assert!(bench.arm.qd.amax() > STANDS_RAD_PER_S);
    // Even if its holder has been silent for a long time.
    assert!(!bench.gate.admit(&source(2), 9, 1e6));
    for _ in 0..600 {
        bench.cycle(None);
    }
    assert!(bench.gate.admit(&source(2), 9, 1e6));
}

#[test]
fn the_same_answer_twice_is_refused_and_moves_nothing() {
    let mut bench = Bench::new().moving();
    let again = bench.command();
    bench.cycle(Some(&again));
    let missed = bench.gate.admission().missed();
    for _ in 0..400 {
        bench.cycle(Some(&again));
        let late = bench.cycle - 1 - again.cycle > u64::from(PATIENCE);
        let refusal = bench.refusal();
        let duplicate = refusal == Refusal::Duplicate { cycle: again.cycle };
        assert!(duplicate || late, "{refusal:?}");
    }
    assert!(bench.gate.admission().missed() > missed);
    assert!(bench.speeds.last().unwrap() < &1e-3);
}

#[test]
fn what_is_refused_cannot_come_back_with_its_activation() {
    let mut bench = Bench::new().moving();
    let mut bad = bench.command();
    bad.activation = 5;
    bad.values[2] = f64::NAN;
    bench.cycle(Some(&bad));
    let mut next = bench.command();
    next.activation = 5;
    bench.cycle(Some(&next));
    assert!(matches!(
        bench.refusal(),
        Refusal::Latched { activation: 5, .. }
    ));
}

#[test]
fn a_hold_brings_it_to_rest_without_latching() {
    let mut bench = Bench::new().moving();
    for _ in 0..400 {
        let mut hold = bench.command();
        hold.kind = 0;
        bench.cycle(Some(&hold));
    }
    assert!(bench.speeds.last().unwrap() < &1e-3);
    assert_eq!(bench.gate.admission().activation_latched(), 1);
}

use nalgebra::{SMatrix, Vector3};
use proptest::prelude::*;
use tangent_mechanics::Joints;

use crate::command::Command;
use crate::motion_limits::MotionLimits;
use crate::refusal::Refusal;
use crate::torque::*;

const PERIOD_S: f64 = 0.001;
/// Maximum change of the output, Nm per cycle: below the robot's limit of 1.
const STEP_NM: f64 = 0.9 + 1e-12;

fn limits() -> TorqueLimits<7> {
    TorqueLimits {
        motion: MotionLimits {
            speed_rad_per_s: Joints::repeat(1.0),
            position_lower_rad: Joints::repeat(-2.0),
            position_upper_rad: Joints::repeat(2.0),
            tool_speed_max_m_per_s: 0.25,
            tool_turn_rate_max_rad_per_s: 1.0,
            workspace_lower_m: Vector3::repeat(-1.0),
            workspace_upper_m: Vector3::repeat(1.0),
        },
        torque_nm: Joints::from([70.0, 70.0, 70.0, 70.0, 9.6, 9.6, 9.6]),
        torque_rate_nm_per_s: Joints::repeat(900.0),
        hold_stiffness: Joints::repeat(100.0),
        hold_damping: Joints::repeat(10.0),
        patience_cycles: 2,
        silence_latch_s: 0.1,
    }
}

fn at_rest() -> Posture<7> {
    Posture {
        q: Joints::zeros(),
        qd: Joints::zeros(),
        torque: Joints::zeros(),
        tool_m: Vector3::zeros(),
        tool_jacobian: SMatrix::zeros(),
    }
}

/// Runs the gate with a robot that applies its output.
struct Bench {
    gate: TorqueGate<7>,
    posture: Posture<7>,
    cycle: u64,
}

impl Bench {
    fn new() -> Self {
        Self {
            gate: TorqueGate::new(limits(), PERIOD_S),
            posture: at_rest(),
            cycle: 0,
        }
    }

    fn step(&mut self, command: Option<(u8, &[f64], u64)>) -> Allowed<7> {
        self.cycle += 1;
        let wanted = command.map(|(kind, values, activation)| Command {
            cycle: self.cycle,
            kind,
            values,
            acceleration: 0.0,
            activation,
        });
        let allowed = self
            .gate
            .step(self.cycle, Permission::Move, &self.posture, wanted.as_ref());
        let step = (allowed.torque - self.posture.torque).amax();
        assert!(
            step <= STEP_NM,
            "a step of {step} Nm in cycle {}",
            self.cycle
        );
        self.posture.torque = allowed.torque;
        allowed
    }

    fn follow(&mut self, torque: [f64; 7], cycles: usize) {
        for _ in 0..cycles {
            assert!(self.step(Some((2, &torque, 1))).following);
        }
    }
}

#[test]
fn a_step_in_the_command_leaves_as_a_ramp() {
    let mut bench = Bench::new();
    let torque = [10.0, -5.0, 3.0, 0.0, 0.5, 0.0, -2.0];
    bench.follow(torque, 1);
    assert!((bench.posture.torque[0] - 0.9).abs() < 1e-9);
    assert_eq!(bench.gate.limited(), 1);
    bench.follow(torque, 20);
    assert_eq!(bench.posture.torque, Joints::from(torque));
    assert_eq!(bench.gate.admission.refused(), 0);
}

#[test]
fn silence_is_ridden_out_for_two_cycles_then_the_arm_is_held_without_a_step() {
    let mut bench = Bench::new();
    let torque = [8.0, -4.0, 2.0, 1.0, 0.5, 0.2, -0.1];
    bench.follow(torque, 30);
    for _ in 0..2 {
        assert!(bench.step(None).following);
        assert_eq!(bench.posture.torque, Joints::from(torque));
    }
    let allowed = bench.step(None);
    assert!(!allowed.following);
    let mut before = bench.posture.torque;
    for _ in 0..300 {
        bench.step(None);
        // The old torque fades out, and nothing replaces it while the arm stands.
        assert!(bench.posture.torque[0] <= before[0]);
        before = bench.posture.torque;
    }
    assert_eq!(bench.posture.torque, Joints::<7>::zeros());
    assert_eq!(bench.gate.admission.activation_latched(), 1);
    // The old activation no longer moves the arm; a new one does.
    assert!(!bench.step(Some((2, &torque, 1))).following);
    assert!(matches!(
        bench.gate.admission.refusal(),
        Some(Refusal::Latched { .. })
    ));
    assert!(bench.step(Some((2, &torque, 2))).following);
}

#[test]
fn a_held_arm_is_damped_and_pulled_back() {
    let mut bench = Bench::new();
    bench.step(Some((0, &[], 0)));
    for _ in 0..400 {
        bench.step(None);
    }
    bench.posture.q[3] = 0.05;
    bench.posture.qd[5] = 0.2;
    for _ in 0..20 {
        bench.step(None);
    }
    assert!((bench.posture.torque[3] + 5.0).abs() < 1e-9);
    assert!((bench.posture.torque[5] + 2.0).abs() < 1e-9);
    // The spring force stays limited, however far the arm is pushed.
    bench.posture.q[3] = 1.0;
    for _ in 0..100 {
        bench.step(None);
    }
    assert!((bench.posture.torque[3] + 21.0).abs() < 1e-9);
}

#[test]
fn what_is_bad_is_refused_and_not_followed_in_that_cycle() {
    let good = [5.0; 7];
    let cases: [(&[f64], u8, &str); 6] = [
        (
            &[1.0, f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0],
            2,
            "not a finite number",
        ),
        (
            &[f64::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            2,
            "not a finite number",
        ),
        (&[1.0; 6], 2, "6 joint values for 7 joints"),
        (
            &[0.0, 0.0, 0.0, 0.0, 20.0, 0.0, 0.0],
            2,
            "joint 5 at 20.00 Nm, limit 9.60 Nm",
        ),
        (&[0.0; 7], 1, "kind 1"),
        (&[0.0; 7], 9, "kind 9"),
    ];
    for (values, kind, words) in cases {
        let mut bench = Bench::new();
        bench.follow(good, 10);
        assert!(!bench.step(Some((kind, values, 1))).following, "{words}");
        let said = bench.gate.admission.refusal().unwrap().to_string();
        assert!(said.contains(words), "{said}");
        assert_eq!(bench.gate.admission.refused(), 1);
        // One bad command does not end the task: the next good one is followed.
        assert!(bench.step(Some((2, &good, 1))).following);
    }
}

#[test]
fn old_duplicate_and_future_answers_are_refused() {
    let mut gate = TorqueGate::new(limits(), PERIOD_S);
    let torque = [1.0; 7];
    let mut give = |now: u64, answers: u64| {
        let wanted = Command {
            cycle: answers,
            kind: 2,
            values: &torque,
            acceleration: 0.0,
            activation: 1,
        };
        gate.step(now, Permission::Move, &at_rest(), Some(&wanted));
        gate.admission.refusal().copied()
    };
    assert_eq!(give(10, 10), None);
    assert_eq!(give(11, 10), Some(Refusal::Duplicate { cycle: 10 }));
    assert_eq!(give(12, 20), Some(Refusal::Future { cycle: 20 }));
    assert_eq!(give(30, 27), Some(Refusal::Old { age: 3 }));
}

#[test]
fn an_arm_that_leaves_its_limits_is_held_and_latched() {
    type Change = fn(&mut Posture<7>);
    let cases: [(Change, &str); 4] = [
        (|p| p.qd[2] = 1.3, "joint 3 at 1.30 rad/s"),
        (
            |p| {
                p.q[6] = 2.01;
                p.qd[6] = 0.1;
            },
            "joint 7 at 2.010 rad",
        ),
        (
            |p| {
                p.tool_jacobian[(0, 0)] = 1.0;
                p.qd[0] = 0.4;
            },
            "tool at 0.400 m/s",
        ),
        (|p| p.tool_m.z = -1.2, "tool at z = -1.200 m"),
    ];
    for (change, words) in cases {
        let mut bench = Bench::new();
        bench.follow([2.0; 7], 10);
        change(&mut bench.posture);
        assert!(!bench.step(Some((2, &[2.0; 7], 1))).following, "{words}");
        let said = bench.gate.trip().unwrap().to_string();
        assert!(said.contains(words), "{said}");
        assert!(!bench.step(Some((2, &[2.0; 7], 1))).following);
        assert!(matches!(
            bench.gate.admission.refusal(),
            Some(Refusal::Latched { .. })
        ));
    }
    // A joint on its way back inside may be moved.
    let mut bench = Bench::new();
    bench.posture.q[6] = 2.01;
    bench.posture.qd[6] = -0.1;
    bench.follow([0.0; 7], 3);
}

#[derive(Clone, Debug)]
enum Act {
    Good([f64; 7]),
    Bad(f64),
    Silence(u8),
    Latch,
    Off,
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        5 => proptest::array::uniform7(-9.0..9.0f64).prop_map(Act::Good),
        1 => prop_oneof![Just(f64::NAN), Just(f64::NEG_INFINITY), Just(1e9)].prop_map(Act::Bad),
        1 => (1u8..150).prop_map(Act::Silence),
        1 => Just(Act::Latch),
        1 => Just(Act::Off),
    ]
}

proptest! {
    /// For any sequence of inputs, the output is finite, within the limits, and within the robot's
    /// rate limit of the applied torque.
    #[test]
    fn what_leaves_is_always_within_the_robots_bounds(
        acts in proptest::collection::vec(act(), 1..60),
        motion in proptest::array::uniform7(-3.0..3.0f64),
    ) {
        let mut gate = TorqueGate::new(limits(), PERIOD_S);
        let mut posture = at_rest();
        let mut cycle = 0;
        let mut activation = 1;
        for (n, act) in acts.iter().enumerate() {
            posture.qd = Joints::from(motion) * (n as f64).sin();
            posture.q = Joints::from(motion) * (0.3 * n as f64).cos();
            let (times, permission) = match act {
                Act::Silence(times) => (*times, Permission::Move),
                Act::Off => (1, Permission::Off),
                _ => (1, Permission::Move),
            };
            if let Act::Latch = act {
                gate.admission.latch();
                activation += 1;
            }
            for _ in 0..times {
                cycle += 1;
                let values = match act {
                    Act::Good(values) => Some(*values),
                    Act::Bad(value) => Some([*value; 7]),
                    _ => None,
                };
                let wanted = values.as_ref().map(|values| Command { cycle, kind: 2, values, acceleration: 0.0, activation });
                let allowed = gate.step(cycle, permission, &posture, wanted.as_ref());
                if permission == Permission::Off {
                    // The robot's own controller is active; torques start from zero again.
                    posture.torque = Joints::zeros();
                    continue;
                }
                let l = limits();
                for i in 0..7 {
                    prop_assert!(allowed.torque[i].is_finite());
                    prop_assert!(allowed.torque[i].abs() <= l.torque_nm[i]);
                    prop_assert!((allowed.torque[i] - posture.torque[i]).abs() <= STEP_NM);
                }
                posture.torque = allowed.torque;
            }
        }
    }
}

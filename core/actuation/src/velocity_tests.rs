//! Every limit holds for any input to the gate.

use nalgebra::{Matrix6, Vector3, Vector6};
use proptest::prelude::*;

use crate::command::Command;
use crate::motion_limits::MotionLimits;
use crate::refusal::Refusal;
use crate::velocity::*;

const PERIOD: f64 = 0.008;

fn limits() -> VelocityLimits<6> {
    VelocityLimits {
        motion: MotionLimits {
            speed_rad_per_s: Vector6::repeat(1.0),
            position_lower_rad: Vector6::repeat(-2.0),
            position_upper_rad: Vector6::repeat(2.0),
            tool_speed_max_m_per_s: 0.25,
            tool_turn_rate_max_rad_per_s: 1.5,
            workspace_lower_m: Vector3::new(-0.3, -0.4, -0.5),
            workspace_upper_m: Vector3::new(0.3, 0.4, 0.5),
        },
        acceleration_rad_per_s2: Vector6::new(8.0, 8.0, 8.0, 12.0, 12.0, 15.0),
        response_s: 0.04,
        patience_cycles: 2,
        silence_latch_s: 0.1,
    }
}

/// Turn of joint `c` in row `r` of a made-up arm.
fn phase(r: usize, c: usize) -> f64 {
    (r * 2 + c) as f64
}

/// Tool position of a made-up arm: smooth in q, and large enough that speed limit and walls bite.
fn tool(q: &Vector6<f64>) -> Vector3<f64> {
    Vector3::from_fn(|r, _| (0..6).map(|c| -0.2 * (q[c] + phase(r, c)).cos()).sum())
}

/// Its Jacobian; the turn rates are made up too.
fn posture(q: &Vector6<f64>) -> Posture<6> {
    Posture {
        q: *q,
        tool_m: tool(q),
        tool_jacobian: Matrix6::from_fn(|r, c| match r {
            0..3 => 0.2 * (q[c] + phase(r, c)).sin(),
            _ => 0.7 * (q[c] - phase(r, c)).cos(),
        }),
    }
}

/// An arm whose tool never moves: only the joints' limits apply.
fn joints_only(q: &Vector6<f64>) -> Posture<6> {
    Posture {
        q: *q,
        tool_m: Vector3::zeros(),
        tool_jacobian: Matrix6::zeros(),
    }
}

fn velocity(values: &[f64], cycle: u64) -> Command<'_> {
    Command {
        cycle,
        kind: 1,
        values,
        acceleration: 0.0,
        activation: 1,
    }
}

fn step(gate: &mut VelocityGate<6>, cycle: u64, wanted: Option<&Command<'_>>) -> Allowed<6> {
    gate.step(
        cycle,
        Permission::Move,
        &joints_only(&Vector6::zeros()),
        wanted,
    )
}

#[derive(Clone, Debug)]
struct Move {
    kind: u8,
    values: Vec<f64>,
    acceleration: f64,
    late: u64,
    activation: u64,
    given: bool,
    permission: Permission,
    repeat: u8,
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        12 => -1.0f64..1.0,
        2 => prop_oneof![Just(1.0), Just(-1.0), Just(0.0)],
        1 => -5.0f64..5.0,
        1 => any::<u64>().prop_map(f64::from_bits),
    ]
}

fn moves() -> impl Strategy<Value = Vec<Move>> {
    let one = (
        prop_oneof![12 => Just(1u8), 1 => Just(0u8), 1 => any::<u8>()],
        prop_oneof![
            12 => prop::collection::vec(number(), 6),
            1 => prop::collection::vec(number(), 0..8),
        ],
        prop_oneof![4 => Just(0.0), 2 => 0.1f64..50.0, 1 => any::<u64>().prop_map(f64::from_bits)],
        prop_oneof![10 => Just(0u64), 2 => 1u64..4],
        prop_oneof![8 => Just(u64::MAX), 1 => 0u64..4],
        prop::bool::weighted(0.9),
        prop_oneof![20 => Just(Permission::Move), 1 => Just(Permission::RampDown)],
        1u8..60,
    );
    prop::collection::vec(one, 1..30).prop_map(|list| {
        list.into_iter()
            .map(
                |(kind, values, acceleration, late, activation, given, permission, repeat)| Move {
                    kind,
                    values,
                    acceleration,
                    late,
                    activation,
                    given,
                    permission,
                    repeat,
                },
            )
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn for_any_stream_of_commands_every_limit_holds(
        start in prop::array::uniform6(-2.0f64..2.0), moves in moves(),
    ) {
        let limits = limits();
        let mut gate = VelocityGate::new(limits.clone(), PERIOD);
        let mut q = Vector6::from(start);
        let mut before = Vector6::<f64>::zeros();
        let mut cycle = 0;
        for m in &moves {
            for _ in 0..m.repeat {
                cycle += 1;
                let activation = if m.activation == u64::MAX { gate.admission.activation_latched() + 1 } else { m.activation };
                let wanted = Command {
                    cycle: u64::saturating_sub(cycle, m.late),
                    kind: m.kind,
                    values: &m.values,
                    acceleration: m.acceleration,
                    activation,
                };
                let posture = posture(&q);
                let soft = m.kind == 3;
                let out = gate.step(cycle, m.permission, &posture, m.given.then_some(&wanted));
                prop_assert!(out.qd.iter().all(|v| v.is_finite()));
                for i in 0..6 {
                    prop_assert!(out.qd[i].abs() <= limits.motion.speed_rad_per_s[i] + 1e-12);
                    // A soft stop is the robot's own ramp: the gate stops at once.
                    if !soft {
                        let reach = limits.acceleration_rad_per_s2[i] * PERIOD;
                        prop_assert!((out.qd[i] - before[i]).abs() <= reach * (1.0 + 1e-9),
                            "joint {i}: {} after {}", out.qd[i], before[i]);
                    }
                }
                let twist = posture.tool_jacobian * out.qd;
                let (speed, turn) = (twist.fixed_rows::<3>(0).norm(), twist.fixed_rows::<3>(3).norm());
                prop_assert!(speed <= limits.motion.tool_speed_max_m_per_s * (1.0 + 1e-9), "tool at {speed} m/s");
                prop_assert!(turn <= limits.motion.tool_turn_rate_max_rad_per_s * (1.0 + 1e-9), "tool at {turn} rad/s");
                if m.kind == 1 && m.acceleration > 0.0 && m.given && gate.admission.cycle_accepted() == cycle
                    && out.qd.norm() > before.norm() {
                    for i in 0..6 {
                        prop_assert!((out.qd[i] - before[i]).abs() <= m.acceleration * PERIOD * (1.0 + 1e-9) + 1e-12);
                    }
                }
                before = out.qd;
                q += out.qd * PERIOD;
                let at = tool(&q);
                for i in 0..3 {
                    let (lower, upper) = (limits.motion.workspace_lower_m[i], limits.motion.workspace_upper_m[i]);
                    // The tool may start outside the box; once inside, it stays.
                    if (lower..=upper).contains(&posture.tool_m[i]) {
                        prop_assert!((lower..=upper).contains(&at[i]), "tool at {} m, axis {i}", at[i]);
                    }
                }
                for i in 0..6 {
                    prop_assert!((-2.0 - 1e-9..=2.0 + 1e-9).contains(&q[i]), "joint {i} at {} rad", q[i]);
                }
            }
        }
    }

    /// Also from outside its range, where somebody may have jogged it: a joint never moves further
    /// out.
    #[test]
    fn from_beyond_a_stop_it_only_moves_inwards(
        over in 0.0f64..1.0, joint in 0usize..6, values in prop::array::uniform6(-1.0f64..1.0),
    ) {
        let mut gate = VelocityGate::new(limits(), PERIOD);
        let mut q = Vector6::zeros();
        q[joint] = 2.0 + over;
        for cycle in 1..200 {
            let out = gate.step(cycle, Permission::Move, &joints_only(&q), Some(&velocity(&values, cycle)));
            prop_assert!(q[joint] < 2.0 || out.qd[joint] <= 0.0);
            q += out.qd * PERIOD;
        }
    }
}

#[test]
fn a_good_stream_is_followed_exactly_once_up_to_speed() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let values = [0.1, -0.2, 0.3, 0.0, 0.05, -0.05];
    for cycle in 1..=10 {
        let out = step(&mut gate, cycle, Some(&velocity(&values, cycle)));
        assert!(out.streaming);
    }
    assert_eq!(*gate.qd(), Vector6::from(values));
    assert_eq!(
        (
            gate.admission.refused(),
            gate.admission.missed(),
            gate.limited()
        ),
        (0, 0, 0)
    );
}

#[test]
fn it_slows_down_before_a_joint_limit_and_gets_close_to_it() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let mut q = Vector6::new(1.5, 0.0, 0.0, 0.0, 0.0, 0.0);
    let values = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for cycle in 1..1000 {
        let wanted = velocity(&values, cycle);
        let out = gate.step(cycle, Permission::Move, &joints_only(&q), Some(&wanted));
        q += out.qd * PERIOD;
    }
    assert!(q[0] <= 2.0 && q[0] > 1.9999, "{}", q[0]);
}

#[test]
fn silence_is_ridden_out_for_two_cycles_then_ramps_then_latches() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let values = [0.5; 6];
    let mut cycle = 0;
    for _ in 0..20 {
        cycle += 1;
        step(&mut gate, cycle, Some(&velocity(&values, cycle)));
    }
    for _ in 0..2 {
        cycle += 1;
        assert_eq!(step(&mut gate, cycle, None).qd, Vector6::repeat(0.5));
    }
    cycle += 1;
    let first = step(&mut gate, cycle, None).qd;
    assert!((first[0] - (0.5 - 8.0 * PERIOD)).abs() < 1e-12);
    assert_eq!(gate.admission.activation_latched(), 0);
    for _ in 0..12 {
        cycle += 1;
        step(&mut gate, cycle, None);
    }
    assert_eq!(*gate.qd(), Vector6::zeros());
    assert_eq!(gate.admission.activation_latched(), 1);
    // The same task does not resume by itself; a newer one does.
    cycle += 1;
    let out = step(&mut gate, cycle, Some(&velocity(&values, cycle)));
    assert!(!out.streaming && out.qd == Vector6::zeros());
    assert!(matches!(
        gate.admission.refusal(),
        Some(Refusal::Latched {
            activation: 1,
            latched: 1
        })
    ));
    cycle += 1;
    let newer = Command {
        activation: 2,
        ..velocity(&values, cycle)
    };
    assert!(step(&mut gate, cycle, Some(&newer)).qd[0] > 0.0);
}

#[test]
fn every_refusal_is_named_counted_and_slows_down() {
    let good = [0.3; 6];
    let fast = [0.0, 0.0, 1.5, 0.0, 0.0, 0.0];
    let nan = [f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0];
    let base = velocity(&good, 0);
    for (bad, text, ramps) in [
        (
            Command { kind: 2, ..base },
            "kind 2 is not one of 0 (hold), 1 (joint velocity), 3 (soft stop)",
            true,
        ),
        (
            Command {
                values: &good[..5],
                ..base
            },
            "5 joint values for 6 joints",
            true,
        ),
        (
            Command {
                values: &nan,
                ..base
            },
            "a value is not a finite number",
            true,
        ),
        (
            Command {
                acceleration: f64::NAN,
                ..base
            },
            "a value is not a finite number",
            true,
        ),
        (
            Command {
                values: &fast,
                ..base
            },
            "joint 3 at 1.500 rad/s, limit 1.000 rad/s",
            true,
        ),
    ] {
        let mut gate = VelocityGate::new(limits(), PERIOD);
        for cycle in 1..=20 {
            step(&mut gate, cycle, Some(&velocity(&good, cycle)));
        }
        let out = step(&mut gate, 21, Some(&Command { cycle: 21, ..bad }));
        assert_eq!(gate.admission.refused(), 1, "{text}");
        assert_eq!(gate.admission.refusal().unwrap().to_string(), text);
        assert_eq!(out.qd[0] < 0.3, ramps, "{text}");
        // One bad command among good ones is not yet a reason to start over.
        for cycle in 22..=40 {
            step(&mut gate, cycle, Some(&velocity(&good, cycle)));
        }
        assert_eq!(*gate.qd(), Vector6::repeat(0.3), "{text}");
    }
}

#[test]
fn old_future_and_repeated_cycles_are_refused() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let values = [0.1; 6];
    step(&mut gate, 100, Some(&velocity(&values, 97)));
    assert_eq!(gate.admission.refusal(), Some(&Refusal::Old { age: 3 }));
    step(&mut gate, 101, Some(&velocity(&values, 102)));
    assert_eq!(
        gate.admission.refusal(),
        Some(&Refusal::Future { cycle: 102 })
    );
    step(&mut gate, 102, Some(&velocity(&values, 101)));
    step(&mut gate, 103, Some(&velocity(&values, 101)));
    assert_eq!(
        gate.admission.refusal(),
        Some(&Refusal::Duplicate { cycle: 101 })
    );
    assert_eq!(gate.admission.refused(), 3);
}

#[test]
fn what_was_running_while_the_robot_could_not_move_stays_out() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let values = [0.1; 6];
    let five = |cycle| Command {
        activation: 5,
        ..velocity(&values, cycle)
    };
    let zero = joints_only(&Vector6::zeros());
    gate.step(1, Permission::Off, &zero, Some(&five(1)));
    assert_eq!(gate.admission.activation_latched(), 5);
    for cycle in 2..10 {
        let out = gate.step(cycle, Permission::Move, &zero, Some(&five(cycle)));
        assert!(!out.streaming);
    }
}

#[test]
fn a_soft_stop_goes_to_the_robot_whatever_the_activation() {
    let mut gate = VelocityGate::new(limits(), PERIOD);
    let values = [0.3; 6];
    for cycle in 1..=10 {
        step(&mut gate, cycle, Some(&velocity(&values, cycle)));
    }
    let stop = Command {
        kind: 3,
        values: &[],
        activation: 0,
        ..velocity(&values, 11)
    };
    let out = step(&mut gate, 11, Some(&stop));
    assert!(out.soft_stop && !out.streaming);
    assert_eq!(gate.admission.activation_latched(), 1);
}

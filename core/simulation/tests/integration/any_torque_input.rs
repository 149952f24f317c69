//! The torque laws under arbitrary inputs: every bit pattern in every field, in the middle of a
//! task.

// A whole file of tests: what fails here is the test.
use std::sync::OnceLock;

use nalgebra::{Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use tangent_control::{
    Fault, HybridDynamics, HybridInput, Law, Limits, Phase, UnifiedForceImpedance, UnifiedInput,
    UntaredLoad,
};
use tangent_mechanics::{Arm, Pose};
use tangent_sensing::Validity;
use tangent_simulation::systems::visuo_tactile::reproduction::step_inputs;
use tangent_simulation::{
    ObjectPlant, ObjectScenario, Undisturbed, VisuoTactilePlant, VisuoTactileScenario,
    evaluate_object_with, stated_arm,
};

const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");
const PLANE: &str = include_str!("../../../../scenarios/lippiello/lippiello_plane.toml");

/// Control period of both scenarios, s.
const PERIOD_S: f64 = 1e-3;
/// Number of fields of an input, for the law that has more.
const FIELDS: u32 = 21;
/// Number of validity codes that are tried: all valid ones, and one that is invalid.
const CODES: u64 = 16;
/// Number of cycles that the law slides before its inputs are corrupted.
const SLID: usize = 200;

/// Ordinary numbers, arbitrary bit patterns, and special values.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -2.0f64..2.0,
        2 => any::<u64>().prop_map(f64::from_bits),
        1 => prop::sample::select(vec![
            f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 1e150, -1e150, f64::MIN_POSITIVE, 0.0, -0.0,
        ]),
    ]
}

/// Bit mask of the fields of a cycle to corrupt, and the values to put there.
fn mess() -> impl Strategy<Value = (u32, Vec<f64>)> {
    let fields =
        prop_oneof![2 => Just(0u32), 3 => (0..FIELDS).prop_map(|i| 1 << i), 1 => any::<u32>()];
    (fields, prop::collection::vec(number(), 64))
}

/// Supplies the numbers one after the other, repeatedly.
struct Numbers<'a>(std::iter::Cycle<std::slice::Iter<'a, f64>>);

impl Numbers<'_> {
    fn next(&mut self) -> f64 {
        *self.0.next().unwrap()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next())
    }

    fn matrix(&mut self) -> Matrix3<f64> {
        Matrix3::from_fn(|_, _| self.next())
    }

    fn validity(&mut self) -> Validity {
        Validity::from((self.next().to_bits() % CODES) as u8)
    }

    fn pose<A, B>(&mut self) -> Pose<A, B> {
        let turn = Quaternion::new(self.next(), self.next(), self.next(), self.next());
        Pose::new(self.vector(), UnitQuaternion::new_unchecked(turn))
    }
}

/// Result of one cycle.
struct Step {
    torque: Vec<f64>,
    /// All other outputs.
    said: Vec<f64>,
    phase: Phase,
    fault: Option<Fault>,
}

/// A law in the middle of a task, and the last input that led there.
trait Bench {
    type Input: Copy;
    /// Largest torque of each joint, Nm.
    fn effort(&self) -> Vec<f64>;
    /// The input of a good cycle.
    fn good(&self) -> Self::Input;
    fn step(&mut self, input: &Self::Input) -> Step;
    /// Shifts the time of `input` by `by_s`, s.
    fn later(input: &mut Self::Input, by_s: f64);
    /// Replaces the fields in `mask` by numbers.
    fn spoil(input: &mut Self::Input, mask: u32, numbers: &mut Numbers<'_>);
}

struct Hybrid {
    law: HybridDynamics,
    model: Arm<6>,
    good: HybridInput,
}

/// The scenario, and the inputs of the law until it has slid for [`SLID`] cycles.
fn hybrid_inputs() -> &'static (ObjectScenario, Vec<HybridInput>) {
    static INPUTS: OnceLock<(ObjectScenario, Vec<HybridInput>)> = OnceLock::new();
    INPUTS.get_or_init(|| {
        let scenario = ObjectScenario::parse("lippiello_plane", PLANE, &[]).unwrap();
        let (mut inputs, mut slid) = (Vec::new(), 0);
        evaluate_object_with(&scenario, &mut Undisturbed, |c| {
            slid += usize::from(c.output.phase == Phase::Slide);
            if slid <= SLID {
                inputs.push(*c.input);
            }
        })
        .unwrap();
        assert!(slid > SLID);
        (scenario, inputs)
    })
}

impl Hybrid {
    fn sliding() -> Self {
        let (scenario, inputs) = hybrid_inputs();
        let plant = &scenario.plant;
        let model = stated_arm::<6>(&plant.robot, &plant.tool).unwrap();
        let corners = scenario.estimation.target.corners();
        let tool = ObjectPlant::<6>::new(plant, corners, scenario.seed)
            .unwrap()
            .flange_from_tool();
        let shape = Box::new(scenario.object_surface().unwrap());
        let law = scenario.law().unwrap();
        // The arm of this bench stands still whatever its motors do: to the law, it is held.
        let limits = Limits {
            unread_force_max_n: 1000.0,
            ..scenario.limits
        };
        let mut law =
            HybridDynamics::new(model, tool, limits, &law, &scenario.task, shape).unwrap();
        for input in inputs {
            law.step(input);
        }
        assert_eq!(law.phase(), Phase::Slide);
        let good = *inputs.last().unwrap();
        Self { law, model, good }
    }
}

impl Bench for Hybrid {
    type Input = HybridInput;

    fn effort(&self) -> Vec<f64> {
        self.model.limits().effort.unwrap().as_slice().to_vec()
    }

    fn good(&self) -> HybridInput {
        self.good
    }

    fn step(&mut self, input: &HybridInput) -> Step {
        let output = self.law.step(input);
        let mut said = vec![
            output.force_reference_n,
            output.force_n.unwrap_or_default(),
            output.path_error_m,
            output.path_progress,
            output.alignment_error_rad,
            output.manipulability,
        ];
        said.extend(output.normal.iter().chain(output.path_reference.iter()));
        said.extend(output.reference_in_object.iter().flat_map(|v| v.iter()));
        Step {
            torque: output.torque.as_slice().to_vec(),
            said,
            phase: output.phase,
            fault: output.fault,
        }
    }

    fn later(input: &mut HybridInput, by_s: f64) {
        input.time_s += by_s;
    }

    fn spoil(input: &mut HybridInput, mask: u32, n: &mut Numbers<'_>) {
        let on = |bit: u32| mask & (1 << bit) != 0;
        if on(0) {
            input.time_s = n.next();
        }
        if on(1) {
            input.dt_s = n.next();
        }
        if on(2) {
            input.q[n.next().to_bits() as usize % 6] = n.next();
        }
        if on(3) {
            input.qd[n.next().to_bits() as usize % 6] = n.next();
        }
        if on(4) {
            input.wrench.force = n.vector();
        }
        if on(5) {
            input.wrench.torque = n.vector();
        }
        if on(6) {
            input.wrench_validity = n.validity();
        }
        if on(7) {
            input.wrench_age_s = n.next();
        }
        if on(8) {
            input.bias_age_s = Some(n.next());
        }
        if on(9) {
            input.estimate_age_s = n.next();
        }
        if on(10) {
            input.estimate = None;
        }
        if let Some(estimate) = &mut input.estimate {
            if on(11) {
                estimate.base_from_object = n.pose();
            }
            if on(12) {
                estimate.covariance = Matrix6::from_fn(|_, _| n.next());
            }
            if on(13) {
                estimate.validity = n.validity();
            }
            if on(14) {
                estimate.twist.linear = n.vector();
                estimate.twist.angular = n.vector();
                estimate.vision_age_s = n.next();
                estimate.force_n = n.next();
            }
        }
        if on(15) {
            input.zero_bound_n = Some(n.next());
        }
        if on(16) {
            input.untared = Some(UntaredLoad {
                beyond_reference_n: Some(n.next()),
                rated_share: Some(n.next()),
            });
        }
        if on(17) {
            input.arm_ready = n.next() > -1.9;
        }
    }
}

struct Unified {
    law: UnifiedForceImpedance,
    effort: Vec<f64>,
    good: UnifiedInput,
}

fn unified_inputs() -> &'static (VisuoTactileScenario, Vec<UnifiedInput>) {
    static INPUTS: OnceLock<(VisuoTactileScenario, Vec<UnifiedInput>)> = OnceLock::new();
    INPUTS.get_or_init(|| {
        let set = ["task.path.duration_s=2.0".to_owned()];
        let scenario = VisuoTactileScenario::parse("karacan_wave", WAVE, &set).unwrap();
        let mut inputs = step_inputs(&scenario).unwrap();
        let mut law = scenario.controller::<7>().unwrap();
        let mut slid = 0;
        let until = inputs
            .iter()
            .position(|input| {
                slid += usize::from(law.step(input).phase == Phase::Slide);
                slid > SLID
            })
            .unwrap();
        inputs.truncate(until);
        (scenario, inputs)
    })
}

impl Unified {
    fn sliding() -> Self {
        let (scenario, inputs) = unified_inputs();
        let plant = VisuoTactilePlant::<7>::new(&scenario.plant, scenario.seed).unwrap();
        let mut law = scenario.controller::<7>().unwrap();
        for input in inputs {
            law.step(input);
        }
        assert_eq!(law.phase(), Phase::Slide);
        let effort = plant.arm().model().limits().effort.unwrap();
        Self {
            law,
            effort: effort.as_slice().to_vec(),
            good: *inputs.last().unwrap(),
        }
    }
}

impl Bench for Unified {
    type Input = UnifiedInput;

    fn effort(&self) -> Vec<f64> {
        self.effort.clone()
    }

    fn good(&self) -> UnifiedInput {
        self.good
    }

    fn step(&mut self, input: &UnifiedInput) -> Step {
        let output = self.law.step(input);
        let mut said = vec![
            output.force_reference_n,
            output.force_n.unwrap_or_default(),
            output.path_error_m,
            output.path_progress,
            output.alignment_error_rad,
            output.monitor,
            output.monitor_margin,
            output.rho_align,
            output.rho_force,
            output.friction,
            output.tanks.motion_j,
            output.tanks.force_j,
        ];
        said.extend(output.normal.iter().chain(output.path_reference.iter()));
        said.extend(output.held_torque.iter());
        Step {
            torque: output.torque.as_slice().to_vec(),
            said,
            phase: output.phase,
            fault: output.fault,
        }
    }

    fn later(input: &mut UnifiedInput, by_s: f64) {
        input.time_s += by_s;
        if let Some(vision) = &mut input.vision {
            vision.time_s += by_s;
        }
    }

    fn spoil(input: &mut UnifiedInput, mask: u32, n: &mut Numbers<'_>) {
        let on = |bit: u32| mask & (1 << bit) != 0;
        if on(0) {
            input.time_s = n.next();
        }
        if on(1) {
            input.dt_s = n.next();
        }
        if on(2) {
            input.q[n.next().to_bits() as usize % 7] = n.next();
        }
        if on(3) {
            input.qd[n.next().to_bits() as usize % 7] = n.next();
        }
        if on(4) {
            input.wrench.force = n.vector();
        }
        if on(5) {
            input.wrench.torque = n.vector();
        }
        if on(6) {
            input.wrench_validity = n.validity();
        }
        if on(7) {
            input.wrench_age_s = n.next();
        }
        if on(8) {
            input.touch_age_s = n.next();
        }
        if on(9) {
            input.vision = None;
        }
        if on(10) {
            input.touch = None;
        }
        if let Some(vision) = &mut input.vision {
            if on(11) {
                vision.time_s = n.next();
            }
            if on(12) {
                vision.normal = n.vector();
            }
            if on(13) {
                vision.point = n.vector();
                vision.covariance = n.matrix();
            }
            if on(14) {
                vision.surface_variation = Some(n.next());
                vision.curvature = Some(n.matrix());
            }
            if on(15) {
                vision.validity = n.validity();
            }
            if let Some(change) = vision.change.as_mut().filter(|_| on(16)) {
                change.way = n.vector();
                change.per_m2 = n.next();
            }
        }
        if let Some(touch) = &mut input.touch {
            if on(17) {
                touch.normal = n.vector();
            }
            if on(18) {
                touch.covariance = n.matrix();
                touch.point = n.vector();
                touch.friction = Some(n.next());
                touch.curvature = Some(n.matrix());
            }
            if on(19) {
                touch.validity = n.validity();
            }
        }
        if on(20) {
            input.arm_ready = n.next() > -1.9;
        }
    }
}

/// Checks that the torques are finite and within the motors' limits, and that all other outputs are
/// finite.
fn check(step: &Step, effort: &[f64]) -> Result<(), TestCaseError> {
    for (torque, effort) in step.torque.iter().zip(effort) {
        prop_assert!(torque.abs() <= effort + 1e-9, "{:?}", step.torque);
    }
    prop_assert!(step.said.iter().all(|x| x.is_finite()), "{:?}", step.said);
    Ok(())
}

fn stays_inside<B: Bench>(mut bench: B, messes: &[(u32, Vec<f64>)]) -> Result<(), TestCaseError> {
    let effort = bench.effort();
    let mut time_s = 0.0;
    for (mask, numbers) in messes {
        let mut input = bench.good();
        time_s += PERIOD_S;
        B::later(&mut input, time_s);
        B::spoil(&mut input, *mask, &mut Numbers(numbers.iter().cycle()));
        check(&bench.step(&input), &effort)?;
    }
    // No number that is not finite remains in the state of the law.
    for _ in 0..200 {
        let mut good = bench.good();
        time_s += PERIOD_S;
        B::later(&mut good, time_s);
        check(&bench.step(&good), &effort)?;
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn hybrid_dynamics_stays_inside_its_limits(messes in prop::collection::vec(mess(), 1..60)) {
        stays_inside(Hybrid::sliding(), &messes)?;
    }

    #[test]
    fn unified_force_impedance_stays_inside_its_limits(messes in prop::collection::vec(mess(), 1..60)) {
        stays_inside(Unified::sliding(), &messes)?;
    }
}

const BAD: [f64; 5] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300];
/// Values that are not a time, and values that are not an age.
const NO_TIME: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
const NO_AGE: [f64; 3] = [f64::NAN, f64::INFINITY, 1e300];

/// Checks that the task ends with a fault within `cycles` if the fields in `mask` are bad from now
/// on.
fn faults_within<B: Bench>(
    make: impl Fn() -> B,
    mask: u32,
    bad: &[f64],
    cycles: usize,
    expected: impl Fn(Fault) -> bool,
) {
    for &value in bad {
        let mut bench = make();
        let effort = bench.effort();
        let mut fault = None;
        for cycle in 0..cycles {
            let mut input = bench.good();
            B::later(&mut input, PERIOD_S * (cycle + 1) as f64);
            B::spoil(&mut input, mask, &mut Numbers([value].iter().cycle()));
            let step = bench.step(&input);
            check(&step, &effort).unwrap();
            let ends = matches!(step.phase, Phase::Fault | Phase::Retract);
            fault = step.fault.filter(|_| ends);
            if fault.is_some() {
                break;
            }
        }
        let fault = fault
            .unwrap_or_else(|| panic!("fields {mask:b} = {value}: no fault in {cycles} cycles"));
        assert!(expected(fault), "fields {mask:b} = {value}: {fault:?}");
    }
}

/// Checks for both laws, whose first eight fields are the same.
fn every_fault_fires<B: Bench>(make: impl Fn() -> B, blind: u32, blind_cycles: usize) {
    let arm = |fault| fault == Fault::ArmState;
    faults_within(&make, 1 << 0, &NO_TIME, 1, arm);
    faults_within(&make, 1 << 1, &BAD, 1, arm);
    faults_within(&make, 1 << 1, &[0.0, -0.001, 1.0], 1, arm);
    faults_within(&make, 1 << 2, &BAD, 1, arm);
    faults_within(&make, 1 << 3, &BAD, 1, arm);
    for field in [4, 5] {
        faults_within(&make, 1 << field, &BAD, 2, |fault| {
            matches!(
                fault,
                Fault::Wrench(_) | Fault::ForceLimit(_) | Fault::TorqueLimit(_)
            )
        });
    }
    // A silent sensor is tolerated for 0.1 s.
    faults_within(&make, 1 << 7, &NO_AGE, 102, |fault| {
        fault == Fault::Wrench(Validity::Stale)
    });
    faults_within(&make, blind, &[0.0], blind_cycles, |fault| {
        matches!(fault, Fault::Estimate(_))
    });
}

#[test]
fn every_fault_of_hybrid_dynamics_fires_within_its_bound() {
    // A missing estimate is tolerated for one second.
    every_fault_fires(Hybrid::sliding, 1 << 10, 1002);
    for (field, bad) in [(9, &NO_AGE[..]), (11, &BAD), (12, &NO_TIME)] {
        faults_within(Hybrid::sliding, 1 << field, bad, 1002, |fault| {
            matches!(fault, Fault::Estimate(_))
        });
    }
}

#[test]
fn every_fault_of_unified_force_impedance_fires_within_its_bound() {
    // The last frame stays in use for 0.3 s; then a missing normal is tolerated for one second.
    every_fault_fires(Unified::sliding, 1 << 9 | 1 << 10, 1302);
    // A frame with a time in the future would never become stale.
    faults_within(
        Unified::sliding,
        1 << 10 | 1 << 11,
        &[1e9, f64::MAX],
        1302,
        |fault| matches!(fault, Fault::Estimate(_)),
    );
    // Camera and touch both give numbers that are not finite.
    faults_within(Unified::sliding, 1 << 12 | 1 << 17, &BAD, 1302, |fault| {
        matches!(fault, Fault::Estimate(_))
    });
}

/// The arm's state is lost with a joint far beyond its range: the torques that hold it stay within
/// the motors' limits.
fn stays_inside_from_beyond_a_joints_end<B: Bench>(make: impl Fn() -> B, joints: usize) {
    for joint in 0..joints {
        for at in [-6.0, 6.0] {
            let mut bench = make();
            let effort = bench.effort();
            for cycle in 1..200 {
                let mut input = bench.good();
                B::later(&mut input, PERIOD_S * f64::from(cycle));
                // Bit 2: the position of one joint, followed by the index of that joint.
                let value = if cycle < 20 { at } else { f64::NAN };
                let which = f64::from_bits(joint as u64);
                B::spoil(
                    &mut input,
                    1 << 2,
                    &mut Numbers([value, which].iter().cycle()),
                );
                check(&bench.step(&input), &effort).unwrap();
            }
        }
    }
}

#[test]
fn what_holds_a_blind_arm_is_what_its_motors_can_give() {
    stays_inside_from_beyond_a_joints_end(Hybrid::sliding, 6);
    stays_inside_from_beyond_a_joints_end(Unified::sliding, 7);
}

/// An invalid period ends the task at once, and the torques fade to those that hold the arm.
#[test]
fn one_bad_period_does_not_keep_the_last_torques_for_ever() {
    for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        let mut bench = Hybrid::sliding();
        let holds = bench.model.gravity(&bench.good.q);
        let mut input = bench.good;
        input.dt_s = bad;
        let first = bench.law.step(&input);
        assert_eq!(
            (first.phase, first.fault),
            (Phase::Fault, Some(Fault::ArmState))
        );
        assert!((first.torque - holds).amax() > 0.1, "nothing to fade");
        let mut last = first.torque;
        for _ in 0..500 {
            last = bench.law.step(&input).torque;
        }
        assert!((last - holds).amax() < 1e-3, "{bad}: {last}");

        let mut bench = Unified::sliding();
        let mut input = bench.good;
        input.dt_s = bad;
        let first = bench.law.step(&input);
        assert_eq!(
            (first.phase, first.fault),
            (Phase::Fault, Some(Fault::ArmState))
        );
        let mut last = first;
        for _ in 0..500 {
            last = bench.law.step(&input);
        }
        assert!(
            (last.torque - last.held_torque).amax() < 1e-3,
            "{bad}: {}",
            last.torque
        );
    }
}

//! The composed controller on a small plant: an ideal arm behind a delay, over a plane of springs.

// Each test file takes what it needs.
#![allow(dead_code)]

use std::collections::VecDeque;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use tangent_control::{
    ControlInput, ControlOutput, Controller, ControllerConfig, EstimateInput, Limits,
    MAX_ESTIMATORS, Phase, Task,
};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Arm, Flange, Joints, ModelData, Pose, Tool, Twist, Wrench};
use tangent_sensing::Validity;

/// A path of 40 mm on a plane.
pub const TASK: &str = r#"
    name = "line"
    estimators = ["first", "second"]
    tare = false
    force.reference_n = 3.0
    [path]
    kind = "line"
    to_m = [0.04, 0.0]
    speed_m_per_s = 0.02
"#;

/// An arm that follows a command `DELAY` cycles later, over a plane that pushes back.
pub struct Bench {
    pub controller: Controller,
    arm: Arm<6>,
    flange_from_tool: Pose<Flange, Tool>,
    pub q: Joints<6>,
    qd: Joints<6>,
    commands: VecDeque<Joints<6>>,
    pub time_s: f64,
    pub dt_s: f64,
    /// Height of the plane and its normal, base axes.
    pub plane_m: f64,
    pub stiffness: f64,
    pub last: Option<ControlOutput>,
}

const DELAY: usize = 3;

impl Bench {
    pub fn new(task: &str) -> Self {
        Self::at_rate(task, 0.008)
    }

    pub fn at_rate(task: &str, dt_s: f64) -> Self {
        Self::with_tool(task, dt_s, UnitQuaternion::identity())
    }

    /// With a tool that is turned on the flange.
    pub fn with_tool(task: &str, dt_s: f64, turned: UnitQuaternion<f64>) -> Self {
        let arm = Arm::new(&ModelData::builtin("ur5").unwrap()).unwrap();
        let flange_from_tool = Pose::new(Vector3::new(0.0, 0.0, 0.15), turned);
        let mut controller = Controller::new(
            arm,
            flange_from_tool,
            Limits::default(),
            ControllerConfig::default(),
        )
        .unwrap();
        controller
            .start_task(&task.parse::<Task>().unwrap())
            .unwrap();
        // The tool points down.
        let q = Joints::<6>::from([0.3, -1.6, 1.7, -1.67, -std::f64::consts::FRAC_PI_2, 0.0]);
        let tool = arm.base_from_flange(&q) * flange_from_tool;
        assert!(tool.z_axis().z < -0.99, "{:?}", tool.z_axis());
        Self {
            plane_m: tool.translation().z - 0.01,
            controller,
            arm,
            flange_from_tool,
            q,
            qd: Joints::zeros(),
            commands: VecDeque::from(vec![Joints::zeros(); DELAY]),
            time_s: 0.0,
            dt_s,
            stiffness: 5000.0,
            last: None,
        }
    }

    fn input(&self) -> ControlInput {
        let (base_from_tool, jacobian) =
            self.arm.tool_and_jacobian(&self.q, &self.flange_from_tool);
        let depth = (self.plane_m - base_from_tool.translation().z).max(0.0);
        let force = Vector3::z() * (self.stiffness * depth);
        let mut estimate = NormalEstimate::invalid(&base_from_tool, Validity::Valid);
        estimate.normal = Vector3::z();
        estimate.covariance = Matrix3::zeros();
        let mut estimates = [None; MAX_ESTIMATORS];
        for slot in &mut estimates[..2] {
            *slot = Some(EstimateInput {
                estimate,
                age_s: self.dt_s,
            });
        }
        ControlInput {
            time_s: self.time_s,
            dt_s: self.dt_s,
            q: self.q,
            qd: self.qd,
            base_from_tool,
            twist: Twist::from_vector(&(jacobian * self.qd)),
            speed_scaling: 1.0,
            arm_ready: true,
            wrench: Wrench::new(base_from_tool.unrotate(&force), Vector3::zeros()),
            wrench_validity: Validity::Valid,
            wrench_age_s: 0.004,
            wrench_delay_s: 0.0,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
            arm_force: None,
            estimates,
            objects: [None; MAX_ESTIMATORS],
            vision: None,
            base: None,
        }
    }

    /// Runs one cycle, with the input modified by `spoil`. Checks the conditions that hold in every
    /// cycle.
    pub fn step(&mut self, spoil: impl FnOnce(&mut ControlInput)) -> ControlOutput {
        let mut input = self.input();
        spoil(&mut input);
        let usable = (0.0..=0.1).contains(&input.dt_s);
        let period_s = if usable { input.dt_s } else { 0.0 };
        let output = self.controller.step(&input);
        let limits = self.controller.limits();
        assert!(output.qd.iter().all(|v| v.is_finite()));
        for i in 0..6 {
            let most = self.arm.limits().velocity[i] * limits.joint_speed_share;
            assert!(
                output.qd[i].abs() <= most + 1e-9,
                "joint {i}: {}",
                output.qd[i]
            );
            if let Some(last) = &self.last {
                let change = (output.qd[i] - last.qd[i]).abs();
                let allowed = limits.joint_acceleration_max_rad_per_s2 * period_s.max(0.02);
                assert!(change <= allowed + 1e-9, "joint {i} jumps by {change}");
            }
        }
        assert!((output.normal.norm() - 1.0).abs() < 1e-9);
        self.commands.push_back(output.qd);
        self.qd = self.commands.pop_front().unwrap();
        self.q += self.qd * self.dt_s;
        self.time_s += self.dt_s;
        self.last = Some(output);
        output
    }

    /// Runs this number of cycles with unmodified input.
    pub fn steps(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.step(|_| {});
        }
    }

    pub fn run_until(&mut self, phase: Phase) -> ControlOutput {
        for _ in 0..(60.0 / self.dt_s) as usize {
            let output = self.step(|_| {});
            if output.phase == phase {
                return output;
            }
        }
        panic!("never in {phase:?}: {:?}", self.last);
    }

    /// A bench that slides on the plane of `new`.
    pub fn sliding(task: &str) -> Self {
        let mut bench = Self::new(task);
        bench.run_until(Phase::Slide);
        bench
    }

    pub fn tool(&self) -> Vector3<f64> {
        self.input().base_from_tool.translation()
    }

    pub fn speed(&self) -> f64 {
        self.last.as_ref().unwrap().twist_commanded.linear.norm()
    }
}

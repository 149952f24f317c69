//! Plant, camera, conditioning, pose estimator and `hybrid_dynamics` in one thread;
//! `tangent evaluate` runs this for scenarios of kind `object_pose`.

use nalgebra::Vector3;
use tangent_control::hybrid_dynamics::{HybridDynamics, HybridInput, HybridOutput};
use tangent_control::{ContactSign, ControllerWord, Law, LawInput, MAX_ESTIMATORS, ObjectInput};
use tangent_estimation::object_pose::{
    CameraModel, ObjectEstimate, ObjectPoseEstimator, ObjectSample, ObjectShape,
    build_object_estimator,
};
use tangent_mechanics::{Arm, Flange, Joints, Pose, Tool, Twist, Wrench};
use tangent_sensing::{ConditionedWrench, Validity};

use super::plant::ObjectPlant;
use super::scenario::ObjectScenario;
use crate::arms::loaded_arm::joints_of;
use crate::arms::measurement::ArmMeasurement;
use crate::arms::own_hold::OwnHold;
use crate::contact::Obstacle;
use crate::digest::TrajectoryDigest;
use crate::disturbance::{Disturbance, Undisturbed};
use crate::evaluation::{Evaluation, RunEnd, run_to_end};
use crate::metrics::object::{
    CalibrationError, ObjectFigures, ObjectSampleTruth, frame_counts, normal_in_flange,
};
use crate::metrics::{CycleSample, EstimateSample, TruthSample};
use crate::scenario_file::ScenarioError;
use crate::sensors::wrench_channel::WrenchChannel;
use crate::truth::Truth;

/// Number of cycles between two samples of the estimator's consistency.
const NEES_EVERY: usize = 50;

/// One cycle of the loop, as shown to an observer.
#[derive(Clone, Copy, Debug)]
pub struct ObjectCycle<'a, const N: usize = 6> {
    /// What the arm reported.
    pub arm: &'a ArmMeasurement<N>,
    /// Inputs of the controller.
    pub input: &'a HybridInput<N>,
    /// Outputs of the controller.
    pub output: &'a HybridOutput<N>,
    /// True state of the contact.
    pub truth: &'a Truth,
    /// True state and estimate of the cycle, in the form that the figures are computed from.
    pub sample: &'a ObjectSampleTruth,
}

/// Runs a scenario to its end.
///
/// # Errors
/// As [`ObjectLoop::new`].
pub fn evaluate_object(scenario: &ObjectScenario) -> Result<Evaluation, ScenarioError> {
    match joints_of(&scenario.plant.robot)? {
        7 => evaluate_object_of::<7>(scenario, &mut Undisturbed, |_| ()),
        _ => evaluate_object_of::<6>(scenario, &mut Undisturbed, |_| ()),
    }
}

/// Runs a scenario of an arm with six joints to its end with a disturbance and passes every cycle
/// to `watch`.
///
/// # Errors
/// As [`ObjectLoop::new`].
pub fn evaluate_object_with(
    scenario: &ObjectScenario,
    disturbance: &mut dyn Disturbance,
    watch: impl FnMut(&ObjectCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    evaluate_object_of::<6>(scenario, disturbance, watch)
}

/// Runs a scenario of an arm with `N` joints to its end with a disturbance and passes every cycle
/// to `watch`.
///
/// # Errors
/// As [`ObjectLoop::new`].
pub fn evaluate_object_of<const N: usize>(
    scenario: &ObjectScenario,
    disturbance: &mut dyn Disturbance,
    mut watch: impl FnMut(&ObjectCycle<'_, N>),
) -> Result<Evaluation, ScenarioError> {
    let mut closed = ObjectLoop::new(scenario)?;
    let mut objects = Vec::new();
    let (mut nees, mut calibration) = (Vec::new(), None);
    let samples = run_to_end(scenario.duration_s, closed.plant.period_s(), || {
        let (sample, object) = closed.step(disturbance, &mut watch);
        if sample.phase.is_pressing() && objects.len() % NEES_EVERY == 0 {
            nees.extend(closed.nees());
            calibration = closed.calibration().or(calibration);
        }
        objects.push(object);
        sample
    });
    let mut figures = ObjectFigures::of(&objects, scenario.task.force.reference_n);
    figures.nees_per_dof = (!nees.is_empty()).then(|| nees.iter().sum::<f64>() / nees.len() as f64);
    figures.nees_per_dof_final = nees.last().copied();
    figures.calibration_stated = calibration.map(|(stated, _)| stated);
    figures.calibration_final = calibration.and_then(|(_, last)| last);
    figures.compliance_m_per_n = closed
        .estimator
        .calibration()
        .map(|c| c.compliance_m_per_n.0);
    figures.frames = frame_counts(&closed.estimator.frames());
    figures.limited_cycles = closed.limited_cycles;
    figures.torque_share_max = closed.torque_share_max;
    let end = RunEnd {
        scenario: &scenario.name,
        controller: &scenario.controller,
        estimator: closed.estimator.name(),
        seed: scenario.seed,
        duration_s: closed.plant.time_s(),
        fault: closed.output.and_then(|output| output.fault),
        state_digest: closed.digest.finish(),
    };
    Ok(Evaluation {
        object_pose: Some(figures),
        ..Evaluation::of(end, &samples)
    })
}

/// The closed loop, stepped period by period.
pub struct ObjectLoop<const N: usize = 6> {
    plant: ObjectPlant<N>,
    model: Arm<N>,
    stated_camera: CameraModel,
    wrench: WrenchChannel,
    estimator: Box<dyn ObjectPoseEstimator>,
    shape: ObjectShape,
    controller: HybridDynamics<N>,
    flange_from_tool: Pose<Flange, Tool>,
    torque: Joints<N>,
    output: Option<HybridOutput<N>>,
    digest: TrajectoryDigest,
    limited_cycles: u64,
    torque_share_max: f64,
    /// Own hold of the robot while it accepts no torques; `None` while it does.
    stopped: Option<OwnHold<N>>,
}

impl<const N: usize> ObjectLoop<N> {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The scenario's arm has another number of joints than `N`, the cell of the scenario cannot be
    /// built, or its task, law or estimator is not usable.
    pub fn new(scenario: &ObjectScenario) -> Result<Self, ScenarioError> {
        let corners = scenario.estimation.target.corners();
        let plant = ObjectPlant::new(&scenario.plant, corners, scenario.seed)?;
        let stated = scenario.plant.stated::<N>()?;
        let (model, flange_from_tool) = (stated.arm, stated.flange_from_tool);
        let wrench = WrenchChannel::new(
            &scenario.sensing,
            &scenario.plant.tool,
            &scenario.plant.sensor,
        )?;
        let shape = scenario.object_surface()?;
        let camera = scenario.plant.camera.model();
        Ok(Self {
            estimator: build_object_estimator(scenario.estimator(), &scenario.estimation, &camera)?,
            controller: HybridDynamics::new(
                model,
                flange_from_tool,
                scenario.limits,
                &scenario.law()?,
                &scenario.task,
                Box::new(shape),
            )?,
            torque: model.gravity(&plant.arm().q),
            plant,
            model,
            stated_camera: camera,
            wrench,
            shape,
            flange_from_tool,
            output: None,
            digest: TrajectoryDigest::default(),
            limited_cycles: 0,
            torque_share_max: 0.0,
            stopped: None,
        })
    }

    /// The cell.
    pub fn plant(&self) -> &ObjectPlant<N> {
        &self.plant
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// Current normalised squared error of the estimator, divided by the degrees of freedom.
    pub fn nees(&self) -> Option<f64> {
        self.estimator.nees(
            &self.plant.base_from_object_rest(),
            self.plant.camera_truth().to_compare(),
        )
    }

    /// Current errors of the stated and of the estimated calibration.
    pub fn calibration(&self) -> Option<(CalibrationError, Option<CalibrationError>)> {
        let truth = self.plant.truth();
        let flange_from_tool = self.plant.true_flange_from_tool();
        let flange = truth.base_from_tool * flange_from_tool.to_compare().inverse();
        let normal = normal_in_flange(&flange, &truth.normal);
        let camera = self.plant.camera_truth();
        let of = |known: &CameraModel| CalibrationError::of(known, camera.to_compare(), &normal);
        let estimated = self.estimator.calibration().map(|c| of(&c.camera));
        Some((of(&self.stated_camera), estimated))
    }

    /// The law, for requests between two periods.
    pub fn controller(&mut self) -> &mut HybridDynamics<N> {
        &mut self.controller
    }

    /// Sets whether the robot accepts torques; otherwise it is in a protective stop and holds
    /// itself.
    pub fn set_arm_ready(&mut self, ready: bool) {
        self.stopped = (!ready).then(OwnHold::default);
    }

    /// Replaces the sensor service by a new one, as after a crash. The last good zero is kept.
    pub fn restart_sensor(&mut self) {
        self.wrench.restart();
    }

    /// Requests a tare as an operator does; `said_clear`: the operator states that the tool hangs
    /// free.
    ///
    /// # Errors
    /// The sign of contact in the controller's state for which the tare is refused.
    pub fn ask_for_tare(&mut self, said_clear: bool) -> Result<(), ContactSign> {
        let word = ControllerWord::of(self.controller.phase(), &self.controller.clearance());
        self.wrench.ask_for_tare(word, said_clear)
    }

    /// Newest conditioned wrench; `None` before the first sample.
    pub fn shown(&self) -> Option<&ConditionedWrench> {
        self.wrench.shown()
    }

    /// Runs one period: the plant moves, then sensors, estimator and law process what it reports.
    pub fn step(
        &mut self,
        disturbance: &mut dyn Disturbance,
        watch: &mut impl FnMut(&ObjectCycle<'_, N>),
    ) -> (CycleSample, ObjectSampleTruth) {
        self.plant.step(&self.torque);
        let arm = self.plant.arm();
        let base_from_flange = self.model.base_from_flange(&arm.q);
        let base_from_tool = base_from_flange * self.flange_from_tool;
        let jacobian = self.model.jacobian_at(&arm.q, &self.flange_from_tool);
        let twist = Twist::from_vector(&(jacobian * arm.qd));
        self.wrench.move_with(arm.time_s, &base_from_tool, &twist);
        for sample in self.plant.sensor_samples() {
            self.wrench.take(sample, base_from_tool, 0.0);
        }
        let mut input = LawInput {
            time_s: arm.time_s,
            dt_s: self.plant.period_s(),
            q: arm.q,
            qd: arm.qd,
            base_from_tool,
            twist,
            speed_scaling: 1.0,
            arm_ready: self.stopped.is_none(),
            wrench: Wrench::zero(),
            wrench_validity: Validity::Missing,
            wrench_age_s: f64::INFINITY,
            wrench_delay_s: 0.0,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
            arm_force: None,
            estimates: [None; MAX_ESTIMATORS],
            objects: [None; MAX_ESTIMATORS],
            vision: None,
            base: None,
        };
        if let Some((mut conditioned, mut age_s)) = self.wrench.newest(arm.time_s) {
            disturbance.wrench(arm.time_s, &mut conditioned, &mut age_s);
            input.wrench = conditioned.wrench;
            input.wrench_validity = conditioned.validity;
            input.wrench_age_s = age_s;
            input.bias_age_s = conditioned.bias_age_s;
            input.zero_bound_n = self.wrench.zero_bound_n(&conditioned);
            input.untared = Some(self.wrench.untared_load(&conditioned));
            input.wrench_delay_s = conditioned.delay_s;
        }
        let taken = self.plant.take_frame();
        let estimate = self.estimator.update(&ObjectSample {
            time_s: arm.time_s,
            base_from_flange,
            base_from_tool,
            wrench: input.wrench,
            wrench_delay_s: input.wrench_delay_s,
            wrench_validity: input.wrench_validity,
            wrench_bias_age_s: input.bias_age_s,
            frame: disturbance.frame(arm.time_s, taken),
        });
        input.objects[0] = Some(ObjectInput {
            estimate,
            age_s: 0.0,
        });
        let input = self.controller.choose(&input);
        let output = self.controller.step(&input);
        let ground = output.clearance.tare_ground();
        self.wrench.obey(
            output.tare_requested.then_some(ground),
            output.zero_withdrawn,
        );
        self.torque = match &mut self.stopped {
            Some(hold) => hold.torque(&self.model, &arm.q, &arm.qd, &self.torque, input.dt_s),
            None => output.torque,
        };
        self.output = Some(output);
        let truth = self.plant.truth();
        let object = self.object_sample(&output, &estimate, &truth);
        self.limited_cycles += u64::from(output.limited);
        if let Some(effort) = self.model.limits().effort {
            let share = self.plant.torque_applied().component_div(&effort).amax();
            self.torque_share_max = self.torque_share_max.max(share);
        }
        watch(&ObjectCycle {
            arm: &arm,
            input: &input,
            output: &output,
            truth: &truth,
            sample: &object,
        });
        self.digest_cycle(&arm, &input, &estimate, &truth);
        (self.cycle_sample(&arm, &output, &estimate, &truth), object)
    }

    fn object_sample(
        &self,
        output: &HybridOutput<N>,
        estimate: &ObjectEstimate,
        truth: &Truth,
    ) -> ObjectSampleTruth {
        let wrench = self.plant.sensor_wrench();
        ObjectSampleTruth {
            time_s: truth.time_s,
            phase: output.phase,
            object: self.plant.base_from_object(),
            estimated: (estimate.validity != Validity::Missing)
                .then_some(estimate.base_from_object),
            tip: truth.base_from_tool.translation(),
            reference_in_object: output.reference_in_object,
            force_n: truth.wrench.force.dot(&truth.normal),
            sensor: (wrench.force, wrench.torque),
            in_contact: truth.in_contact,
        }
    }

    fn cycle_sample(
        &self,
        arm: &ArmMeasurement<N>,
        output: &HybridOutput<N>,
        estimate: &ObjectEstimate,
        truth: &Truth,
    ) -> CycleSample {
        let tip: Vector3<f64> = output.base_from_tool.translation();
        let normal =
            (estimate.validity != Validity::Missing).then(|| estimate.normal_at(&self.shape, &tip));
        CycleSample {
            time_s: arm.time_s,
            phase: output.phase,
            estimate: normal.map(|n| EstimateSample {
                normal: n.normal,
                covariance: n.covariance,
                valid: n.validity.is_valid(),
            }),
            truth: Some(TruthSample {
                normal: truth.normal,
                tool_z: truth.base_from_tool.z_axis(),
                in_contact: truth.in_contact,
                force_n: truth.wrench.force.dot(&truth.normal),
            }),
            tool_position: tip,
            tool_z: output.base_from_tool.z_axis(),
            force_n: output.force_n,
            force_reference_n: output.force_reference_n,
            in_contact: output.in_contact,
            path_reference: output.path_reference,
            path_error_m: output.path_error_m,
            joint_speed_rad_per_s: arm.qd.amax(),
            manipulability: output.manipulability,
            motion_tank_j: None,
            force_tank_j: None,
        }
    }

    fn digest_cycle(
        &mut self,
        arm: &ArmMeasurement<N>,
        input: &HybridInput<N>,
        estimate: &ObjectEstimate,
        truth: &Truth,
    ) {
        self.digest.add(arm.q.as_slice());
        self.digest.add(arm.qd.as_slice());
        self.digest.add(input.wrench.vector().as_slice());
        self.digest.add(self.torque.as_slice());
        self.digest.add(truth.wrench.vector().as_slice());
        let pose = &estimate.base_from_object;
        self.digest.add(pose.translation().as_slice());
        self.digest.add(pose.rotation().coords.as_slice());
    }
}

//! Plant, camera, conditioning, pose estimator and `hybrid_dynamics` in one thread;
//! `tangent evaluate` runs this for scenarios of kind `object_pose`.

use nalgebra::Vector3;
use tangent_control::hybrid_dynamics::{HybridDynamics, HybridInput, HybridOutput};
use tangent_control::{ContactSign, ControllerWord, Phase};
use tangent_estimation::object_pose::{
    CameraFrame, CameraModel, ObjectEstimate, ObjectPoseEstimator, ObjectSample, ObjectShape,
    build_object_estimator,
};
use tangent_mechanics::{Arm, Flange, Joints, Pose, Tool, Wrench};
use tangent_sensing::{
    ConditionedWrench, Payload, Validity, WrenchConditioner, WrenchConditionerState,
};

use crate::closed_loop::{Evaluation, restart, take_tare, untared_load};
use crate::digest::TrajectoryDigest;
use crate::loaded_arm::loaded_arm;
use crate::measurement::ArmMeasurement;
use crate::metrics::object_pose::{
    CalibrationError, ObjectPoseFigures, ObjectSampleTruth, frame_counts, normal_in_flange,
};
use crate::metrics::{CycleSample, EstimateSample, Figures, TruthSample};
use crate::object_plant::ObjectPlant;
use crate::object_scenario::ObjectScenario;
use crate::obstacle::Obstacle;
use crate::own_hold::OwnHold;
use crate::scenario::ScenarioError;
use crate::truth::Truth;
use crate::watched_sensor::WatchedSensor;

/// Time for which a run continues after its task has ended, s.
const AFTER_END_S: f64 = 0.2;
/// Number of cycles between two samples of the estimator's consistency.
const NEES_EVERY: u64 = 50;

/// One cycle of the loop, as shown to an observer.
#[derive(Clone, Copy, Debug)]
pub struct ObjectCycle<'a> {
    /// What the arm reported.
    pub arm: &'a ArmMeasurement,
    /// Inputs of the controller.
    pub input: &'a HybridInput,
    /// Outputs of the controller.
    pub output: &'a HybridOutput,
    /// True state of the contact.
    pub truth: &'a Truth,
    /// True state and estimate of the cycle, in the form that the figures are computed from.
    pub sample: &'a ObjectSampleTruth,
}

/// Changes the inputs before they arrive, to test failures: frames and wrenches can be altered or
/// removed.
pub trait Disturbance {
    /// A frame before the estimator receives it; `None` for a lost one.
    fn frame(&mut self, _time_s: f64, frame: Option<CameraFrame>) -> Option<CameraFrame> {
        frame
    }

    /// Alters the conditioned wrench before estimator and controller receive it.
    fn wrench(&mut self, _time_s: f64, _input: &mut ConditionedWrench, _age_s: &mut f64) {}
}

/// A disturbance that changes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Undisturbed;

impl Disturbance for Undisturbed {}

/// Runs a scenario to its end.
///
/// # Errors
/// As [`ObjectLoop::new`].
pub fn evaluate_object(scenario: &ObjectScenario) -> Result<Evaluation, ScenarioError> {
    evaluate_object_with(scenario, &mut Undisturbed, |_| ())
}

/// Runs a scenario to its end with a disturbance and passes every cycle to `watch`.
///
/// # Errors
/// As [`ObjectLoop::new`].
pub fn evaluate_object_with(
    scenario: &ObjectScenario,
    disturbance: &mut dyn Disturbance,
    mut watch: impl FnMut(&ObjectCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    let mut closed = ObjectLoop::new(scenario)?;
    let steps = (scenario.duration_s / closed.plant.period_s()).round() as u64;
    let mut samples = Vec::with_capacity(steps as usize);
    let mut objects = Vec::with_capacity(steps as usize);
    let (mut nees, mut calibration) = (Vec::new(), None);
    let mut ended_at = None;
    for step in 0..steps {
        let (sample, object) = closed.step(disturbance, &mut watch);
        let pressing = sample.phase.is_pressing();
        if pressing && step % NEES_EVERY == 0 {
            nees.extend(closed.nees());
            calibration = closed.calibration().or(calibration);
        }
        samples.push(sample);
        objects.push(object);
        if !sample.phase.is_active() {
            let since = *ended_at.get_or_insert(sample.time_s);
            if sample.time_s - since >= AFTER_END_S {
                break;
            }
        }
    }
    let mut figures = ObjectPoseFigures::of(&objects, scenario.task.force.reference_n);
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
    let last = closed.output;
    Ok(Evaluation {
        scenario: scenario.name.clone(),
        controller: scenario.controller.clone(),
        estimator: closed.estimator.name().to_owned(),
        seed: scenario.seed,
        duration_s: closed.plant.time_s(),
        steps: samples.len() as u64,
        wall_s: None,
        real_time_factor: None,
        figures: Figures::of(&samples),
        object_pose: Some(figures),
        tactile: None,
        r#loop: None,
        phase: last.map_or(Phase::Idle, |o| o.phase).name(),
        fault: last.and_then(|o| o.fault).map(|f| f.text()),
        state_digest: closed.digest.finish(),
    })
}

/// The closed loop, stepped period by period.
pub struct ObjectLoop {
    plant: ObjectPlant,
    model: Arm<6>,
    stated: CameraModel,
    conditioner: WrenchConditioner,
    conditioning: WrenchConditionerState,
    estimator: Box<dyn ObjectPoseEstimator>,
    shape: ObjectShape,
    controller: HybridDynamics,
    flange_from_tool: Pose<Flange, Tool>,
    sensor: WatchedSensor,
    conditioned: Option<ConditionedWrench>,
    wrench_time: f64,
    torque: Joints<6>,
    output: Option<HybridOutput>,
    digest: TrajectoryDigest,
    limited_cycles: u64,
    torque_share_max: f64,
    /// The robot does not take torques: it holds itself.
    stopped: Option<OwnHold<6>>,
}

impl ObjectLoop {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The cell of the scenario cannot be built, or its task, law or estimator is not usable.
    pub fn new(scenario: &ObjectScenario) -> Result<Self, ScenarioError> {
        let corners = scenario.estimation.target.corners();
        let plant = ObjectPlant::new(&scenario.plant, corners, scenario.seed)?;
        let model = loaded_arm::<6>(&scenario.plant.robot, &scenario.plant.tool, false)?;
        let (flange_from_tool, flange_from_sensor) =
            (plant.flange_from_tool(), plant.flange_from_sensor());
        let payload = &scenario.plant.tool.payload;
        let conditioner = WrenchConditioner::new(
            &scenario.sensing,
            &Payload {
                mass_kg: payload.mass_kg,
                com_in_sensor_m: payload.com_in_sensor_m,
                inertia_kg_m2: payload.inertia_kg_m2,
            },
            flange_from_sensor.inverse() * flange_from_tool,
            scenario.plant.sensor.rate_hz,
        )?;
        let shape = scenario.object_surface()?;
        let stated = scenario.plant.camera.model();
        Ok(Self {
            estimator: build_object_estimator(scenario.estimator(), &scenario.estimation, &stated)?,
            controller: HybridDynamics::new(
                model,
                flange_from_tool,
                scenario.limits,
                &scenario.law()?,
                &scenario.task,
                Box::new(shape),
            )?,
            torque: model.gravity(&plant.arm().q),
            conditioning: WrenchConditionerState::default(),
            sensor: WatchedSensor::new(&scenario.plant.sensor),
            plant,
            model,
            stated,
            conditioner,
            shape,
            flange_from_tool,
            conditioned: None,
            wrench_time: 0.0,
            output: None,
            digest: TrajectoryDigest::default(),
            limited_cycles: 0,
            torque_share_max: 0.0,
            stopped: None,
        })
    }

    /// The cell.
    pub fn plant(&self) -> &ObjectPlant {
        &self.plant
    }

    /// Puts something in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// The estimator's squared error over covariance and degrees of freedom, now.
    pub fn nees(&self) -> Option<f64> {
        self.estimator.nees(
            &self.plant.base_from_object_rest(),
            self.plant.camera_truth(),
        )
    }

    /// Current errors of the stated and of the estimated calibration.
    pub fn calibration(&self) -> Option<(CalibrationError, Option<CalibrationError>)> {
        let truth = self.plant.truth();
        let flange = truth.base_from_tool * self.flange_from_tool.inverse();
        let normal = normal_in_flange(&flange, &truth.normal);
        let of =
            |known: &CameraModel| CalibrationError::of(known, self.plant.camera_truth(), &normal);
        let estimated = self.estimator.calibration().map(|c| of(&c.camera));
        Some((of(&self.stated), estimated))
    }

    /// The law, for requests between two periods.
    pub fn controller(&mut self) -> &mut HybridDynamics {
        &mut self.controller
    }

    /// The robot takes torques, or is in a protective stop and holds itself.
    pub fn set_arm_ready(&mut self, ready: bool) {
        self.stopped = (!ready).then(OwnHold::default);
    }

    /// The sensor's service dies and another takes its place. It keeps the last good zero.
    pub fn restart_sensor(&mut self) {
        restart(&mut self.conditioning);
    }

    /// A person asks for a tare; `said_clear`: who has looked and says that the tool hangs free.
    ///
    /// # Errors
    /// What the controller's word says against it.
    pub fn ask_for_tare(&mut self, said_clear: bool) -> Result<(), ContactSign> {
        let word = ControllerWord::of(self.controller.phase(), &self.controller.clearance());
        take_tare(&self.conditioner, &mut self.conditioning, word, said_clear)
    }

    /// The wrench as it is shown now; none before the first sample.
    pub fn shown(&self) -> Option<&ConditionedWrench> {
        self.conditioned.as_ref()
    }

    /// One period: the plant moves, then everybody answers to what it reports.
    pub fn step(
        &mut self,
        disturbance: &mut dyn Disturbance,
        watch: &mut impl FnMut(&ObjectCycle<'_>),
    ) -> (CycleSample, ObjectSampleTruth) {
        self.plant.step(&self.torque);
        let arm = self.plant.arm();
        let base_from_flange = self.model.base_from_flange(&arm.q);
        let base_from_tool = base_from_flange * self.flange_from_tool;
        for sample in self.plant.sensor_samples() {
            let felt = self.conditioned.as_ref().filter(|c| c.bias_age_s.is_some());
            let Some(mut reading) = self
                .sensor
                .take(sample, &base_from_tool.translation(), felt)
            else {
                continue;
            };
            reading.base_from_tool = Some((base_from_tool, 0.0));
            self.conditioned = Some(self.conditioner.update(&mut self.conditioning, &reading));
            self.wrench_time = sample.time_s;
        }
        let mut input = HybridInput {
            time_s: arm.time_s,
            dt_s: self.plant.period_s(),
            q: arm.q,
            qd: arm.qd,
            arm_ready: self.stopped.is_none(),
            wrench: Wrench::zero(),
            wrench_validity: Validity::Missing,
            wrench_age_s: f64::INFINITY,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
            estimate: None,
            estimate_age_s: 0.0,
        };
        let mut delay_s = 0.0;
        if let Some(mut conditioned) = self.conditioned {
            let mut age_s = arm.time_s - self.wrench_time;
            disturbance.wrench(arm.time_s, &mut conditioned, &mut age_s);
            input.wrench = conditioned.wrench;
            input.wrench_validity = conditioned.validity;
            input.wrench_age_s = age_s;
            input.bias_age_s = conditioned.bias_age_s;
            let tare = self.conditioner.tare_config();
            input.zero_bound_n = conditioned
                .bias_age_s
                .map(|age_s| tare.drift_bound_n(age_s));
            input.untared = Some(untared_load(tare, &conditioned));
            delay_s = conditioned.delay_s;
        }
        let taken = self.plant.take_frame();
        let estimate = self.estimator.update(&ObjectSample {
            time_s: arm.time_s,
            base_from_flange,
            base_from_tool,
            wrench: input.wrench,
            wrench_delay_s: delay_s,
            wrench_validity: input.wrench_validity,
            wrench_bias_age_s: input.bias_age_s,
            frame: disturbance.frame(arm.time_s, taken),
        });
        input.estimate = Some(estimate);
        let output = self.controller.step(&input);
        if output.tare_requested && !self.conditioning.is_taring() {
            self.conditioner
                .start_tare(&mut self.conditioning, output.clearance.tare_ground());
        }
        if output.zero_withdrawn {
            self.conditioning.withdraw_tare();
        }
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
        output: &HybridOutput,
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
        arm: &ArmMeasurement,
        output: &HybridOutput,
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
        arm: &ArmMeasurement,
        input: &HybridInput,
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

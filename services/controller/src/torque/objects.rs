//! Tasks of `hybrid_dynamics`: made ready for the loop, with the estimators of the object's pose that they name.

use tangent_control::{
    ControlError, EstimatorName, HybridDynamics, HybridInput, HybridOutput, Phase, SwitchRefusal,
    Task,
};
use tangent_runtime::Bus;
use tangent_schemas::convert::{cut_format, joint_array, joints};
use tangent_schemas::tangent::ControlState;
use tangent_schemas::topics;

use super::choice::SWITCH_GATE_RAD;
use super::config::ObjectsConfig;
use super::cycle::Boxed;
use super::object_readers::ObjectReaders;
use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::desk::{Kind, one_speaks};
use crate::mailbox::Mailbox;

/// Makes tasks ready. In the desk.
pub struct Objects {
    bus: Bus,
    config: ObjectsConfig,
}

impl Objects {
    /// For the cell's arm and object.
    pub fn new(bus: &Bus, config: ObjectsConfig) -> Self {
        Self {
            bus: bus.clone(),
            config,
        }
    }

    fn program(&self, text: &str) -> Result<ObjectProgram, String> {
        let words = |e: ControlError| e.to_string();
        let task: Task = text.parse().map_err(words)?;
        let law = self.config.law(task.controller.as_deref()).map_err(words)?;
        let mut readers = Vec::new();
        for name in &task.estimators {
            let short = EstimatorName::from(name)
                .map_err(|_| format!("estimators: \"{name}\" is longer than 64 bytes"))?;
            let newest = self.bus.latest(&topics::estimate_object(name));
            readers.push((short, newest.map_err(|e| e.to_string())?));
        }
        let gate_rad = task
            .switching
            .disagreement_max_rad
            .unwrap_or(SWITCH_GATE_RAD);
        let patience_s = law.patience.estimate_s;
        Ok(ObjectProgram {
            readers: ObjectReaders::new(readers, self.config.shape, patience_s, gate_rad),
            law: HybridDynamics::new(
                self.config.arm,
                self.config.flange_from_tool,
                self.config.limits,
                &law,
                &task,
                Box::new(self.config.shape),
            )
            .map_err(words)?,
        })
    }
}

impl Kind for Objects {
    type Program = Boxed;

    fn prepare(&self, text: &str) -> Result<(String, Boxed), String> {
        let program = self.program(text)?;
        Ok((program.law.task().name.clone(), Box::new(program)))
    }

    fn check_estimates(&self, program: &Boxed, _: &Mailbox<Boxed>) -> Result<(), String> {
        let names = &program.task().estimators;
        let topics = names.iter().map(|name| topics::estimate_object(name));
        if one_speaks(&self.bus, topics)? {
            return Ok(());
        }
        Err(format!(
            "none of the task's estimators publishes an object's pose: {}; are estimator and camera running, with these in [estimators] run?",
            names.join(", ")
        ))
    }
}

/// `hybrid_dynamics` with what it reads.
struct ObjectProgram {
    law: HybridDynamics,
    readers: ObjectReaders,
}

impl TorqueProgram for ObjectProgram {
    fn task(&self) -> &Task {
        self.law.task()
    }

    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer> {
        let estimate = self.readers.read(input.arm);
        let wrench = &input.wrench;
        let output = self.law.step(&HybridInput {
            time_s: input.time_s,
            dt_s: input.arm.period_s,
            q: joints(&input.arm.q).ok()?,
            qd: joints(&input.arm.qd).ok()?,
            arm_ready: input.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            bias_age_s: wrench.bias_age_s,
            estimate: estimate.map(|(estimate, _)| estimate),
            estimate_age_s: estimate.map_or(f64::INFINITY, |(_, age_s)| age_s),
        });
        let (name, switches, cause) = self.readers.in_use();
        let (what, why) = cause.text();
        Some(TorqueAnswer {
            torque: joint_array(&output.torque),
            state: state(&output, input, estimate.map(|(_, age_s)| age_s)),
            shaping: None,
            phase: output.phase,
            fault: output.fault,
            tare_requested: output.tare_requested,
            estimator: (name, switches, cut_format(format_args!("{what}{why}"))),
        })
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.law.pause(paused)
    }

    fn stop(&mut self) {
        self.law.stop();
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        self.readers.select(name, force)
    }

    fn set_force_reference(&mut self, force_n: f64) {
        self.law.set_force_reference(force_n);
    }

    fn phase(&self) -> Phase {
        self.law.phase()
    }
}

fn state(
    output: &HybridOutput,
    input: &TorqueInput<'_>,
    estimate_age_s: Option<f64>,
) -> ControlState {
    let age = |age_s: f64| if age_s.is_finite() { age_s } else { -1.0 };
    let wrench = &input.wrench;
    ControlState {
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n,
        wrench: if wrench.validity.is_valid() && wrench.wrench.is_finite() {
            (&wrench.wrench).into()
        } else {
            Default::default()
        },
        path_reference: (&output.path_reference).into(),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age(wrench.age_s),
        estimate_age_s: estimate_age_s.map_or(-1.0, age),
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        ..ControlState::default()
    }
}

//! Tasks of `hybrid_dynamics`: made ready for the loop, with the estimators of the object's pose
//! that they name.

use nalgebra::Vector3;
use tangent_control::{
    Clearance, ControlError, EstimatorName, HybridDynamics, HybridInput, HybridOutput, Path, Phase,
    SwitchRefusal, Task,
};
use tangent_runtime::{Bus, BusError};
use tangent_schemas::convert::{cut_format, joint_array, joints};
use tangent_schemas::tangent::ControlState;
use tangent_schemas::topics;

use super::choice::rules;
use super::config::ObjectsConfig;
use super::object_readers::ObjectReaders;
use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use super::runner::Boxed;
use crate::inputs::age_told;
use crate::mailbox::{Mailbox, Time};
use crate::messages::{no_wrench, tell_ages};
use crate::requests::{Kind, one_speaks};
use crate::runner::Report;
use crate::start_check::StartCheck;

/// Prepares tasks outside the loop.
pub struct Objects {
    bus: Bus,
    config: ObjectsConfig,
    check: StartCheck<6>,
}

impl Objects {
    /// For the cell's arm and object.
    ///
    /// # Errors
    /// Where `arm/state` cannot be read.
    pub fn new(bus: &Bus, config: ObjectsConfig) -> Result<Self, BusError> {
        Ok(Self {
            check: StartCheck::new(
                bus,
                config.arm,
                config.flange_from_tool,
                config.limits,
                config.estimators.clone(),
            )?,
            bus: bus.clone(),
            config,
        })
    }

    fn program(&self, text: &str) -> Result<ObjectProgram, String> {
        let words = |e: ControlError| e.to_string();
        let task: Task = text.parse().map_err(words)?;
        let law = self.config.law(task.controller.as_deref()).map_err(words)?;
        let bounds = &law.path;
        let path = Path::new(
            &task.path,
            bounds.acceleration_m_per_s2,
            bounds.jerk_m_per_s3,
        );
        self.check.task(&task, &path.map_err(words)?)?;
        self.check
            .estimators(&self.bus, &task.estimators, topics::estimate_object)?;
        self.program_of(&task)
    }

    /// The law with what it reads; nothing is checked that depends on where the arm stands.
    fn program_of(&self, task: &Task) -> Result<ObjectProgram, String> {
        let words = |e: ControlError| e.to_string();
        let law = self.config.law(task.controller.as_deref()).map_err(words)?;
        let mut readers = Vec::new();
        for name in &task.estimators {
            let short = EstimatorName::from(name)
                .map_err(|_| format!("estimators: \"{name}\" is longer than 64 bytes"))?;
            let newest = self.bus.latest(&topics::estimate_object(name));
            readers.push((short, newest.map_err(|e| e.to_string())?));
        }
        let rules = rules(&law.patience, &task.switching, false);
        Ok(ObjectProgram {
            readers: ObjectReaders::new(readers, self.config.shape, rules),
            normal: None,
            law: HybridDynamics::new(
                self.config.arm,
                self.config.flange_from_tool,
                self.config.limits,
                &law,
                task,
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

    fn leave(&self) -> Result<Boxed, String> {
        Ok(Box::new(self.program_of(&self.check.leave())?))
    }

    fn check_estimates(&self, program: &Boxed, _: &Mailbox<Boxed>, _: Time) -> Result<(), String> {
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
    /// In use in the cycle before, base axes.
    normal: Option<Vector3<f64>>,
}

impl TorqueProgram for ObjectProgram {
    fn task(&self) -> &Task {
        self.law.task()
    }

    fn check_start(
        &self,
        clearance: &Clearance,
        position: &Vector3<f64>,
    ) -> Result<(), ControlError> {
        self.law.check_start(clearance, position)
    }

    fn begin(&mut self, clearance: Clearance) {
        self.law.begin(clearance);
    }

    fn step(&mut self, input: &TorqueInput<'_>) -> Option<TorqueAnswer> {
        let way_m = input.slid_m(self.law.phase());
        let estimate = self.readers.read(input, self.normal, way_m);
        let wrench = &input.wrench;
        let output = self.law.step(&HybridInput {
            time_s: input.time_s,
            dt_s: input.dt_s,
            q: joints(&input.arm.q).ok()?,
            qd: joints(&input.arm.qd).ok()?,
            arm_ready: input.arm_ready,
            wrench: wrench.wrench,
            wrench_validity: wrench.validity,
            wrench_age_s: wrench.age_s,
            bias_age_s: wrench.bias_age_s,
            zero_bound_n: wrench.zero_bound_n,
            untared: wrench.untared,
            estimate: estimate.map(|(estimate, _)| estimate),
            estimate_age_s: estimate.map_or(f64::INFINITY, |(_, age_s)| age_s),
        });
        // Until the tare is done the law may stand on no estimate at all.
        let goes_by_it = output.phase.is_active() && output.phase != Phase::Tare;
        self.normal = goes_by_it.then_some(output.normal);
        let (name, switches, cause) = self.readers.in_use();
        let (what, why) = cause.text();
        let mut state = state(&output, input, estimate.map(|(_, age_s)| age_s));
        tell_ages(&mut state, self.readers.ages());
        Some(TorqueAnswer {
            torque: joint_array(&output.torque),
            report: Report {
                state,
                shaping: None,
                phase: output.phase,
                fault: output.fault,
                tare_requested: output.tare_requested,
                clearance: output.clearance,
                zero_withdrawn: output.zero_withdrawn,
                estimator: Some((name, switches, cut_format(format_args!("{what}{why}")))),
            },
        })
    }

    fn pause(&mut self, paused: bool) -> Result<(), ControlError> {
        self.law.pause(paused)
    }

    fn is_left_on_surface(&self) -> bool {
        self.law.is_left_on_surface()
    }

    fn leave_surface(&mut self) {
        self.law.leave_surface();
    }

    fn is_paused(&self) -> bool {
        self.law.is_paused()
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
    let wrench = &input.wrench;
    ControlState {
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n.unwrap_or(f64::NAN),
        wrench: if wrench.validity.is_valid() && wrench.wrench.is_finite() {
            (&wrench.wrench).into()
        } else {
            (&no_wrench()).into()
        },
        path_reference: (&output.path_reference).into(),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age_told(Some(wrench.age_s)),
        estimate_age_s: age_told(estimate_age_s),
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        wrench_validity: wrench.validity as u8,
        zero_age_s: wrench.bias_age_s.unwrap_or(-1.0),
        zero_bound_n: wrench.bias_age_s.and(wrench.zero_bound_n).unwrap_or(-1.0),
        ..ControlState::default()
    }
}

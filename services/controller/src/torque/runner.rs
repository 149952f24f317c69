//! The laws for arms that take torques: each task comes as a program with its law and its readers.

use std::time::Instant;

use tangent_control::{Clearance, CommandKind, ControlError, EstimatorName, Phase, SwitchRefusal};
use tangent_runtime::Parameter;
use tangent_schemas::Name;
use tangent_schemas::convert::cut;
use tangent_schemas::tangent::{ArmState, ControlState};

use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::inputs::{EstimateReader, Packet, WrenchNow, WrenchReader};
use crate::messages::no_wrench;
use crate::runner::{Motion, Report, Runner, Start};

/// A task on its way to the loop.
pub type Boxed = Box<dyn TorqueProgram>;

/// The program that runs, and what outlasts it.
pub struct TorqueRunner {
    program: Option<Boxed>,
    /// Number of task starts.
    activation: u64,
    clearance: Clearance,
    wrench: WrenchReader,
    force_reference: Parameter,
    force_reference_seen: f64,
    started: Instant,
}

impl TorqueRunner {
    /// Before the first task.
    pub fn new(wrench: WrenchReader, clearance: Clearance, force_reference: Parameter) -> Self {
        Self {
            program: None,
            activation: 0,
            clearance,
            wrench,
            force_reference_seen: force_reference.get(),
            force_reference,
            started: Instant::now(),
        }
    }

    fn running(&mut self, request: &'static str) -> Result<&mut Boxed, ControlError> {
        let phase = self.phase().name();
        self.program.as_mut().ok_or(ControlError::WrongPhase {
            request,
            phase,
            remedy: "start a task first",
        })
    }
}

impl Runner for TorqueRunner {
    type Program = Boxed;
    type Output = TorqueAnswer;

    fn phase(&self) -> Phase {
        self.program
            .as_ref()
            .map_or(Phase::Idle, |program| program.phase())
    }

    fn activation(&self) -> u64 {
        self.activation
    }

    fn clearance(&self) -> Clearance {
        self.clearance
    }

    fn start(&mut self, program: &mut Option<Boxed>, start: &Start) -> Result<(), ControlError> {
        let clearance = if start.said_clear {
            Clearance::Assumed
        } else {
            self.clearance
        };
        if let Some(new) = program {
            new.check_start(&clearance, &start.position)?;
        }
        let Some(mut new) = program.take() else {
            return Ok(());
        };
        self.clearance = clearance;
        new.begin(clearance);
        let force_n = new.task().force.reference_n;
        *program = self.program.replace(new);
        self.activation = self.activation.max(start.latched).saturating_add(1);
        self.force_reference.set(force_n);
        self.force_reference_seen = self.force_reference.get();
        Ok(())
    }

    fn pause(&mut self) -> Result<(), ControlError> {
        self.running("pause")?.pause(true)
    }

    fn resume(&mut self) -> Result<(), ControlError> {
        self.running("resume")?.pause(false)
    }

    fn stop(&mut self) {
        if let Some(program) = &mut self.program {
            program.stop();
        }
    }

    fn is_left_on_surface(&self) -> bool {
        self.program
            .as_ref()
            .is_some_and(|program| program.is_left_on_surface())
    }

    fn leave_surface(&mut self, latched: u64) {
        if let Some(program) = &mut self.program {
            self.activation = self.activation.max(latched).saturating_add(1);
            program.leave_surface();
        }
    }

    fn select(&mut self, name: &EstimatorName, force: bool) -> Result<(), SwitchRefusal> {
        match &mut self.program {
            Some(program) => program.select(name, force),
            None => Err(SwitchRefusal::NoTask),
        }
    }

    /// Programs bring their readers along.
    fn listen(&mut self, reader: EstimateReader) -> Option<EstimateReader> {
        Some(reader)
    }

    fn take_parameters(&mut self) {
        let value = self.force_reference.get();
        if value != self.force_reference_seen {
            self.force_reference_seen = value;
            if let Some(program) = &mut self.program {
                program.set_force_reference(value);
            }
        }
    }

    fn hold(&mut self, held: bool) {
        self.wrench.hold(held);
    }

    fn step(&mut self, packet: &Packet<'_>) -> Option<Self::Output> {
        let arm = packet.arm;
        let wrench = self.wrench.read();
        let answer = match &mut self.program {
            Some(program) => program.step(&TorqueInput {
                arm: &arm.message,
                dt_s: packet.dt_s,
                since_packet: arm.received.elapsed(),
                time_s: arm
                    .received
                    .saturating_duration_since(self.started)
                    .as_secs_f64(),
                arm_ready: packet.arm_ready,
                wrench,
            })?,
            None => idle(&arm.message, self.clearance, &wrench),
        };
        self.clearance = answer.report.clearance;
        Some(answer)
    }

    fn motion(&self, answer: &TorqueAnswer) -> Motion {
        Motion {
            kind: if answer.report.phase.is_active() {
                CommandKind::JointTorque
            } else {
                CommandKind::Hold
            },
            values: answer.torque.clone(),
            acceleration: 0.0,
        }
    }

    fn report(&self, answer: TorqueAnswer) -> Report {
        let program = self.program.as_ref();
        Report {
            state: ControlState {
                task: program.map_or_else(Name::new, |program| cut(&program.task().name)),
                paused: program.is_some_and(|program| program.is_paused()),
                base_age_s: -1.0,
                ..answer.report.state
            },
            ..answer.report
        }
    }
}

/// Before the first task nothing is asked of the arm.
fn idle(arm: &ArmState, clearance: Clearance, wrench: &WrenchNow) -> TorqueAnswer {
    TorqueAnswer {
        torque: arm.q.iter().map(|_| 0.0).collect(),
        report: Report {
            state: ControlState {
                path_reference: arm.tool_pose.position.clone(),
                wrench_age_s: -1.0,
                estimate_age_s: -1.0,
                force_n: f64::NAN,
                wrench: (&no_wrench()).into(),
                wrench_validity: wrench.validity as u8,
                zero_age_s: -1.0,
                zero_bound_n: -1.0,
                ..ControlState::default()
            },
            shaping: None,
            phase: Phase::Idle,
            fault: None,
            tare_requested: false,
            clearance,
            zero_withdrawn: false,
            estimator: None,
        },
    }
}

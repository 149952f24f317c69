//! One cycle of the torque loop: called inside the arm's `publish(arm/state)`, with `arm/command` published before it returns.
//! Takes no lock and no memory.

use std::sync::Arc;
use std::time::Instant;

use tangent_control::{CommandKind, ControlError, Phase, SwitchRefusal};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{
    Age, Gauge, HealthReporter, Histogram, Parameter, Publisher, Rate, Received,
};
use tangent_schemas::Name;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, ShapingState};

use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::inputs::{WrenchReader, driven_by_another};
use crate::mailbox::{Ask, Letter, Mailbox, Outcome};
use crate::watch::{Told, Watch};

/// A task on its way to the loop.
pub type Boxed = Box<dyn TorqueProgram>;

/// Meters of the cycle.
pub struct TorqueMeters {
    cycles: Rate,
    arm_age: Age,
    wrench_age: Gauge,
    estimate_age: Gauge,
    step: Histogram,
}

impl TorqueMeters {
    /// In the service's health.
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            cycles: health.rate("arm_state"),
            arm_age: health.age("arm_state"),
            wrench_age: health.gauge("wrench_age_s"),
            estimate_age: health.gauge("estimate_age_s"),
            step: health.histogram("step"),
        }
    }
}

/// Everything the loop owns.
pub struct TorqueCycle {
    pub program: Option<Boxed>,
    /// Counts task starts.
    pub activation: u64,
    /// Activation that the arm has latched out.
    pub latched: u64,
    pub wrench: WrenchReader,
    pub command: Publisher<ArmCommand>,
    pub state: Publisher<ControlState>,
    pub shaping: Publisher<ShapingState>,
    pub source: Name,
    pub mailbox: Arc<Mailbox<Boxed>>,
    pub meters: TorqueMeters,
    pub watch: Watch<Boxed>,
    pub force_reference: Parameter,
    pub force_reference_seen: f64,
    pub started: Instant,
}

impl TorqueCycle {
    /// Answers one packet of the arm.
    pub fn step(&mut self, arm: &Received<ArmState>) {
        let begin = Instant::now();
        let arm_age = begin.saturating_duration_since(arm.received);
        self.meters.cycles.tick();
        self.meters.arm_age.mark_at(arm.received);
        self.watch.count_missed(arm.message.cycle);
        self.latched = arm.message.activation_latched;
        while let Some(letter) = self.mailbox.take() {
            self.deal_with(letter);
        }
        self.take_parameter();
        let wrench = self.wrench.read();
        let other = driven_by_another(&arm.message, self.command.id());
        // The arm has ended this task: to it, all that is commanded for it is void.
        let ended = self.phase().is_active() && self.latched >= self.activation;
        let input = TorqueInput {
            arm: &arm.message,
            time_s: arm
                .received
                .saturating_duration_since(self.started)
                .as_secs_f64(),
            arm_ready: arm.message.ready && other.is_none() && !ended,
            wrench,
        };
        let answer = match &mut self.program {
            Some(program) => program.step(&input),
            None => Some(idle(&arm.message)),
        };
        let Some(answer) = answer else {
            // No answer: the arm comes to rest by itself.
            self.watch.unusable();
            return;
        };
        let kind = if answer.phase.is_active() {
            CommandKind::JointTorque
        } else {
            CommandKind::Hold
        };
        self.command.publish(&ArmCommand {
            header: Header::new(now_ns(), "base"),
            cycle: arm.message.cycle,
            kind: kind as u8,
            values: answer.torque.clone(),
            acceleration: 0.0,
            source: self.source,
            activation: self.activation,
        });
        let took = begin.elapsed();
        self.meters.step.record(took);
        self.meters.wrench_age.set(wrench.age_s);
        self.meters.estimate_age.set(answer.state.estimate_age_s);
        self.say(
            arm,
            answer,
            other,
            arm_age.as_secs_f64(),
            took.as_secs_f64(),
        );
    }

    fn say(
        &mut self,
        arm: &Received<ArmState>,
        answer: TorqueAnswer,
        other: Option<Name>,
        arm_state_age_s: f64,
        step_s: f64,
    ) {
        let (estimator, switches, cause) = answer.estimator;
        if answer.phase.is_active() {
            self.watch.estimator(estimator, switches, cause);
        }
        let fault_text = match answer.fault {
            Some(fault) if answer.phase != Phase::Idle => cut(fault.text()),
            _ => cut(""),
        };
        self.state.publish(&ControlState {
            header: Header::new(arm.message.header.stamp.to_ns(), "base"),
            cycle: arm.message.cycle,
            phase: answer.phase as u8,
            phase_text: cut(answer.phase.name()),
            task: self
                .program
                .as_ref()
                .map_or_else(Name::new, |program| cut(&program.task().name)),
            activation: self.activation,
            estimator,
            estimator_cause: cause,
            estimator_switches: switches,
            arm_state_age_s,
            base_age_s: -1.0,
            step_s,
            fault: fault_text,
            ..answer.state
        });
        if let Some(shaping) = answer.shaping {
            self.shaping.publish(&ShapingState {
                header: Header::new(arm.message.header.stamp.to_ns(), "base"),
                cycle: arm.message.cycle,
                ..shaping
            });
        }
        self.watch.after(&Told {
            phase: answer.phase,
            fault: answer.fault,
            fault_text,
            tare_requested: answer.tare_requested,
            other,
        });
    }

    fn phase(&self) -> Phase {
        self.program
            .as_ref()
            .map_or(Phase::Idle, |program| program.phase())
    }

    fn deal_with(&mut self, mut letter: Letter<Boxed>) {
        let phase = self.phase();
        let nothing = |request| {
            Outcome::Refused(ControlError::WrongPhase {
                request,
                phase: phase.name(),
                remedy: "start a task first",
            })
        };
        let result = match (letter.ask(), &mut self.program) {
            (Ask::Start(_), _) if phase.is_active() => {
                Err(Outcome::Refused(ControlError::WrongPhase {
                    request: "start a task",
                    phase: phase.name(),
                    remedy: "stop the running task first",
                }))
            }
            (Ask::Start(program), _) => {
                if let Some(new) = program.take() {
                    let force_n = new.task().force.reference_n;
                    **program = self.program.replace(new);
                    self.activation = self.activation.max(self.latched) + 1;
                    self.force_reference.set(force_n);
                    self.force_reference_seen = self.force_reference.get();
                }
                Ok(())
            }
            (Ask::Pause, Some(program)) => program.pause(true).map_err(Outcome::Refused),
            (Ask::Resume, Some(program)) => program.pause(false).map_err(Outcome::Refused),
            (Ask::Pause, None) => Err(nothing("pause")),
            (Ask::Resume, None) => Err(nothing("resume")),
            (Ask::Stop, program) => {
                if let Some(program) = program {
                    program.stop();
                }
                Ok(())
            }
            (Ask::Select { name, force }, Some(program)) => {
                program.select(name, *force).map_err(Outcome::SwitchRefused)
            }
            (Ask::Select { .. }, None) => Err(Outcome::SwitchRefused(SwitchRefusal::NoTask)),
            // Programs bring their readers along.
            (Ask::Listen(_), _) => Ok(()),
        };
        let activation = self.activation;
        letter.answer(match result {
            Ok(()) => Outcome::Done { activation },
            Err(refused) => refused,
        });
    }

    fn take_parameter(&mut self) {
        let value = self.force_reference.get();
        if value != self.force_reference_seen {
            self.force_reference_seen = value;
            if let Some(program) = &mut self.program {
                program.set_force_reference(value);
            }
        }
    }
}

/// Nothing was started yet: nothing is asked of the arm.
fn idle(arm: &ArmState) -> TorqueAnswer {
    TorqueAnswer {
        torque: arm.q.iter().map(|_| 0.0).collect(),
        state: ControlState {
            path_reference: arm.tool_pose.position.clone(),
            wrench_age_s: -1.0,
            estimate_age_s: -1.0,
            ..ControlState::default()
        },
        shaping: None,
        phase: Phase::Idle,
        fault: None,
        tare_requested: false,
        estimator: Default::default(),
    }
}

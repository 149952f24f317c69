//! One cycle of the torque loop: called inside the arm's `publish(arm/state)`, with `arm/command` published before it returns.
//! Takes no lock and no memory.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_control::{Clearance, CommandKind, ControlError, Phase, SwitchRefusal};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{
    Age, Gauge, HealthReporter, Histogram, Parameter, Publisher, Rate, Received,
};
use tangent_schemas::Name;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, ShapingState};

use super::program::{TorqueAnswer, TorqueInput, TorqueProgram};
use crate::inputs::{WrenchNow, WrenchReader, driven_by_another};
use crate::mailbox::{Ask, Letter, Mailbox, Outcome, cannot_leave};
use crate::messages::no_wrench;
use crate::pinned::PinnedArm;
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
    pub arm: PinnedArm,
    /// A command would move the arm now.
    pub ready: bool,
    /// Whether the tool may touch something: outlasts the programs.
    pub clearance: Clearance,
    /// Where the tool is, base axes, m.
    pub position: Vector3<f64>,
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
        self.position = (&arm.message.tool_pose.position).into();
        let other = driven_by_another(&arm.message, self.command.mark());
        self.ready = arm.message.ready && other.is_none();
        for slot in self.mailbox.waiting() {
            if let Some(letter) = self.mailbox.take(slot, begin) {
                self.deal_with(letter);
            }
        }
        self.take_parameter();
        let active = self.phase().is_active();
        // A task keeps to the publishers that it was started on.
        self.wrench.hold(active);
        let another_arm = self.arm.is_another(arm.publisher, active);
        let wrench = self.wrench.read();
        // The arm has ended this task: to it, all that is commanded for it is void.
        let ended = another_arm || active && self.latched >= self.activation;
        let input = TorqueInput {
            arm: &arm.message,
            since_packet: arm.received.elapsed(),
            time_s: arm
                .received
                .saturating_duration_since(self.started)
                .as_secs_f64(),
            arm_ready: self.ready && !ended,
            wrench,
        };
        let answer = match &mut self.program {
            Some(program) => program.step(&input),
            None => Some(idle(&arm.message, self.clearance)),
        };
        if let Some(answer) = &answer {
            self.clearance = answer.clearance;
        }
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
            &wrench,
        );
    }

    fn say(
        &mut self,
        arm: &Received<ArmState>,
        answer: TorqueAnswer,
        other: Option<Name>,
        arm_state_age_s: f64,
        step_s: f64,
        wrench: &WrenchNow,
    ) {
        let (estimator, switches, cause) = answer.estimator;
        if answer.phase.is_active() {
            self.watch.estimator(estimator, switches, cause);
        }
        let fault_text = match answer.fault {
            Some(fault) if answer.phase != Phase::Idle => cut(fault.text()),
            _ => cut(""),
        };
        let fault_text = self.watch.fault_text(answer.fault, fault_text);
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
            paused: self.program.as_ref().is_some_and(|p| p.is_paused()),
            wrench_validity: wrench.validity as u8,
            contact_possible: !answer.clearance.is_free(),
            zero_age_s: answer.zero.map_or(-1.0, |(age_s, _)| age_s),
            zero_bound_n: answer.zero.and_then(|(_, bound_n)| bound_n).unwrap_or(-1.0),
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
            clearance: answer.clearance,
            zero_withdrawn: answer.zero_withdrawn,
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
            (Ask::Start { .. }, _) if phase.is_active() => {
                Err(Outcome::Refused(ControlError::WrongPhase {
                    request: "start a task",
                    phase: phase.name(),
                    remedy: "stop the running task first",
                }))
            }
            (
                Ask::Start {
                    program,
                    said_clear,
                },
                _,
            ) => {
                let position = &self.position;
                let clearance = if *said_clear {
                    Clearance::Assumed
                } else {
                    self.clearance
                };
                let allowed = program
                    .as_ref()
                    .as_ref()
                    .map_or(Ok(()), |new| new.check_start(&clearance, position));
                if let Err(error) = allowed {
                    Err(Outcome::Refused(error))
                } else if let Some(mut new) = program.take() {
                    self.clearance = clearance;
                    self.watch.said_clear = *said_clear;
                    new.begin(clearance);
                    let force_n = new.task().force.reference_n;
                    **program = self.program.replace(new);
                    self.activation = self.activation.max(self.latched).saturating_add(1);
                    self.force_reference.set(force_n);
                    self.force_reference_seen = self.force_reference.get();
                    Ok(())
                } else {
                    Ok(())
                }
            }
            (Ask::Pause, Some(program)) => program.pause(true).map_err(Outcome::Refused),
            (Ask::Resume, Some(program)) => program.pause(false).map_err(Outcome::Refused),
            (Ask::Pause, None) => Err(nothing("pause")),
            (Ask::Resume, None) => Err(nothing("resume")),
            (Ask::Stop, Some(program)) if program.is_left_on_surface() => {
                if self.ready {
                    self.activation = self.activation.max(self.latched) + 1;
                    program.leave_surface();
                    Ok(())
                } else {
                    Err(Outcome::Refused(cannot_leave(phase)))
                }
            }
            (Ask::Stop, _) if !phase.is_active() && !self.clearance.is_free() => {
                Err(Outcome::MayTouch)
            }
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
        let (activation, phase) = (self.activation, self.phase());
        letter.answer(match result {
            Ok(()) => Outcome::Done { activation, phase },
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
fn idle(arm: &ArmState, clearance: Clearance) -> TorqueAnswer {
    TorqueAnswer {
        torque: arm.q.iter().map(|_| 0.0).collect(),
        state: ControlState {
            path_reference: arm.tool_pose.position.clone(),
            wrench_age_s: -1.0,
            estimate_age_s: -1.0,
            force_n: f64::NAN,
            wrench: (&no_wrench()).into(),
            ..ControlState::default()
        },
        clearance,
        zero_withdrawn: false,
        zero: None,
        shaping: None,
        phase: Phase::Idle,
        fault: None,
        tare_requested: false,
        estimator: Default::default(),
    }
}

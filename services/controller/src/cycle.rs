//! One cycle of the loop: called inside the bridge's `publish(arm/state)` when co-located, with
//! `arm/command` published before it returns. Takes no lock and allocates nothing.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_control::{ControlError, Law, LawOutput, Phase, Start, StateInterval};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Age, Gauge, HealthReporter, Histogram, Publisher, Rate, Received};
use tangent_schemas::convert::joint_array;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, CoverageState, ShapingState};
use tangent_schemas::{Name, Text};

use crate::inputs::{Packet, driven_by_another};
use crate::mailbox::{Action, Mailbox, MailboxRequest, Outcome, cannot_leave};
use crate::messages;
use crate::pinned::PinnedArm;
use crate::runner::{Prepared, Runner};
use crate::watch::{Told, Watch};

/// Meters of the cycle.
pub struct Meters {
    cycles: Rate,
    arm_age: Age,
    wrench_age: Gauge,
    estimate_age: Gauge,
    step: Histogram,
}

impl Meters {
    /// Meters registered in the service's health.
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

/// Publishers of the loop.
pub struct Outlets {
    pub command: Publisher<ArmCommand>,
    pub state: Publisher<ControlState>,
    /// `None` for an arm whose law does not shape.
    pub shaping: Option<Publisher<ShapingState>>,
    /// `None` for an arm whose law runs no tasks with coverage.
    pub coverage: Option<Publisher<CoverageState>>,
    /// Name of this controller in commands.
    pub source: Name,
}

/// State of the loop.
pub struct Cycle<L: Law<N>, const N: usize> {
    runner: Runner<L, N>,
    outlets: Outlets,
    mailbox: Arc<Mailbox<Prepared<L::Config>>>,
    meters: Meters,
    watch: Watch<Prepared<L::Config>>,
    arm: PinnedArm,
    interval: StateInterval,
    /// Activation that the arm has latched out.
    latched: u64,
    /// Whether a command would move the arm now.
    ready: bool,
    /// Position of the tool, base axes, m.
    position: Vector3<f64>,
}

impl<L: Law<N>, const N: usize> Cycle<L, N> {
    /// State before the first packet.
    pub fn new(
        runner: Runner<L, N>,
        outlets: Outlets,
        mailbox: &Arc<Mailbox<Prepared<L::Config>>>,
        health: &Arc<HealthReporter>,
    ) -> Self {
        Self {
            runner,
            outlets,
            mailbox: Arc::clone(mailbox),
            meters: Meters::new(health),
            watch: Watch::new(mailbox, health),
            arm: PinnedArm::default(),
            interval: StateInterval::default(),
            latched: 0,
            ready: false,
            position: Vector3::zeros(),
        }
    }

    /// Answers one packet of the arm.
    pub fn step(&mut self, arm: &Received<ArmState>) {
        let begin = Instant::now();
        let arm_age = begin.saturating_duration_since(arm.received);
        self.meters.cycles.tick();
        self.meters.arm_age.mark_at(arm.received);
        self.watch.count_missed(arm.message.cycle);
        self.latched = arm.message.activation_latched;
        self.position = (&arm.message.tool_pose.position).into();
        let other = driven_by_another(&arm.message, self.outlets.command.mark());
        self.ready = arm.message.ready && other.is_none();
        for slot in self.mailbox.waiting() {
            if let Some(request) = self.mailbox.take(slot, begin) {
                self.carry_out(request);
            }
        }
        self.runner.take_parameters();
        let active = self.runner.phase().is_active();
        // A task keeps the publishers with which it was started.
        self.runner.inputs.hold(active);
        let another_arm = self.arm.is_another(arm.publisher, active);
        // The arm has ended this task: it ignores every further command for it.
        let ended = another_arm || active && self.latched >= self.runner.activation();
        let state = &arm.message;
        let packet = Packet {
            arm,
            dt_s: self.interval.step(state.robot_time_s, state.period_s),
            arm_ready: self.ready && !ended,
        };
        let Some((input, output)) = self.runner.step(&packet) else {
            self.watch.unusable();
            return;
        };
        let command = &output.command;
        self.outlets.command.publish(&ArmCommand {
            header: Header::new(now_ns(), "base"),
            cycle: arm.message.cycle,
            kind: command.kind as u8,
            values: joint_array(&command.values),
            acceleration: command.acceleration,
            source: self.outlets.source,
            activation: self.runner.activation(),
        });
        let took = begin.elapsed();
        let mut state = messages::state(&input, &output, &self.runner.law);
        messages::tell_ages(&mut state, self.runner.inputs.ages());
        state.arm_state_age_s = arm_age.as_secs_f64();
        state.step_s = took.as_secs_f64();
        self.meters.step.record(took);
        self.publish(&arm.message, state, &output, other);
        // What a task has learnt stays here until the one before was taken.
        if !self.mailbox.pass.is_full()
            && let Some(pass) = self.runner.law.take_pass()
        {
            let _ = self.mailbox.pass.push(pass);
        }
    }

    fn publish(
        &mut self,
        arm: &ArmState,
        state: ControlState,
        output: &LawOutput<N>,
        other: Option<Name>,
    ) {
        if output.phase.is_active() {
            self.watch.estimator(
                state.estimator,
                state.estimator_switches,
                state.estimator_cause,
            );
        }
        let fault_text = match output.fault {
            Some(fault) if output.phase != Phase::Idle => fault.text(),
            _ => Text::new(),
        };
        let fault_text = self.watch.fault_text(output.fault, fault_text, arm);
        let header = || Header::new(arm.header.stamp.to_ns(), "base");
        let activation = self.runner.activation();
        let state = ControlState {
            header: header(),
            cycle: arm.cycle,
            activation,
            fault: fault_text,
            ..state
        };
        self.outlets.state.publish(&state);
        if let (Some(publisher), Some(shaping)) = (&self.outlets.shaping, &output.shaping) {
            publisher.publish(&ShapingState {
                header: header(),
                cycle: arm.cycle,
                ..messages::shaping(shaping)
            });
        }
        if let Some(publisher) = &self.outlets.coverage
            && let Some(result) = self.runner.law.take_coverage()
        {
            publisher.publish(&CoverageState {
                header: header(),
                cycle: arm.cycle,
                task: state.task,
                activation,
                ..messages::coverage(&result)
            });
        }
        self.meters.wrench_age.set(state.wrench_age_s);
        self.meters.estimate_age.set(state.estimate_age_s);
        self.watch.after(&Told {
            phase: output.phase,
            fault: output.fault,
            fault_text,
            tare_requested: output.tare_requested,
            clearance: output.clearance,
            zero_withdrawn: output.zero_withdrawn,
            other,
        });
    }

    fn carry_out(&mut self, mut request: MailboxRequest<Prepared<L::Config>>) {
        let runner = &mut self.runner;
        let phase = runner.phase();
        let result = match request.action() {
            Action::Start { .. } if phase.is_active() => {
                Err(Outcome::Refused(ControlError::WrongPhase {
                    request: "start a task",
                    phase: phase.name(),
                    remedy: "stop the running task first",
                }))
            }
            Action::Start {
                program,
                said_clear,
            } => {
                let start = Start {
                    said_clear: *said_clear,
                    position: self.position,
                    latched: self.latched,
                };
                let started = runner.start(program, &start);
                if started.is_ok() {
                    self.watch.said_clear = *said_clear;
                }
                started.map_err(Outcome::Refused)
            }
            Action::Pause => runner.law.pause(true).map_err(Outcome::Refused),
            Action::Resume => runner.law.pause(false).map_err(Outcome::Refused),
            Action::Stop if runner.law.is_left_on_surface() => {
                if self.ready {
                    runner.law.leave_surface(self.latched);
                    Ok(())
                } else {
                    Err(Outcome::Refused(cannot_leave(phase)))
                }
            }
            Action::Stop if !phase.is_active() && !runner.clearance().is_free() => {
                Err(Outcome::MayTouch)
            }
            Action::Stop => {
                runner.law.stop();
                Ok(())
            }
            Action::Select { name, force } => {
                runner.select(name, *force).map_err(Outcome::SwitchRefused)
            }
            Action::Listen(reader) => {
                if let Some(new) = reader.take() {
                    **reader = runner.listen(new);
                }
                Ok(())
            }
        };
        let (activation, phase) = (self.runner.activation(), self.runner.phase());
        request.answer(match result {
            Ok(()) => Outcome::Done { activation, phase },
            Err(refused) => refused,
        });
    }
}

//! One cycle of the loop: called inside the bridge's `publish(arm/state)` when co-located, with
//! `arm/command` published before it returns. Takes no lock and allocates nothing.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_control::{ControlError, Phase, StateInterval};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Age, Gauge, HealthReporter, Histogram, Publisher, Rate, Received};
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState, ShapingState};
use tangent_schemas::{Name, Text};

use crate::inputs::{Packet, driven_by_another};
use crate::mailbox::{Action, Mailbox, MailboxRequest, Outcome, cannot_leave};
use crate::pinned::PinnedArm;
use crate::runner::{Report, Runner, Start};
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

/// Where the loop publishes.
pub struct Outlets {
    pub command: Publisher<ArmCommand>,
    pub state: Publisher<ControlState>,
    /// `None` for an arm without a law that shapes.
    pub shaping: Option<Publisher<ShapingState>>,
    /// Name of this controller in commands.
    pub source: Name,
}

/// Everything the loop owns.
pub struct Cycle<R: Runner> {
    runner: R,
    outlets: Outlets,
    mailbox: Arc<Mailbox<R::Program>>,
    meters: Meters,
    watch: Watch<R::Program>,
    arm: PinnedArm,
    interval: StateInterval,
    /// Activation that the arm has latched out.
    latched: u64,
    /// Whether a command would move the arm now.
    ready: bool,
    /// Position of the tool, base axes, m.
    position: Vector3<f64>,
}

impl<R: Runner> Cycle<R> {
    /// Before the first packet.
    pub fn new(
        runner: R,
        outlets: Outlets,
        mailbox: &Arc<Mailbox<R::Program>>,
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
        // A task keeps to the publishers that it was started on.
        self.runner.hold(active);
        let another_arm = self.arm.is_another(arm.publisher, active);
        // The arm has ended this task: it ignores every further command for it.
        let ended = another_arm || active && self.latched >= self.runner.activation();
        let state = &arm.message;
        let packet = Packet {
            arm,
            dt_s: self.interval.step(state.robot_time_s, state.period_s),
            arm_ready: self.ready && !ended,
        };
        let Some(output) = self.runner.step(&packet) else {
            self.watch.unusable();
            return;
        };
        let motion = self.runner.motion(&output);
        self.outlets.command.publish(&ArmCommand {
            header: Header::new(now_ns(), "base"),
            cycle: arm.message.cycle,
            kind: motion.kind as u8,
            values: motion.values,
            acceleration: motion.acceleration,
            source: self.outlets.source,
            activation: self.runner.activation(),
        });
        let took = begin.elapsed();
        let mut report = self.runner.report(output);
        report.state.arm_state_age_s = arm_age.as_secs_f64();
        report.state.step_s = took.as_secs_f64();
        self.meters.step.record(took);
        self.publish(&arm.message, report, other);
    }

    fn publish(&mut self, arm: &ArmState, report: Report, other: Option<Name>) {
        let (estimator, switches, cause) = report.estimator.unwrap_or_default();
        if report.phase.is_active() {
            self.watch.estimator(estimator, switches, cause);
        }
        let fault_text = match report.fault {
            Some(fault) if report.phase != Phase::Idle => cut(fault.text()),
            _ => Text::new(),
        };
        let fault_text = self.watch.fault_text(report.fault, fault_text);
        let header = || Header::new(arm.header.stamp.to_ns(), "base");
        let state = ControlState {
            header: header(),
            cycle: arm.cycle,
            phase: report.phase as u8,
            phase_text: cut(report.phase.name()),
            activation: self.runner.activation(),
            estimator,
            estimator_cause: cause,
            estimator_switches: switches,
            fault: fault_text,
            contact_possible: !report.clearance.is_free(),
            ..report.state
        };
        self.outlets.state.publish(&state);
        if let (Some(publisher), Some(shaping)) = (&self.outlets.shaping, report.shaping) {
            publisher.publish(&ShapingState {
                header: header(),
                cycle: arm.cycle,
                ..shaping
            });
        }
        self.meters.wrench_age.set(state.wrench_age_s);
        self.meters.estimate_age.set(state.estimate_age_s);
        self.watch.after(&Told {
            phase: report.phase,
            fault: report.fault,
            fault_text,
            tare_requested: report.tare_requested,
            clearance: report.clearance,
            zero_withdrawn: report.zero_withdrawn,
            other,
        });
    }

    fn carry_out(&mut self, mut request: MailboxRequest<R::Program>) {
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
            Action::Pause => runner.pause().map_err(Outcome::Refused),
            Action::Resume => runner.resume().map_err(Outcome::Refused),
            Action::Stop if runner.is_left_on_surface() => {
                if self.ready {
                    runner.leave_surface(self.latched);
                    Ok(())
                } else {
                    Err(Outcome::Refused(cannot_leave(phase)))
                }
            }
            Action::Stop if !phase.is_active() && !runner.clearance().is_free() => {
                Err(Outcome::MayTouch)
            }
            Action::Stop => {
                runner.stop();
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

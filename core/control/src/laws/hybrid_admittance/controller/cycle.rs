//! One cycle of the robot: from the measurements to the joint velocities and the report.

use tangent_mechanics::{Joints, Twist, manipulability};
use tangent_schemas::CommandKind;

use super::super::interface::{ControlInput, ControlOutput};
use super::super::joint_way::JointWay;
use super::super::loop_delay::DelaySample;
use super::super::motion::{Learning, ramp_gains, wanted_twist};
use super::super::percept::Percept;
use super::Controller;
use crate::contact::alignment::alignment_error;
use crate::joint_move;
use crate::limits::faults::Fault;
use crate::limits::plausibility::{is_arm_state, is_place, is_time, is_velocity};
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::program::Program;

/// Speed scaling of the robot above which the arm carries out the commands as they are.
const UNSCALED: f64 = 0.999;

impl<const N: usize> Controller<N> {
    /// One robot cycle. Allocates nothing.
    pub fn step(&mut self, input: &ControlInput<N>) -> ControlOutput<N> {
        if !is_sane(input) {
            if self.run.phase.is_active() {
                self.run.abort(Fault::ArmState);
            }
            return self.stand(input);
        }
        let placed = self.moving_base.place(input);
        self.estimates = placed.estimates;
        if self.run.phase.is_active() && !input.arm_ready {
            self.run.abort(Fault::ArmNotReady);
        }
        if let (Some(coverage), Some(program)) = (&mut self.memory.coverage, &mut self.program) {
            self.run.next_round(coverage, &mut program.path);
        }
        let (Some(program), true) = (&self.program, self.run.phase.is_active()) else {
            return self.stand(input);
        };
        ramp_gains(&mut self.config, &self.targets, input.dt_s);
        let (setting, in_use) = (&program.config.force, &mut self.config.force);
        (in_use.loop_delay_s, in_use.loop_delay_sd_s) = self
            .loop_delay
            .in_use_s(&self.delay, (setting.loop_delay_s, setting.loop_delay_sd_s));
        let reference_n = self.reference_n(program);
        let speed_target = self.targets[Parameter::Speed as usize];
        self.run
            .compare_with_arm(&self.limits, &self.flange_from_tool, &placed);
        let percept = self.run.perceive(
            program,
            &self.config,
            &self.limits,
            &placed,
            &self.moving_base,
            reference_n,
        );
        if let Some(target) = self.poses.target(&self.run) {
            self.run.travel.look(&input.q, target);
        }
        self.run.decide(
            program,
            &self.config,
            &self.limits,
            &self.requests,
            reference_n,
            &placed,
            &percept,
        );
        let planning = self
            .memory
            .coverage
            .as_ref()
            .is_some_and(|c| c.is_planning());
        if self.run.awaits_route() && !planning {
            let chart = self.memory.chart.as_deref();
            self.run
                .set_route(program, &self.config, &self.limits, chart, &percept);
        }
        if !self.run.phase.is_active() {
            return self.stand(input);
        }
        if let Some(target) = self.poses.target(&self.run) {
            let target = *target;
            return self.travel(input, &percept, &target);
        }
        if let Some(chart) = &mut self.memory.chart {
            self.run.record_surface(program, chart, &percept);
        }
        if let Some(coverage) = &mut self.memory.coverage {
            self.run
                .record_dose(program, coverage, &percept, input.dt_s);
        }
        let speed_factor = speed_target / self.speed_m_per_s * input.speed_scaling.clamp(0.0, 1.0);
        let sensing_s = input.wrench_delay_s + input.wrench_age_s.clamp(0.0, input.dt_s);
        let measured_s = self
            .loop_delay
            .measured_s(&self.delay)
            .map(|(mean, _)| mean);
        let delay_s = measured_s.unwrap_or(self.config.force.loop_delay_s);
        let arm_delay_s = (delay_s - sensing_s).max(0.0);
        let learning = self.memory.learner.as_deref_mut().map(|learner| Learning {
            learner,
            lead_s: arm_delay_s,
        });
        let lead_s = if self.config.path.delay_compensated {
            arm_delay_s
        } else {
            0.0
        };
        let turned = self
            .run
            .surface
            .rotation_within(&self.config.normal, lead_s);
        let wanted = wanted_twist(
            &mut self.run,
            program,
            &self.config,
            &self.limits,
            &placed,
            &percept,
            reference_n,
            speed_factor,
            &turned,
            learning,
        );
        // The sensor is tared with the arm at rest; all other phases are relative to the floor.
        let wanted = if self.run.phase == Phase::Tare {
            wanted
        } else {
            self.moving_base.against_base(&input.base_from_tool, wanted)
        };
        let brakes = self.run.gives_way || self.run.brakes || self.run.yielding.is_some();
        let twist = if brakes {
            self.limiter.brake(&self.limits, wanted, input.dt_s)
        } else {
            self.limiter.step(&self.limits, wanted, input.dt_s)
        };
        if let Some(learner) = &mut self.memory.learner {
            learner.commanded(&twist.linear, input.dt_s);
        }
        let normal = turned * self.run.surface.normal;
        let (qd, manipulability) = self.joints.step(
            &self.arm,
            &self.flange_from_tool,
            &self.limits,
            &input.q,
            lead_s,
            &twist,
            self.run.phase.is_pressing().then_some(&normal),
            input.dt_s,
        );
        let moves_freely = matches!(
            self.run.phase,
            Phase::Tare
                | Phase::Clear
                | Phase::Approach
                | Phase::Seek
                | Phase::Lift
                | Phase::Retract
        );
        self.loop_delay.step(
            &mut self.delay,
            &DelaySample {
                q: input.q,
                commanded: qd,
                sensing_s,
                free: moves_freely && input.speed_scaling > UNSCALED,
                dt_s: input.dt_s,
            },
        );
        if self.moving_base.moves() {
            let jacobian = self.arm.jacobian_at(&input.q, &self.flange_from_tool);
            let made = Twist::from_vector(&(jacobian * qd));
            self.moving_base.follow(&twist, &made, input.dt_s);
        }
        let run = &self.run;
        ControlOutput {
            kind: CommandKind::JointVelocity,
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            twist_commanded: twist,
            manipulability,
            alignment_error_rad: alignment_error(&percept.z_tool, &run.surface.normal),
            path_error_m: run.tracking.error_m(&percept.position, &run.surface.normal),
            force_n: percept.force_n,
            wrench: percept.wrench.map(|_| input.wrench),
            ..self.report(input)
        }
    }

    /// Moves the arm in joint space.
    fn travel(
        &mut self,
        input: &ControlInput<N>,
        percept: &Percept,
        target: &Joints<N>,
    ) -> ControlOutput<N> {
        self.limiter.reset();
        self.delay.interrupt();
        let jacobian = self.arm.jacobian_at(&input.q, &self.flange_from_tool);
        let spec = self.program.as_ref().and_then(|p| self.run.pose(&p.task));
        let limits = spec.map(|spec| JointWay::limits(spec, &self.arm, &self.limits));
        let goes = !self.run.paused && percept.wrench.is_some();
        let qd = limits.map_or_else(Joints::<N>::zeros, |limits| {
            let target = goes.then_some(target);
            joint_move::step(
                &limits,
                self.joints.last(),
                &input.q,
                target,
                &jacobian,
                input.dt_s,
            )
        });
        self.joints.follow(&qd);
        ControlOutput {
            kind: CommandKind::JointVelocity,
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            twist_commanded: Twist::from_vector(&(jacobian * qd)),
            manipulability: manipulability(&jacobian),
            force_n: percept.force_n,
            wrench: percept.wrench.map(|_| input.wrench),
            ..self.report(input)
        }
    }

    /// Pressing force asked for at this place of the path, N. A stroke's own force is scaled as the
    /// live parameter scales the task's.
    fn reference_n(&self, program: &Program) -> f64 {
        let target_n = self.targets[Parameter::ForceReference as usize];
        match program.path.force_n(self.run.tracking.clock_s()) {
            Some(force_n) => force_n * target_n / program.task.force.reference_n,
            None => target_n,
        }
    }

    /// No task moves the arm: any remaining motion slows down, then no motion is commanded.
    fn stand(&mut self, input: &ControlInput<N>) -> ControlOutput<N> {
        self.limiter.reset();
        self.delay.interrupt();
        let dt = if input.dt_s.is_finite() {
            input.dt_s.clamp(0.0, 0.02)
        } else {
            0.0
        };
        let (qd, stands) = self.joints.slow_down(&self.limits, dt);
        ControlOutput {
            kind: if stands || !input.arm_ready {
                CommandKind::Hold
            } else {
                CommandKind::JointVelocity
            },
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            ..self.report(input)
        }
    }

    /// Outputs that are reported in every phase.
    fn report(&self, input: &ControlInput<N>) -> ControlOutput<N> {
        let run = &self.run;
        let active = run.phase.is_active();
        let estimate_age = input.estimates[run.choice.index].map(|e| e.age_s);
        let hold = ControlOutput {
            clearance: run.clearance,
            ..ControlOutput::hold(input)
        };
        let Some(program) = &self.program else {
            return hold;
        };
        ControlOutput {
            phase: run.phase,
            activation: self.activation,
            estimator: run.choice.index,
            estimator_cause: run.choice.cause,
            estimator_switches: run.choice.switches,
            normal: if active {
                self.moving_base.direction(&run.surface.normal)
            } else {
                hold.normal
            },
            force_reference_n: if run.phase.is_pressing() {
                self.reference_n(program)
            } else {
                0.0
            },
            path_reference: if active {
                self.moving_base.point(&run.tracking.reference)
            } else {
                hold.path_reference
            },
            path_progress: {
                let progress = run.tracking.progress(&program.path);
                (self.memory.coverage.as_ref()).map_or(progress, |c| c.progress(progress))
            },
            estimate_age_s: estimate_age.unwrap_or(-1.0),
            contact_lost_count: run.lost_count,
            in_contact: active && run.in_contact,
            tare_requested: run.phase == Phase::Tare,
            stiffness_n_per_m: run.force.stiffness_n_per_m(),
            damping_n_s_per_m: run.force.damping_n_s_per_m(),
            force_tank_j: run.force.tank_j(),
            fault: run.fault,
            zero_withdrawn: run.zero_withdrawn,
            ..hold
        }
    }
}

fn is_sane<const N: usize>(input: &ControlInput<N>) -> bool {
    is_time(input.time_s, input.dt_s)
        && input.speed_scaling.is_finite()
        && is_arm_state(&input.q, &input.qd)
        && is_place(&input.base_from_tool)
        && is_velocity(&input.twist)
        && input
            .base
            .is_none_or(|base| is_place(&base.world_from_base) && is_velocity(&base.twist))
}

//! From what the law gives to what travels on the bus. No allocation.

use nalgebra::{Vector3, Vector6};
use tangent_control::{ControlInput, ControlOutput, Controller, EstimatorName, Phase};
use tangent_mechanics::{Tool, Wrench};
use tangent_schemas::convert::{cut, cut_format, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState};
use tangent_schemas::{Name, Text};

use crate::inputs::age_told;

/// The command that answers `arm`.
pub fn command(arm: &ArmState, output: &ControlOutput, source: Name, stamp_ns: i64) -> ArmCommand {
    ArmCommand {
        header: Header::new(stamp_ns, "base"),
        cycle: arm.cycle,
        kind: output.kind as u8,
        values: joint_array(&output.qd),
        acceleration: output.acceleration,
        source,
        activation: output.activation,
    }
}

/// What is published beside it. `arm_state_age_s` and `step_s` are the cycle's own.
pub fn state(
    arm: &ArmState,
    input: &ControlInput,
    output: &ControlOutput,
    controller: &Controller,
    arm_state_age_s: f64,
    step_s: f64,
) -> ControlState {
    let point = |v: &Vector3<f64>| v.into();
    ControlState {
        header: Header::new(arm.header.stamp.to_ns(), "base"),
        cycle: arm.cycle,
        phase: output.phase as u8,
        phase_text: cut(output.phase.name()),
        task: controller
            .task()
            .map_or_else(Name::new, |task| cut(&task.name)),
        activation: output.activation,
        estimator: controller
            .estimators()
            .get(output.estimator)
            .copied()
            .unwrap_or_default(),
        estimator_cause: cause(output),
        estimator_switches: output.estimator_switches,
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n.unwrap_or(f64::NAN),
        wrench: (&output.wrench.unwrap_or(no_wrench())).into(),
        path_reference: point(&output.path_reference),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age_told(Some(output.wrench_age_s)),
        estimate_age_s: age_told(Some(output.estimate_age_s)),
        arm_state_age_s,
        base_age_s: age_told(Some(output.base_age_s)),
        motion_tank_j: 0.0,
        force_tank_j: output.force_tank_j.unwrap_or_default(),
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        step_s,
        fault: fault(output),
        paused: controller.is_paused(),
        wrench_validity: input.wrench_validity as u8,
        contact_possible: !output.clearance.is_free(),
        zero_age_s: input.bias_age_s.unwrap_or(-1.0),
        zero_bound_n: input.zero_bound_n.unwrap_or(-1.0),
        ..ControlState::default()
    }
}

/// Says how old the newest of every estimator that is read was in this cycle.
pub fn tell_ages(state: &mut ControlState, ages: impl Iterator<Item = (EstimatorName, f64)>) {
    for (name, age_s) in ages {
        // As many as are read fit.
        if state.estimators.try_push(name).is_err()
            || state.estimate_ages_s.try_push(age_s).is_err()
        {
            return;
        }
    }
}

/// No wrench is no number: who overlooks its validity finds no zero there.
pub fn no_wrench() -> Wrench<Tool> {
    Wrench::from_vector(&Vector6::repeat(f64::NAN))
}

/// Why the estimator in use is the one in use.
pub fn cause(output: &ControlOutput) -> Text {
    let (what, why) = output.estimator_cause.text();
    cut_format(format_args!("{what}{why}"))
}

/// Why the task ended or is ending early; empty when it did not.
pub fn fault(output: &ControlOutput) -> Text {
    match (output.phase, output.fault) {
        (Phase::Idle, _) | (_, None) => Text::new(),
        (_, Some(fault)) => cut(fault.text()),
    }
}

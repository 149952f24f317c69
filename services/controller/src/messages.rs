//! From what the law gives to what travels on the bus. No allocation.

use nalgebra::Vector3;
use tangent_control::{ControlOutput, Controller, Phase};
use tangent_schemas::convert::{cut, cut_format, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{ArmCommand, ArmState, ControlState};
use tangent_schemas::{Name, Text};

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
    output: &ControlOutput,
    controller: &Controller,
    arm_state_age_s: f64,
    step_s: f64,
) -> ControlState {
    let finite = |x: f64| if x.is_finite() { x } else { -1.0 };
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
        force_n: output.force_n,
        wrench: (&output.wrench).into(),
        path_reference: point(&output.path_reference),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: finite(output.wrench_age_s),
        estimate_age_s: finite(output.estimate_age_s),
        arm_state_age_s,
        base_age_s: finite(output.base_age_s),
        motion_tank_j: 0.0,
        force_tank_j: output.force_tank_j.unwrap_or_default(),
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        step_s,
        fault: fault(output),
    }
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

//! From what the law gives to what travels on the bus. No allocation.

use nalgebra::{Vector3, Vector6};
use tangent_control::{ControlInput, ControlOutput, Controller, EstimatorName};
use tangent_mechanics::{Tool, Wrench};
use tangent_schemas::convert::{cut, cut_format};
use tangent_schemas::tangent::ControlState;
use tangent_schemas::{Name, Text};

use crate::inputs::age_told;

/// The state of the law for `control/state`; the loop adds what is the same for every law.
pub fn state(
    input: &ControlInput,
    output: &ControlOutput,
    controller: &Controller,
) -> ControlState {
    let point = |v: &Vector3<f64>| v.into();
    ControlState {
        task: controller
            .task()
            .map_or_else(Name::new, |task| cut(&task.name)),
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
        base_age_s: age_told(Some(output.base_age_s)),
        motion_tank_j: 0.0,
        force_tank_j: output.force_tank_j.unwrap_or_default(),
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        paused: controller.is_paused(),
        wrench_validity: input.wrench_validity as u8,
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

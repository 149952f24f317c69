//! Converts the law's outputs to bus messages. No allocation.

use nalgebra::Vector6;
use tangent_control::{
    CoverageResult, EstimatorName, Law, LawInput, LawOutput, Shaping, SwitchCause,
};
use tangent_mechanics::{Tool, Wrench};
use tangent_schemas::convert::{cut, cut_format};
use tangent_schemas::tangent::{ControlState, CoverageState, ShapingState};
use tangent_schemas::{Name, Text};

use crate::inputs::age_told;

/// The state of the law for `control/state`. The loop adds header, times, activation and fault.
pub fn state<L: Law<N>, const N: usize>(
    input: &LawInput<N>,
    output: &LawOutput<N>,
    law: &L,
) -> ControlState {
    let (estimator, estimator_switches, estimator_cause) = match &output.estimator {
        Some(used) => (used.name, used.switches, cause(used.cause)),
        None => Default::default(),
    };
    ControlState {
        task: law.task().map_or_else(Name::new, |task| cut(&task.name)),
        phase: output.phase as u8,
        phase_text: cut(output.phase.name()),
        estimator,
        estimator_switches,
        estimator_cause,
        normal: (&output.normal).into(),
        force_reference_n: output.force_reference_n,
        force_n: output.force_n.unwrap_or(f64::NAN),
        wrench: (&output.wrench.unwrap_or(no_wrench())).into(),
        path_reference: (&output.path_reference).into(),
        path_error_m: output.path_error_m,
        path_progress: output.path_progress,
        alignment_error_rad: output.alignment_error_rad,
        wrench_age_s: age_told(Some(output.wrench_age_s)),
        estimate_age_s: age_told(output.estimate_age_s),
        base_age_s: age_told(input.base.map(|base| base.age_s)),
        motion_tank_j: output.motion_tank_j,
        force_tank_j: output.force_tank_j,
        manipulability: output.manipulability,
        contact_lost_count: output.contact_lost_count,
        contact_possible: !output.clearance.is_free(),
        paused: law.is_paused(),
        wrench_validity: input.wrench_validity as u8,
        zero_age_s: output.zero_age_s.unwrap_or(-1.0),
        zero_bound_n: output.zero_bound_n.unwrap_or(-1.0),
        ..ControlState::default()
    }
}

/// The shaping of the law for `control/shaping`, without header and cycle.
pub fn shaping(shaping: &Shaping) -> ShapingState {
    ShapingState {
        monitor: shaping.monitor,
        monitor_margin: shaping.monitor_margin,
        rho_align: shaping.rho_align,
        rho_force: shaping.rho_force,
        ..ShapingState::default()
    }
}

/// What a task has covered for `control/coverage`, without header, cycle, task and activation.
pub fn coverage(result: &CoverageResult) -> CoverageState {
    CoverageState {
        outcome: result.outcome as u8,
        outcome_text: cut(result.outcome.text()),
        share_by_round: result.share_by_round.clone(),
        share: result.share,
        share_min: result.share_min,
        area_cm2: result.area_cm2,
        under_cm2: result.under_cm2,
        over_cm2: result.over_cm2,
        holes: result.holes,
        largest_hole_cm2: result.largest_hole_cm2,
        largest_hole_m: result.largest_hole_m,
        dose_n_s_per_cm2: result.dose_n_s_per_cm2,
        ..CoverageState::default()
    }
}

/// Adds the age of the newest estimate of every estimator that is read, s.
pub fn tell_ages(state: &mut ControlState, ages: impl Iterator<Item = (EstimatorName, f64)>) {
    for (name, age_s) in ages {
        // There is room for all estimators that are read.
        if state.estimators.try_push(name).is_err()
            || state.estimate_ages_s.try_push(age_s).is_err()
        {
            return;
        }
    }
}

/// A wrench of NaN, so that a reader that ignores its validity does not read zero.
fn no_wrench() -> Wrench<Tool> {
    Wrench::from_vector(&Vector6::repeat(f64::NAN))
}

/// Why the estimator in use was chosen.
fn cause(cause: SwitchCause) -> Text {
    let (what, why) = cause.text();
    cut_format(format_args!("{what}{why}"))
}

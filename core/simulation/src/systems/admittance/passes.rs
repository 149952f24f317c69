//! Repeated passes over the same part, each with what the passes before learnt: `tangent evaluate
//! --passes N`.

use serde::Serialize;
use tangent_control::{EndedPass, LearningSpec, Memory, Phase};

use super::closed_loop::{AdmittanceLoop, run_admittance};
use super::scenario::AdmittanceScenario;
use crate::evaluation::Evaluation;
use crate::metrics::{CycleSample, SETTLING_LEFT_OUT_S};
use crate::scenario_file::ScenarioError;

/// One pass.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassEvaluation {
    /// Number of the pass, from 1.
    pub pass: u32,
    /// RMS deviation of the measured force from its reference, in the same cycles as the true one
    /// in `force.rmse_n`, N: what a law can know of the force.
    pub force_measured_rmse_n: Option<f64>,
    /// Time in the phase `slide`, s.
    pub path_time_s: f64,
    /// Largest weight of what the passes before learnt, 0 to 1.
    pub memory_weight: f64,
    /// The pass's own figures.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// Runs a scenario `passes` times and hands the memory on. Pass i has the seed of the scenario plus
/// i - 1. A task without `[learning]` learns within the default bounds.
///
/// # Errors
/// The scenario cannot be built.
pub fn evaluate_admittance_passes(
    scenario: &AdmittanceScenario,
    passes: u32,
) -> Result<Vec<PassEvaluation>, ScenarioError> {
    let mut memory = None;
    let mut list = Vec::new();
    for pass in 1..=passes {
        let (evaluation, next) = evaluate_admittance_pass(scenario, pass, memory)?;
        list.push(evaluation);
        memory = next;
    }
    Ok(list)
}

/// Runs pass number `pass` with the `memory` of the passes before. Returns the memory for the next
/// one.
///
/// # Errors
/// The scenario cannot be built, or the memory is of another path.
pub fn evaluate_admittance_pass(
    scenario: &AdmittanceScenario,
    pass: u32,
    memory: Option<Memory>,
) -> Result<(PassEvaluation, Option<Memory>), ScenarioError> {
    let mut scenario = scenario.clone();
    scenario.seed = scenario
        .seed
        .saturating_add(u64::from(pass.saturating_sub(1)));
    (scenario.task.learning).get_or_insert_with(|| LearningSpec::of("evaluate"));
    let memory_weight = memory.as_ref().map_or(0.0, Memory::weight_max);
    let mut closed_loop = AdmittanceLoop::with_memory(&scenario, memory)?;
    let mut period_s = 0.0;
    let (evaluation, samples) =
        run_admittance(&mut closed_loop, &scenario, |c| period_s = c.input.dt_s);
    let slid = samples.iter().filter(|s| s.phase == Phase::Slide).count();
    let result = PassEvaluation {
        pass,
        force_measured_rmse_n: measured_rmse_n(&samples, evaluation.figures.contact.first_s),
        path_time_s: slid as f64 * period_s,
        memory_weight,
        evaluation,
    };
    let ended = closed_loop.controller().take_pass();
    Ok((result, ended.map(EndedPass::finish)))
}

fn measured_rmse_n(samples: &[CycleSample], first_s: Option<f64>) -> Option<f64> {
    let from_s = first_s? + SETTLING_LEFT_OUT_S;
    let counts = |s: &&CycleSample| {
        s.time_s >= from_s && matches!(s.phase, Phase::Slide | Phase::Hold) && s.in_contact
    };
    let (mut sum, mut n) = (0.0, 0.0);
    for sample in samples.iter().filter(counts) {
        sum += (sample.force_n? - sample.force_reference_n).powi(2);
        n += 1.0;
    }
    (n > 0.0).then(|| f64::sqrt(sum / n))
}

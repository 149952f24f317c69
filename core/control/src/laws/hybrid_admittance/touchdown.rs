//! Speed of a touchdown: the force that builds up before the loop can respond is speed times
//! stiffness times delay, whatever the gains.
//!
//! Called by the run for the approach and for seeking a lost surface.

use super::config::ControllerConfig;
use crate::task::program::Program;

/// Share of the loop's delay during which the force still builds up; the force law's recoil removes
/// the rest.
const BLIND_SHARE: f64 = 0.85;
/// Minimum touchdown speed, m/s.
const SPEED_MIN_M_PER_S: f64 = 0.0005;

/// Stiffest contact expected before one was measured, N/m.
pub(crate) fn stiffness_expected(program: &Program, config: &ControllerConfig) -> f64 {
    program
        .task
        .approach
        .stiffness_expected_n_per_m
        .unwrap_or(config.force.stiffness_expected_n_per_m)
}

/// Maximum speed towards a contact of `stiffness_n_per_m`, m/s, at which the first force stays
/// within the accepted overshoot of `reference_n`, N.
pub(crate) fn touchdown_speed(
    config: &ControllerConfig,
    reference_n: f64,
    stiffness_n_per_m: f64,
) -> f64 {
    let touch_n = (config.contact.touch_share * reference_n).max(config.contact.noise_n);
    let room_n = (1.0 + config.force.overshoot_accepted) * reference_n - touch_n;
    let blind_s = BLIND_SHARE * config.force.loop_delay_s;
    (room_n / (stiffness_n_per_m * blind_s)).max(SPEED_MIN_M_PER_S)
}

/// Speed of the approach, m/s: the task's, slowed for the stiffest contact expected.
pub(crate) fn approach_speed(program: &Program, config: &ControllerConfig) -> f64 {
    let task = &program.task;
    slowed(
        config,
        task.approach.speed_m_per_s,
        task.force.reference_n,
        stiffness_expected(program, config),
    )
}

/// Speed towards a lost surface, m/s: slowed for its measured stiffness.
pub(crate) fn seek_speed(
    config: &ControllerConfig,
    reference_n: f64,
    stiffness_n_per_m: f64,
) -> f64 {
    let wanted = config.contact.seek_speed_m_per_s;
    slowed(config, wanted, reference_n, stiffness_n_per_m)
}

fn slowed(
    config: &ControllerConfig,
    wanted_m_per_s: f64,
    reference_n: f64,
    stiffness_n_per_m: f64,
) -> f64 {
    if config.force.approach_slowed {
        wanted_m_per_s.min(touchdown_speed(config, reference_n, stiffness_n_per_m))
    } else {
        wanted_m_per_s
    }
}

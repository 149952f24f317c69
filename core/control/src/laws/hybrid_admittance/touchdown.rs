//! Speed of a touchdown: the force that builds up before the loop can respond is speed times
//! stiffness times delay, whatever the gains.
//!
//! Called by the run for the approach, for seeking a lost surface, and for motions off the surface
//! and above it, which should touch nothing.

use super::config::ControllerConfig;
use super::delay_in_use::delay_longest_s;
use crate::task::program::Program;

/// Share of the loop's delay during which the force still builds up; the force law's recoil removes
/// the rest.
const BLIND_SHARE: f64 = 0.85;
/// Highest first force on a contact that is stiffer than expected by this factor, N, or this share
/// of the reference, whichever is higher.
const STIFFER: f64 = 2.0;
const PEAK_N: f64 = 10.0;
const PEAK_SHARE: f64 = 2.0;
/// A touch is real from this many times the force that counts as one, or from this share of the
/// reference if that is less.
const REAL_FACTOR: f64 = 2.0;
const REAL_SHARE: f64 = 0.8;
/// Stiffest contact through a soft tip, N/m: a foam or a swab has a tenth to a third of it, and the
/// loop is stable up to three times as much.
const SOFT_TIP_N_PER_M: f64 = 10_000.0;
/// Minimum touchdown speed, and minimum speed of a motion that should touch nothing, m/s.
const SPEED_MIN_M_PER_S: f64 = 0.0005;
const FREE_SPEED_MIN_M_PER_S: f64 = 0.002;

/// Force from which the tool touches, N.
pub(crate) fn touch_force_n(config: &ControllerConfig, reference_n: f64) -> f64 {
    (config.contact.touch_share * reference_n).max(config.contact.noise_n)
}

/// Force that a touch must reach to be one, N: more than the drift of a zero and noise.
pub(crate) fn real_touch_n(config: &ControllerConfig, reference_n: f64) -> f64 {
    let touch_n = touch_force_n(config, reference_n);
    (REAL_FACTOR * touch_n)
        .min(REAL_SHARE * reference_n)
        .max(touch_n)
}

/// Stiffest contact expected before one was measured, N/m.
pub(crate) fn stiffness_expected(program: &Program, config: &ControllerConfig) -> f64 {
    program
        .task
        .approach
        .stiffness_expected_n_per_m
        .unwrap_or(config.force.stiffness_expected_n_per_m)
}

/// Stiffest contact of the tool's tip that is expected before one was measured, N/m: through a soft
/// tip, no contact is stiff. Only touchdowns follow from it: what the rest of the tool meets on its
/// way elsewhere need not be soft.
pub(crate) fn stiffness_of_touch(program: &Program, config: &ControllerConfig) -> f64 {
    let expected = stiffness_expected(program, config);
    if program.task.approach.soft_tip {
        expected.min(SOFT_TIP_N_PER_M)
    } else {
        expected
    }
}

/// Maximum speed towards a contact of `stiffness_n_per_m`, m/s, at which the first force stays
/// within the accepted overshoot of `reference_n`, N.
pub(crate) fn touchdown_speed(
    config: &ControllerConfig,
    reference_n: f64,
    stiffness_n_per_m: f64,
) -> f64 {
    let touch_n = touch_force_n(config, reference_n);
    let room_n = (1.0 + config.force.overshoot_accepted) * reference_n - touch_n;
    let longest_s = delay_longest_s(&config.force);
    // A contact stiffer than expected must not exceed the peak that any contact may have.
    let peak_room_n = PEAK_N.max(PEAK_SHARE * reference_n) - touch_n;
    let gentle = room_n / (stiffness_n_per_m * BLIND_SHARE * longest_s);
    let bounded = peak_room_n / (STIFFER * stiffness_n_per_m * longest_s);
    gentle.min(bounded).max(SPEED_MIN_M_PER_S)
}

/// Maximum speed of a motion that should touch nothing, m/s: something as stiff as
/// `stiffness_n_per_m` (N/m), met all the same and noticed from `noticed_n` (N) on, leaves the
/// force within `force_max_n` (N).
pub(crate) fn free_speed_max(
    config: &ControllerConfig,
    force_max_n: f64,
    noticed_n: f64,
    stiffness_n_per_m: f64,
) -> f64 {
    let room_n = (force_max_n - noticed_n).max(0.0);
    let bound = room_n / (stiffness_n_per_m * delay_longest_s(&config.force));
    bound.max(FREE_SPEED_MIN_M_PER_S)
}

/// Speed of the approach, m/s: the task's, slowed for the stiffest contact expected.
pub(crate) fn approach_speed(program: &Program, config: &ControllerConfig) -> f64 {
    let task = &program.task;
    slowed(
        config,
        task.approach.speed_m_per_s,
        task.force.reference_n,
        stiffness_of_touch(program, config),
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

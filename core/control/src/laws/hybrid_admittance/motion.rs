//! Desired motion of the tool in each phase.

use super::config::ControllerConfig;
use super::force_law::ForceSample;
use super::interface::ControlInput;
use super::pace::{
    ForceLoop, blind_factor, deviation_along_rad, deviation_max_rad, excess_factor,
    explore_speed_max, force_factor, obstacle_bound, speed_bound, turn_bound,
};
use super::percept::Percept;
use super::run::Run;
use super::side_load::{GiveWay, Sideways};
use super::touchdown::approach_speed;
use crate::contact::alignment::{alignment_rate, tangential};
use crate::estimator_choice::EstimateStatus;
use crate::learning::{Feedforward, Learner, PassSample};
use crate::limits::{Limits, clamp_norm};
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::program::Program;
use nalgebra::{Rotation3, Vector3};
use tangent_mechanics::{Aligned, Base, Tool, Twist};

/// Friction expected when the radius of the exploration is chosen.
const FRICTION_EXPECTED: f64 = 0.5;
/// Standard deviation assumed of a normal that its estimator withholds, rad.
const WITHHELD_SD_RAD: f64 = 0.1;
/// The exploration begins this long after a touch, s: the first force has settled.
const EXPLORE_AFTER_S: f64 = 0.3;
/// Longest time after a touch for which it waits for the stiffness, s: a contact that did not show
/// it by then is stiff.
const STIFFNESS_WITHIN_S: f64 = 0.6;
/// Commanded speed along the surface below which the tool stands, m/s. While it moves, its depth
/// changes with the surface's shape too, and shows no stiffness.
const STANDING_M_PER_S: f64 = 1e-3;
/// Force from which it begins, N.
const EXPLORE_FORCE_N: f64 = 1.5;
/// Time constant with which a changed gain takes effect, s.
const GAIN_RAMP_S: f64 = 0.3;

/// Desired velocity of the tool in the present phase, base axes: motion in the tangent plane, force
/// along the normal, and alignment with the normal. The surface will have turned by `turned` when
/// the arm makes it.
#[allow(clippy::too_many_arguments)] // One cycle's whole state; a struct for it would only be built and taken apart.
pub(super) fn wanted_twist<const N: usize>(
    run: &mut Run,
    program: &Program,
    config: &ControllerConfig,
    limits: &Limits,
    input: &ControlInput<N>,
    percept: &Percept,
    reference_n: f64,
    speed_factor: f64,
    turned: &Rotation3<f64>,
    learning: Option<Learning<'_>>,
) -> Twist<Aligned<Tool, Base>> {
    let normal = run.surface.normal;
    let still = Vector3::zeros();
    let learning = match (run.phase, learning) {
        (Phase::Seek, Some(learning)) => {
            learning.learner.rest(true);
            None
        }
        (_, learning) => learning,
    };
    match run.phase {
        // No motion while the task is paused or the motion of the base is unknown.
        Phase::Approach | Phase::Seek if percept.base.is_some() || run.paused => {
            run.tracking.freeze();
            Twist::zero()
        }
        Phase::Approach => Twist::new(run.approach * approach_speed(program, config), still),
        Phase::Seek => {
            run.tracking.freeze();
            let speed = run.seek_speed(config, reference_n, &percept.position);
            Twist::new(normal * -speed, still)
        }
        Phase::Lift => run.lift_twist(program, config, limits, percept, input),
        Phase::Retract => {
            let velocity = match &run.yielding {
                Some(yielding) => yielding.velocity,
                None => run.retract * run.retract_speed(program, config, limits, percept),
            };
            Twist::new(velocity, still)
        }
        // Without a wrench the tool stands: it could not detect an obstacle.
        Phase::Clear if percept.wrench.is_none() || run.paused => Twist::zero(),
        Phase::Clear => Twist::new(
            run.retract * run.clear_speed(program, config, limits),
            still,
        ),
        Phase::Hold if run.stands_without_wrench() => {
            run.tracking.freeze();
            run.force.rest();
            Twist::zero()
        }
        Phase::Contact | Phase::Slide | Phase::Hold => {
            let factor = if run.phase == Phase::Slide {
                speed_factor
            } else {
                0.0
            };
            let way = run.give_way(percept, input, reference_n, config);
            run.explore_again(program, config, percept, input);
            let along = along_path(
                run,
                program,
                config,
                limits,
                percept,
                reference_n,
                factor * way.speed_share,
                input.dt_s,
            ) + way.velocity;
            let learnt =
                learning.and_then(|learning| run.learnt(program, learning, input, percept, &along));
            run.surface.learnt = learnt.map(|learnt| (learnt.normal, learnt.turn_weight));
            let (speed, turn) = if let Some(wrench) = percept.wrench {
                run.force.step(
                    config,
                    limits,
                    reference_n * run.response.reference_share(),
                    &ForceSample {
                        wrench,
                        base_from_tool: input.base_from_tool,
                        acting_in_tool_m: run.acting.in_tool_m(),
                        normal,
                        along,
                        ahead_m_per_s: learnt.map(|learnt| learnt.speed_m_per_s),
                        wrench_delay_s: input.wrench_delay_s,
                        settling: run.phase == Phase::Contact && along.norm() < STANDING_M_PER_S,
                        dt_s: input.dt_s,
                    },
                )
            } else {
                run.force.rest();
                (0.0, still)
            };
            let bound = turn_bound(
                &config.pace,
                percept.force_n.unwrap_or(0.0),
                &force_loop(run, config, reference_n),
            );
            let align = clamp_norm(
                alignment_rate(config.alignment.gain_per_s, &percept.z_tool, &normal),
                config.alignment.turn_rate_max_rad_per_s.min(bound),
            );
            let ahead = if config.alignment.feed_forward && run.phase == Phase::Slide {
                let own = run.surface.turn_rate;
                learnt.map_or(own, |learnt| {
                    own.lerp(&learnt.turn_rate, learnt.turn_weight)
                })
            } else {
                still
            };
            let mut speed = speed;
            if let (true, Some(wrench)) = (config.alignment.about_contact, &percept.wrench) {
                let pose = &input.base_from_tool;
                run.acting.add(wrench, pose, input.dt_s);
                speed += run.acting.make_up_m_per_s(&(align + turn), pose, &normal);
            }
            Twist::new(turned * (along + normal * speed), align + ahead + turn)
        }
        Phase::Idle | Phase::Done | Phase::Fault | Phase::Tare | Phase::Travel => Twist::zero(),
    }
}

/// The learner of a task, and the delay of the arm.
pub(super) struct Learning<'a> {
    pub learner: &'a mut Learner,
    /// Delay from a command to the tool's motion, s.
    pub lead_s: f64,
}

impl Run {
    /// What earlier passes learnt of the surface ahead, with the tool sliding at `along` (base
    /// axes, m/s); `None` in other phases than `slide`, on a moving base, and where nothing is
    /// known. Records the pass.
    fn learnt<const N: usize>(
        &self,
        program: &Program,
        learning: Learning<'_>,
        input: &ControlInput<N>,
        percept: &Percept,
        along: &Vector3<f64>,
    ) -> Option<Feedforward> {
        let slides = self.phase == Phase::Slide && self.in_contact && input.base.is_none();
        let Some((stroke, distance_m)) = self.tracking.place(&program.path).filter(|_| slides)
        else {
            learning.learner.rest(false);
            return None;
        };
        let error_n = |force_n| force_n - self.force.reference_n();
        learning.learner.step(&PassSample {
            stroke,
            distance_m,
            position: percept.position,
            normal: self.surface.normal,
            estimated: self.surface.estimated,
            along: *along,
            error_n: percept.force_n.map(error_n),
            stiffness_n_per_m: self.force.stiffness_n_per_m(),
            force_age_s: input.wrench_delay_s + input.wrench_age_s.clamp(0.0, input.dt_s),
            lead_s: learning.lead_s,
            dt_s: input.dt_s,
        })
    }

    /// Offers a circle to a tool on its path where the normal has become uncertain. On a moving
    /// base it stays on its path: it slides over the surface anyway.
    fn explore_again<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        percept: &Percept,
        input: &ControlInput<N>,
    ) {
        if let (Phase::Slide, EstimateStatus::Usable(usable)) = (self.phase, &percept.estimate)
            && !self.paused
            && input.base.is_none()
            && program.explores_on_path()
        {
            let deviation = deviation_max_rad(&usable.estimate.covariance);
            self.exploration
                .offer_again(&config.pace, deviation, input.dt_s);
        }
    }

    /// What the tool does about a load along the surface.
    fn give_way<const N: usize>(
        &mut self,
        percept: &Percept,
        input: &ControlInput<N>,
        reference_n: f64,
        config: &ControllerConfig,
    ) -> GiveWay {
        let (Some(wrench), Some(pressing_n)) = (percept.wrench, percept.force_n) else {
            return GiveWay::NOTHING;
        };
        let normal = &self.surface.normal;
        let way = self.side.step(
            &config.pace,
            &Sideways {
                aside: tangential(&wrench.force, normal),
                pressing_n,
                reference_n,
                speed_m_per_s: tangential(&input.twist.linear, normal).norm(),
                damping_n_s_per_m: self.force.damping_n_s_per_m(),
                dt_s: input.dt_s,
            },
        );
        self.gives_way = way.gives_way;
        self.brakes = way.speed_share < 1.0;
        if self.brakes {
            self.tracking.brake(way.speed_share);
        }
        way
    }

    /// Whether the tool may explore while the force still builds up: it presses, the first force
    /// has settled, the stiffness, which is learnt only while the tool stands, is known, and so is
    /// that the surface goes on.
    fn may_explore(&self, config: &ControllerConfig, percept: &Percept) -> bool {
        let pressing_n = EXPLORE_FORCE_N.max(config.contact.noise_n);
        !self.paused
            && !self.response.doubts_surface()
            && self.in_phase_s > EXPLORE_AFTER_S
            && percept.force_n.is_some_and(|force_n| force_n > pressing_n)
            && self.force.reference_n() > pressing_n
            && (self.force.stiffness_is_settled() || self.in_phase_s > STIFFNESS_WITHIN_S)
    }
}

fn force_loop(run: &Run, config: &ControllerConfig, reference_n: f64) -> ForceLoop {
    ForceLoop {
        reference_n,
        stiffness_n_per_m: run.force.stiffness_n_per_m(),
        delay_s: config.force.loop_delay_s,
    }
}

/// Velocity along the surface: of the exploration, or of the path at the speed that the certainty
/// of the normal, and what may stand in the way, allow. `factor` is 1 at the path's own speed and 0
/// to stand. What slows the tool down leaves it at least `speed_min_m_per_s`: a slower one feels
/// nothing of the normal.
#[allow(clippy::too_many_arguments)] // One cycle's whole state, as in `wanted_twist`.
fn along_path(
    run: &mut Run,
    program: &Program,
    config: &ControllerConfig,
    limits: &Limits,
    percept: &Percept,
    reference_n: f64,
    factor: f64,
    dt_s: f64,
) -> Vector3<f64> {
    let normal = run.surface.normal;
    let position = &percept.position;
    let error_n = percept
        .force_n
        .map_or(0.0, |force_n| force_n - run.force.reference_n());
    let factor = if run.response.doubts_surface() {
        0.0
    } else {
        factor
    };
    let path_speed = program.task.path.speed_m_per_s();
    let of_path = |speed_m_per_s: f64| speed_m_per_s / path_speed.max(1e-6);
    // Of a motion of this own speed.
    let least_m_per_s = |own: f64| factor * own.min(config.pace.speed_min_m_per_s);
    let with_force = factor
        * force_factor(&config.pace, error_n, reference_n)
        * excess_factor(&config.pace, error_n, reference_n);
    let mut factor = with_force * run.losses.speed_share(position);
    let force = force_loop(run, config, reference_n);
    // It is not slower where contact was lost: the normal is wrong there, and a circle finds it.
    let explore_factor = match run.phase {
        Phase::Contact if run.may_explore(config, percept) => 1.0,
        Phase::Slide => with_force,
        _ => 0.0,
    };
    if let (Phase::Contact | Phase::Slide, EstimateStatus::Usable(input)) =
        (run.phase, &percept.estimate)
    {
        let covariance = &input.estimate.covariance;
        if run.exploration.is_open() && path_speed * explore_factor > 0.0 {
            let deviation = deviation_max_rad(covariance);
            // While the force still builds up, there is less of it to lose.
            let force = ForceLoop {
                reference_n: run.force.reference_n().min(reference_n),
                ..force
            };
            let bound = speed_bound(&config.pace, deviation, &force);
            let bend_m = FRICTION_EXPECTED * reference_n / force.stiffness_n_per_m;
            // Uphill on a slope that is not known yet the whole force rises, whatever the law
            // holds.
            let whole_n = percept.wrench.map_or(0.0, |wrench| wrench.force.norm());
            let reached = ForceLoop {
                reference_n: reference_n.max(whole_n),
                ..force
            };
            let bound = bound.min(obstacle_bound(&config.pace, limits.force_max_n, &reached));
            let speed = bound.min(explore_speed_max(reference_n)) * explore_factor;
            let speed = speed.max(least_m_per_s(path_speed));
            if let Some(step) = run
                .exploration
                .step(&config.pace, bend_m, deviation, speed, dt_s)
            {
                return run.tracking.step_aside(
                    &config.path,
                    &program.path,
                    step,
                    position,
                    &normal,
                    dt_s,
                );
            }
        }
        if let Some(along) = run.tracking.direction(&program.path, &normal) {
            let deviation = deviation_along_rad(covariance, &along);
            let bound = speed_bound(&config.pace, deviation, &force);
            factor = factor.min(of_path(bound));
        }
    } else if run.estimated {
        // The last normal becomes wrong with every millimetre. A tool that it leads off the surface
        // waits until it presses again, so that the estimator feels the surface.
        let bound = speed_bound(&config.pace, WITHHELD_SD_RAD, &force);
        factor = factor.min(of_path(bound)) * blind_factor(&config.pace, error_n, reference_n);
    }
    let bound = obstacle_bound(&config.pace, limits.force_max_n, &force);
    factor = factor.min(of_path(bound));
    if factor > 0.0 {
        // Near its turns the path is slow by itself.
        let here = run.tracking.speed_m_per_s(&config.path, &program.path);
        let here = here.max(1e-6);
        factor = factor.max(least_m_per_s(here) / here);
    }
    run.tracking
        .step(&config.path, &program.path, factor, position, &normal, dt_s)
}

/// Moves the gains towards their targets over `GAIN_RAMP_S`; force and speed have ramps of their
/// own.
pub(super) fn ramp_gains(config: &mut ControllerConfig, targets: &[f64; 4], dt_s: f64) {
    let share = (dt_s / GAIN_RAMP_S).min(1.0);
    let gain = &mut config.alignment.gain_per_s;
    *gain += (targets[Parameter::AlignmentGain as usize] - *gain) * share;
    let damping = &mut config.force.damping_n_s_per_m;
    *damping += (targets[Parameter::Damping as usize] - *damping) * share;
    config.force.damping_max_n_s_per_m = config.force.damping_max_n_s_per_m.max(*damping);
}

//! Travels from one stroke to the next above the surface, or past something in the way: off along
//! the normal, over to where the path goes on, and back by phase `seek`.
//!
//! The route bends away from the surface as far as the normals at its ends, and the expected
//! surface of the task, ask for. A touch on the way leads further off. Called by the phase machine
//! and the motion of phase `lift`.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Base, Tool, Twist, Wrench};
use tangent_sensing::Validity;

use super::config::ControllerConfig;
use super::interface::ControlInput;
use super::landing::Expected;
use super::percept::Percept;
use super::route::{Lifting, Route, Stage};
use super::run::Run;
use super::surface::Surface;
use super::surface_chart::{Felt, SurfaceChart};
use super::touchdown::real_touch_n;
use crate::contact::alignment::{alignment_rate, angle_between, tangential};
use crate::leaving::leave_watch::Leaving;
use crate::limits::faults::Fault;
use crate::limits::{Limits, clamp_norm};
use crate::phase_machine::Phase;
use crate::task::profile::Profile;
use crate::task::program::Program;

/// A felt place further than this from the landing does not help, m.
const FELT_FAR_M: f64 = 0.03;
/// Gain of the position feedback above the surface, 1/s, and its highest speed, m/s.
const GAIN_PER_S: f64 = 4.0;
const FEEDBACK_MAX_M_PER_S: f64 = 0.05;
/// The tool has arrived within this distance, m, and angle, rad.
const ARRIVED_M: f64 = 0.001;
const ARRIVED_RAD: f64 = 0.03;
/// A tool that stays further away than this does not land, m.
const ASTRAY_M: f64 = 0.004;
/// Longest wait at the end of a route, s.
const SETTLE_MAX_S: f64 = 3.0;
/// Places of a route that are compared with the expected surface, and its highest middle above the
/// chord, m.
const ROUTE_STEPS: u32 = 16;
const BULGE_MAX_M: f64 = 0.15;
/// Force along the surface that still holds a tool at a ledge, N, and the share of its speed with
/// which the tool rises meanwhile.
const HELD_N: f64 = 1.0;
const RISE_WHILE_HELD: f64 = 0.2;
/// Way back after which a ledge would have let go, m: the force is another's, or none.
const BACK_MAX_M: f64 = 0.02;
/// Touches on one way that lead further off; the next one ends the task.
const CLIMBS_MAX: u32 = 3;

/// The end of a route: where the tool lands, the place above it, m, and the normal there.
struct Landing {
    lands: Vector3<f64>,
    to: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Run {
    /// Leaves the surface for the next stroke.
    pub(crate) fn take_off(&mut self, percept: &Percept) {
        self.rise(percept, Lifting::idle());
    }

    /// Leaves the surface for the path behind something in the way.
    pub(crate) fn step_over(&mut self, program: &Program, over_m: f64, percept: &Percept) {
        let past_s = self.tracking.past_s(&program.path, over_m);
        self.ledge.passed(past_s);
        let normal = &self.surface.normal;
        let aside = |wrench: Wrench<_>| tangential(&wrench.force, normal).norm();
        let past = Lifting {
            past_s: Some(past_s),
            held_n: percept.wrench.map_or(0.0, aside),
            ..Lifting::idle()
        };
        self.rise(percept, past);
    }

    /// Leaves the surface for a place beside the one where contact was lost, or back.
    pub(super) fn hop(&mut self, percept: &Percept) {
        self.rise(percept, Lifting::idle());
    }

    fn rise(&mut self, percept: &Percept, lift: Lifting) {
        self.lift = Lifting {
            from: percept.position,
            ..lift
        };
        self.tracking.freeze();
        self.force.rest();
        self.enter(Phase::Lift, percept);
    }

    /// Phase `lift`.
    pub(super) fn decide_lift(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        reference_n: f64,
        percept: &Percept,
        dt_s: f64,
    ) {
        let Some((wrench, force_n)) = percept.wrench.zip(percept.force_n).filter(|_| !self.paused)
        else {
            return;
        };
        // Noise and a zero that has drifted touch nothing.
        let touches = self.in_contact && force_n >= real_touch_n(config, reference_n);
        match self.lift.stage {
            Stage::Off => {
                let leave = &config.leave;
                let normal = self.surface.normal;
                let back_m = tangential(&(percept.position - self.lift.from), &normal).norm();
                if back_m > BACK_MAX_M && self.is_held(&wrench.force) {
                    let aside = Fault::Wrench(Validity::Misdirected);
                    return self.leave(percept, Some(aside));
                }
                let way_m = (percept.position - self.lift.from).dot(&normal);
                let release_max_n = (2.0 * program.force_max_n()).max(10.0) + self.lift.held_n;
                let force = &wrench.force;
                let left = self
                    .leave
                    .clear(leave, &normal, way_m, force, release_max_n, dt_s);
                let patience_s = self.clear_patience_s(program, config, limits);
                if left == Leaving::Opposed
                    || way_m > leave.distance_max_m
                    || self.time_in_phase_s() > patience_s
                {
                    self.leave(percept, Some(Fault::NotClear));
                } else if !touches && self.is_above(program, &percept.position) {
                    self.lift.stage = Stage::Above;
                }
            }
            Stage::Above => {}
            Stage::Over(_) if touches => {
                if self.lift.climbs >= CLIMBS_MAX {
                    return self.leave(percept, Some(Fault::PathBlocked));
                }
                let higher = Lifting {
                    stage: Stage::Off,
                    climbs: self.lift.climbs + 1,
                    ..self.lift
                };
                self.rise(percept, higher);
            }
            Stage::Over(route) => {
                let late_s = route.time_s - route.profile.duration_s();
                let away_m = (percept.position - route.to).norm();
                let turned = angle_between(&-percept.z_tool, &route.to_normal) < ARRIVED_RAD;
                let late = late_s > SETTLE_MAX_S;
                if late && away_m > ASTRAY_M {
                    // A tool that landed elsewhere would slide where it must not.
                    self.leave(percept, Some(Fault::PathBlocked));
                } else if late || late_s >= 0.0 && turned && away_m < ARRIVED_M {
                    if let Some(hop) = self.hops.landing() {
                        let offset = self.tracking.drawn(hop.offset, &route.to_normal);
                        self.tracking.displace(route.lands, hop.aside + offset);
                    } else {
                        self.surface = Surface::new(route.to_normal);
                        let past_s = self.lift.past_s;
                        self.tracking.land(&program.path, past_s, route.lands);
                        self.seeks_lost = false;
                    }
                    self.enter(Phase::Seek, percept);
                }
            }
        }
    }

    /// Whether a `force` (base axes, N) holds the tool at a ledge over which it lifts.
    fn is_held(&self, force: &Vector3<f64>) -> bool {
        self.lift.past_s.is_some() && tangential(force, &self.surface.normal).norm() > HELD_N
    }

    /// Whether the tool is above the surface and waits for its route.
    pub(super) fn awaits_route(&self) -> bool {
        self.phase == Phase::Lift && self.lift.stage == Stage::Above && !self.paused
    }

    /// Finds the way to where the path goes on: from what was felt near there, or else on the plane
    /// through the tool.
    pub(super) fn set_route(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        chart: Option<&SurfaceChart>,
        percept: &Percept,
    ) {
        let touch_n = real_touch_n(config, program.task.force.reference_n);
        let speed_max = self.free_speed_max(program, config, limits, touch_n);
        if let Some(landing) = self.hops.landing() {
            let normal = self.surface.normal;
            let in_plane = self.tracking.drawn(landing.offset, &normal);
            let lands = landing.place + self.tracking.on_surface(in_plane, &normal);
            let to = lands + normal * self.height_of_hop_m(landing.lift_m);
            return self.go_over(
                program,
                config,
                percept,
                &Landing { lands, to, normal },
                (speed_max, 0.0),
            );
        }
        let Some(landing) = self.tracking.landing(&program.path, self.lift.past_s) else {
            return self.leave(percept, None);
        };
        let rise = program.path.rise();
        let (from, from_normal) = (percept.position, self.surface.normal);
        let felt = chart.and_then(|chart| chart.nearest(&landing, FELT_FAR_M));
        let (lands, to_normal) = match felt {
            Some(felt) => {
                let beside = landing - felt.in_plane;
                let beside = self.tracking.on_surface(beside, &felt.normal);
                (felt.position + beside, felt.normal)
            }
            None => {
                let here = self.tracking.in_plane(&program.path, &from, &from_normal);
                let way = self.tracking.on_surface(landing - here, &from_normal);
                let height = (from - self.lift.from).dot(&from_normal);
                (from - from_normal * height + way, from_normal)
            }
        };
        let knows_landing = felt.is_some();
        let expected = program.task.path.expected_surface().zip(chart);
        let expected = expected.map(|(surface, chart)| {
            let at = self.lift.from;
            (Expected::new(surface, chart, &self.tracking, &at), chart)
        });
        let (lands, to_normal) = match &expected {
            None => (lands, to_normal),
            Some((expected, chart)) => {
                let height_m = expected.height_near_m(&landing, chart, &self.tracking);
                let place = self.tracking.place_over(&landing, height_m);
                (place, expected.normal(&landing, &self.tracking))
            }
        };
        self.lift.knows_landing = knows_landing;
        let to = lands + to_normal * rise.lift_m;
        let bulge_m = expected.as_ref().map_or(0.0, |(expected, _)| {
            self.bulge_over_m(expected, &from, &to, rise.lift_m)
        });
        let at = Landing {
            lands,
            to,
            normal: to_normal,
        };
        self.go_over(program, config, percept, &at, (speed_max, bulge_m));
    }

    /// Sets the route to a landing, no faster than `speed_max` (m/s), and with its middle at least
    /// `bulge_m` above the straight line, m.
    fn go_over(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        percept: &Percept,
        landing: &Landing,
        (speed_max, bulge_m): (f64, f64),
    ) {
        let rise = program.path.rise();
        let (from, from_normal) = (percept.position, self.surface.normal);
        let &Landing {
            lands,
            to,
            normal: to_normal,
        } = landing;
        let way_m = (to - from).norm();
        let turn_rad = angle_between(&from_normal, &to_normal);
        // A circle through both ends rises by this much above their chord.
        let bends_out = (to - from).dot(&(to_normal - from_normal)) > 0.0;
        let arc_m = if bends_out {
            0.5 * way_m * (0.25 * turn_rad).tan()
        } else {
            0.0
        };
        let bounds = &config.path;
        let length_m = way_m.max(1e-4);
        let speed = (rise.speed_m_per_s.min(speed_max) / length_m)
            .min(config.alignment.turn_rate_max_rad_per_s / turn_rad.max(1e-6));
        // A hop rises higher at both ends.
        let climbed_m = if self.hops.is_under_way() {
            0.0
        } else {
            f64::from(self.lift.climbs) * rise.lift_m
        };
        self.lift.stage = Stage::Over(Route {
            from,
            to,
            from_normal,
            to_normal,
            bulge_m: arc_m.max(bulge_m) + climbed_m,
            lands,
            // Over a share of the route, 0 to 1.
            profile: Profile::new(
                1.0,
                speed,
                bounds.acceleration_m_per_s2 / length_m,
                bounds.jerk_m_per_s3 / length_m,
            ),
            time_s: 0.0,
        });
    }

    /// Height at which the tool moves across on a hop, m: more after a touch on the way.
    fn height_of_hop_m(&self, lift_m: f64) -> f64 {
        lift_m * f64::from(1 + self.lift.climbs)
    }

    /// Whether a tool that moves off the surface is high enough to move across.
    fn is_above(&self, program: &Program, position: &Vector3<f64>) -> bool {
        let normal = &self.surface.normal;
        match self.hops.landing() {
            Some(hop) => (position - hop.place).dot(normal) >= self.height_of_hop_m(hop.lift_m),
            None => (position - self.lift.from).dot(normal) >= program.path.rise().lift_m,
        }
    }

    /// Height of the middle of a route above its chord, m, at which it passes `lift_m` above the
    /// expected surface.
    fn bulge_over_m(
        &self,
        expected: &Expected<'_>,
        from: &Vector3<f64>,
        to: &Vector3<f64>,
        lift_m: f64,
    ) -> f64 {
        let needed = (1..ROUTE_STEPS).map(|step| {
            let share = f64::from(step) / f64::from(ROUTE_STEPS);
            let on_chord = from.lerp(to, share);
            let height_m = expected.height_m(&self.tracking.over(&on_chord));
            let above_m = self.tracking.height_m(&on_chord) - height_m;
            (lift_m - above_m) / (4.0 * share * (1.0 - share))
        });
        needed.fold(0.0, f64::max).min(BULGE_MAX_M)
    }

    /// Records what a sliding tool feels of the surface, for the way back to it.
    pub(super) fn record_surface(
        &self,
        program: &Program,
        chart: &mut SurfaceChart,
        percept: &Percept,
    ) {
        if self.phase == Phase::Slide && self.in_contact && self.estimated {
            let (position, normal) = (percept.position, self.surface.normal);
            chart.record(Felt {
                in_plane: self.tracking.in_plane(&program.path, &position, &normal),
                position,
                normal,
            });
        }
    }

    /// Motion of phase `lift`.
    pub(super) fn lift_twist<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        percept: &Percept,
        input: &ControlInput<N>,
    ) -> Twist<Aligned<Tool, Base>> {
        let Some(wrench) = &percept.wrench else {
            return Twist::zero();
        };
        if percept.base.is_some() || self.paused {
            return Twist::zero();
        }
        let turn = |normal: &Vector3<f64>| {
            clamp_norm(
                alignment_rate(config.alignment.gain_per_s, &percept.z_tool, normal),
                config.alignment.turn_rate_max_rad_per_s,
            )
        };
        let (dt_s, off_speed) = (input.dt_s, self.clear_speed(program, config, limits));
        match &mut self.lift.stage {
            Stage::Off => {
                let normal = self.surface.normal;
                // Against a ledge it would catch at its rim: first back, then up.
                let way = if self.is_held(&wrench.force) {
                    let aside = tangential(&wrench.force, &normal);
                    aside.normalize() + normal * RISE_WHILE_HELD
                } else {
                    normal
                };
                Twist::new(way * off_speed, Vector3::zeros())
            }
            Stage::Above => Twist::new(Vector3::zeros(), turn(&self.surface.normal)),
            Stage::Over(route) => {
                let (place, _) = route.at(route.time_s);
                // The robot scales the speed of its motions itself.
                route.time_s += dt_s * input.speed_scaling.clamp(0.0, 1.0);
                let (next, normal) = route.at(route.time_s);
                let back = clamp_norm(
                    (place - percept.position) * GAIN_PER_S,
                    FEEDBACK_MAX_M_PER_S,
                );
                self.surface = Surface::new(normal);
                Twist::new((next - place) / dt_s + back, turn(&normal))
            }
        }
    }
}

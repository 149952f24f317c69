//! Kalman filter under every estimator but the published ones: surface normal, shape operator,
//! friction and force bias, each with its covariance.
//!
//! While the tool slides with normal force `N`, the force on it is `f = N (n - mu t) + b` with `t`
//! the direction of sliding, and the contact's height over the surface, `h' = n · v`, is what the
//! compliance gives under the force. `N` is not estimated: only the components of the force
//! perpendicular to its expected direction are used.
//!
//! There are nineteen error states: the normal's two tangent components (rad), the shape operator's
//! `k11, k22, k12` (1/m), friction, the bias's three components in tool axes (N), the error of the
//! compensated payload weight (N), which appears when the tool turns away from the orientation in
//! which it was tared, the rotation of the sensor's true axes against those stated (rad), the
//! height of the contact over the undented surface (m), the compliance along the tool's axis and
//! across it (m/N), and the error of the tip's stated position, tool axes (m): while the tool turns
//! it looks like a motion over the surface.
//!
//! [`ContactFilter`] is plain configuration; all memory is in [`ContactFilterState`].

mod compliance;
mod learnt_noise;
mod measurements;
mod residual;
mod slide;
mod state;
mod tilt;
mod tilt_memory;
mod tip;
mod torque_mean;
mod unrest;

use nalgebra::{Matrix2, Vector2, Vector3};
use tangent_mechanics::{Direction, Point};
use tangent_sensing::Validity;

use self::slide::Slide;
use self::state::{BIAS, FRICTION, HEIGHT, HeightMemory, NORMAL, Row, SHAPE, TIP, WEIGHT};
pub(crate) use self::state::{ContactFilterState, ContactPhase};
use self::tilt_memory::TiltMemory;
use self::tip::POSITION_SD_M;
use self::torque_mean::TorqueMean;
use self::unrest::CurvatureNews;
use crate::EstimatorConfig;
use crate::motion::{Motion, free_space};
use crate::world_estimator::WorldEstimate;

/// Error of a zero that may look like a contact, in standard deviations.
const ZERO_SDS: f64 = 2.0;
/// Correlation time of force disturbances in free space (inertia, cables), s.
const FREE_CORRELATION_S: f64 = 0.5;
/// Standard deviation of force disturbances in free space (inertia, cables), N.
const FREE_FORCE_SD_N: f64 = 0.05;
/// Number of standard deviations beyond which an innovation gets less weight.
const HUBER_SD: f64 = 2.5;
/// Standard deviation of the lag between wrench and motion, s.
const LAG_SD_S: f64 = 0.008;
/// Angle over which the tool turns about one axis, rad.
const TURN_RAD: f64 = 0.1;
/// Share of the way from the force at which contact ends to the one at which it begins that a touch
/// near the last contact must reach: the surface is expected there.
const AGAIN_SHARE: f64 = 1.0 / 3.0;
/// Slopes of which a lost contact is a sign, along the motion and across it, rad.
const LOST_SLOPE_RAD: (f64, f64) = (0.12, 0.04);
/// Uncertainty of the direction of friction above which the force along the surface is not used.
const DIRECTION_SD_MAX_RAD: f64 = 0.5;
/// Distance along the surface from a lost contact to a touch, m, from which that touch shows the
/// slope: the heights of nearer places are alike.
const BESIDE_M: f64 = 0.002;
/// Way along the surface, m, after which a tool that creeps measures its height again: beyond the
/// ripple of an arm that stands. On a moving base that is the error of the odometry.
const CREPT_M: f64 = 3e-4;
/// Time after a contact during which the filtered wrench still contains part of it, s.
const SETTLING_S: f64 = 0.2;

/// Configuration of the filter. A tare resets the state, as [`ContactFilter::initial_state`] does.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactFilter {
    config: EstimatorConfig,
    /// Direction of gravity, world axes.
    gravity: Vector3<f64>,
}

impl ContactFilter {
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            config: *config,
            gravity: Vector3::from(config.sensing.gravity_direction_in_base).normalize(),
        }
    }

    /// State in free space, just after a tare.
    pub fn initial_state(&self) -> ContactFilterState {
        ContactFilterState::new(&self.config)
    }

    /// Updates the state with the motion and force of one cycle.
    pub fn update(&self, state: &mut ContactFilterState, motion: &Motion) {
        if motion.tared {
            *state = self.initial_state();
            state
                .surface
                .add_bias_drift(&self.config, motion.bias_age_s);
        }
        state.surface.add_bias_drift(&self.config, motion.dt_s);
        state.turn_payload(&motion.rotation.tr_mul(&self.gravity));
        state.surface.bound_bias(&self.config, motion.bias_age_s);
        // Along the tool's axis, so that a sideways bias does not count as pressing.
        let pressing_n = -state.force_in_tool(motion).z;
        let contact = &self.config.contact;
        let threshold = if state.phase != ContactPhase::Free {
            contact.force_off_n
        } else if self.is_near(state) {
            contact.force_off_n + AGAIN_SHARE * (contact.force_on_n - contact.force_off_n)
        } else {
            contact.force_on_n
        };
        // A bias that the filter believes in may hide a contact: what no zero can explain counts.
        let read_n = -motion.force_in_tool.z;
        let zero_sd_n = state.zero_sd_n(&self.config, motion);
        let mut pressing_n = pressing_n.max(read_n - zero_sd_n * ZERO_SDS);
        if pressing_n < threshold {
            // A reading that has not fallen shows no loss: the bias does not explain it.
            if !state.is_held(read_n) || read_n < threshold {
                self.in_free_space(state, motion);
                return;
            }
            state.surface.deny_bias(&self.config, zero_sd_n);
            pressing_n = read_n;
        }
        if state.phase == ContactPhase::Free {
            self.touch_down(state, motion, pressing_n);
        }
        state.touch.hold(read_n, motion.dt_s);
        let force = state.force(motion);
        state
            .torque
            .add(&motion.torque_in_tool, pressing_n, motion.dt_s);
        state.centre = self.centre_of_pressure(state, motion, pressing_n);
        state.centre.position += motion.rotation * state.surface.tip_m;
        self.travel(state, motion);
        state.force_n = state.surface.frame.normal.dot(&force);
        state.stiffen(&contact.tip, contact.force_off_n);

        let velocity = motion.velocity + motion.angular.cross(&state.centre.position);
        let normal = state.surface.frame.normal;
        let tangential = velocity - normal * normal.dot(&velocity);
        let speed = tangential.norm();
        state.slide.speed_m_per_s = speed;
        if speed > contact.sliding_speed_min_m_per_s {
            state.slide.go_on(&tangential, motion.dt_s);
            state.phase = ContactPhase::Sliding;
            if state.memory != HeightMemory::Followed {
                state.begin_heights(motion);
                state.memory = HeightMemory::Followed;
            }
            state.has_slid = true;
            let along = state.surface.frame.project(&tangential);
            state.surface.news = CurvatureNews::along(&along);
            self.measure_height(state, motion, speed * motion.dt_s);
            let force = state.force(motion);
            let step = tangential * motion.dt_s;
            let give = state.surface.give_m_per_n.y;
            let presliding_m = contact.presliding_distance_m;
            state.learn_compliance_across(motion, pressing_n);
            state
                .slide
                .follow_tip(&step, &force, give, &normal, presliding_m);
            if state.slide.tip_direction_sd_rad() < DIRECTION_SD_MAX_RAD {
                self.measure_sliding_force(state, motion);
            }
            let news = state.surface.news;
            state.unrest.learn(&news, speed * motion.dt_s);
        } else {
            state.slide.distance_m = 0.0;
            state.slide.rest = Some((motion.point_lagged, state.force(motion)));
            state.phase = ContactPhase::Pressing;
            state.touch.pressed_s += motion.dt_s;
            let has_settled = state.touch.pressed_s > SETTLING_S;
            if state.memory != HeightMemory::Followed {
                self.measure_pressing_force(state, motion);
                state.learn_compliance(motion, pressing_n);
                if has_settled {
                    state.begin_heights(motion);
                    state.memory = HeightMemory::Here;
                }
            } else if has_settled && std::mem::take(&mut state.touch.is_beside) {
                self.measure_height_of_touch(state, motion);
            } else if has_settled && !motion.base_moves {
                state.slide.crept_m += tangential * motion.dt_s;
                let distance_m = state.slide.crept_m.norm();
                if distance_m > CREPT_M {
                    state.slide.crept_m = Vector3::zeros();
                    self.measure_height(state, motion, distance_m);
                }
            }
        }
        self.measure_tilt(state, motion, pressing_n);
    }

    /// Update in free space, where the sensor reads only its bias and the payload's error.
    fn in_free_space(&self, state: &mut ContactFilterState, motion: &Motion) {
        if state.phase != ContactPhase::Free {
            state.phase = ContactPhase::Free;
            state.torque = TorqueMean::default();
            state.free_distance_m = 0.0;
            state.free_way_m = Vector3::zeros();
            state.free_time_s = 0.0;
            self.widen_after_loss(state);
        }
        if self.is_near(state) {
            self.travel(state, motion);
        }
        state.free_distance_m += motion.step.norm();
        state.free_way_m += motion.step;
        state.free_time_s += motion.dt_s;
        state.slide = Slide {
            turn_rate_rad_per_s: state.slide.turn_rate_rad_per_s,
            speed_m_per_s: state.slide.speed_m_per_s,
            ..Slide::default()
        };
        let settled = !state.has_touched || state.free_time_s > SETTLING_S;
        let s = &self.config.sensing;
        let bias_sd = s.force_bias_sd_n + s.force_bias_drift_n_per_sqrt_s;
        // Near the surface the tool may touch too weakly to be felt. Taken for a zero, that force
        // would hide the next contact.
        if !settled || bias_sd <= 0.0 || self.is_near(state) {
            return;
        }
        let variance = (FREE_FORCE_SD_N.powi(2) + s.force_noise_n.powi(2))
            * (FREE_CORRELATION_S / motion.dt_s).max(1.0);
        for axis in 0..3 {
            let mut row = Row::zeros();
            row[BIAS + axis] = 1.0;
            row[WEIGHT] = state.payload.leverage[axis];
            let innovation = state.force_in_tool(motion)[axis];
            self.correct(state, &row, innovation, variance);
        }
    }

    /// Whether the surface that was touched is still near.
    fn is_near(&self, state: &ContactFilterState) -> bool {
        state.memory != HeightMemory::None
            && state.free_distance_m <= self.config.contact.memory_distance_m
    }

    /// A contact lost while sliding says that the slope was not as expected. How large it is shows
    /// where the tool meets the surface again: by its height.
    fn widen_after_loss(&self, state: &mut ContactFilterState) {
        if !state.has_slid {
            return;
        }
        let along = state.surface.frame.project(&state.slide.direction);
        let across = Vector2::new(-along.y, along.x);
        let (on, beside) = LOST_SLOPE_RAD;
        let doubt =
            along * along.transpose() * on.powi(2) + across * across.transpose() * beside.powi(2);
        let mut normal = state
            .surface
            .covariance
            .fixed_view_mut::<2, 2>(NORMAL, NORMAL);
        normal += doubt;
    }

    fn touch_down(&self, state: &mut ContactFilterState, motion: &Motion, pressing_n: f64) {
        let is_near = self.is_near(state);
        state.begin_contact(motion, pressing_n);
        let normal = state.surface.frame.normal;
        let beside_m = (state.free_way_m - normal * normal.dot(&state.free_way_m)).norm();
        let is_beside = beside_m > BESIDE_M;
        if is_near && (is_beside || state.memory == HeightMemory::Followed) {
            state.touch.is_beside = is_beside;
            state.memory = HeightMemory::Followed;
            state.tilt.touch_again();
            return;
        }
        state.has_touched = true;
        state.has_slid = false;
        state.memory = HeightMemory::None;
        state.tilt = TiltMemory::default();
        state.surface.forget_normal(&self.config, motion);
    }

    /// Turns the normal with the surface under the tool, `dn = S dp`, and moves its height.
    fn travel(&self, state: &mut ContactFilterState, motion: &Motion) {
        let centre = state.centre.position;
        let turned_rad = motion.angular.norm() * motion.dt_s;
        let moved = motion.step + motion.angular.cross(&centre) * motion.dt_s;
        let d = state.surface.frame.project(&motion.step);
        let distance = d.norm();
        let mut row = Row::zeros();
        let tangent = state.surface.frame.project(&moved);
        row[NORMAL] = tangent.x;
        row[NORMAL + 1] = tangent.y;
        state.shape_row(&mut row, &moved);
        let turned = state.normal_at_centre().cross(&motion.angular) * motion.dt_s;
        row.fixed_rows_mut::<3>(TIP)
            .copy_from(&motion.rotation.tr_mul(&turned));
        state.surface.height_m += state.normal_at_centre().dot(&moved);
        // A contact that moves over the tip as the tool turns, beyond what the tip's shape says.
        let height = state.centre.sd_m.hypot(POSITION_SD_M).powi(2) * turned_rad * TURN_RAD;
        state.surface.propagate(&d, &row);
        let surface = &mut state.surface;
        let s = &self.config.surface;
        let unrest = state.unrest.value();
        let waviness = s.waviness_rad_per_sqrt_m.powi(2) * distance * unrest;
        let curvature = s.curvature_change_per_m_per_sqrt_m.powi(2) * distance * unrest;
        let friction = s.friction_change_per_sqrt_m.powi(2) * distance;
        for (i, q) in [
            (NORMAL, waviness),
            (NORMAL + 1, waviness),
            (SHAPE, curvature),
            (SHAPE + 1, curvature),
            (SHAPE + 2, 0.5 * curvature),
            (FRICTION, friction),
            (HEIGHT, height),
        ] {
            surface.covariance[(i, i)] += q;
        }
        surface.frame = surface.frame.turned(&(surface.shape * d));
    }

    /// Updates the state with one scalar measurement.
    fn correct(&self, state: &mut ContactFilterState, row: &Row, innovation: f64, variance: f64) {
        let friction_max = self.config.surface.friction_max;
        state
            .surface
            .correct(HUBER_SD, row, innovation, variance, friction_max);
    }

    /// Covariance of the normal in tangent axes, rad².
    pub fn normal_covariance(&self, state: &ContactFilterState) -> Matrix2<f64> {
        let surface = &state.surface;
        let filtered = surface.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        // The error of the centre of pressure does not average out, because a torque bias is
        // constant.
        let centre = surface.shape * surface.shape * state.centre.sd_m.powi(2);
        // The lag of the wrench is uncertain by some milliseconds. The turn in that time does not
        // average out either.
        let ahead = surface.frame.project(&state.slide.direction);
        let across = Vector2::new(-ahead.y, ahead.x);
        let turned = surface.shape * ahead * (state.slide.speed_m_per_s * LAG_SD_S);
        let leaked = across * (surface.friction * state.slide.turn_rate_rad_per_s * LAG_SD_S);
        // The pad measures a mean over its area, which is the normal at its middle only where the
        // curvature is constant.
        let s = &self.config.surface;
        let radius = self.area_radius_m();
        let change = s.curvature_change_per_m_per_sqrt_m * (state.unrest.value() * radius).sqrt();
        let mean = Matrix2::identity() * (0.25 * radius * change).powi(2);
        filtered + centre + mean + turned * turned.transpose() + leaked * leaked.transpose()
    }

    /// The estimate at the time of the motion.
    pub fn estimate(&self, state: &ContactFilterState, motion: &Motion) -> WorldEstimate {
        let friction = state.has_slid.then_some(state.surface.friction);
        if state.phase == ContactPhase::Free {
            return WorldEstimate {
                friction,
                ..free_space(motion)
            };
        }
        let surface = &state.surface;
        let since = surface.frame.project(&(motion.point - motion.point_lagged));
        let now = surface.frame.turned(&(surface.shape * since));
        let covariance = self.normal_covariance(state);
        let sd = covariance.trace().max(0.0).sqrt() * std::f64::consts::FRAC_1_SQRT_2;
        let validity = if sd <= self.config.contact.normal_sd_max_rad {
            Validity::Valid
        } else {
            Validity::NotSliding
        };
        WorldEstimate {
            point: Point::new(motion.point),
            normal: Direction::new(now.normal),
            covariance: now.lift_matrix(&covariance),
            validity,
            friction,
            curvature: Some(now.lift_matrix(&surface.shape)),
        }
    }
}

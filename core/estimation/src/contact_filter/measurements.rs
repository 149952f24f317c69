//! Measurements of the contact filter: velocity along the surface, force while sliding, force and
//! torque while pressing.

use nalgebra::Vector3;

use super::ContactFilter;
use super::state::{
    BIAS, ContactFilterState, FRICTION, LearntNoise, NORMAL, ROTATION, Row, SHAPE, SurfaceState, WEIGHT,
};
use crate::motion::Motion;

/// Correlation length of velocity errors and of friction's fluctuations, m.
const FLUCTUATION_LENGTH_M: f64 = 0.002;
/// Correlation time of the force's noise after the wrench filter, s.
const FORCE_CORRELATION_S: f64 = 0.01;
/// Fluctuation of friction around Coulomb's law, relative.
const FRICTION_FLUCTUATION: f64 = 0.03;
/// Distance over which the surface's unrest is learnt, m.
const UNREST_LENGTH_M: f64 = 0.01;
/// Bounds of the unrest: the variance with which curvature changes, relative to the configured one.
const UNREST: (f64, f64) = (1.0, 40.0);

impl ContactFilter {
    /// The contact point moves along the surface, except for what the compliance yields.
    pub(super) fn measure_velocity(
        &self,
        state: &mut ContactFilterState,
        velocity: &Vector3<f64>,
        motion: &Motion,
    ) {
        let speed = state.slide.speed_m_per_s;
        let mut sd2 = state.noise.velocity.variance();
        // A rising force is a motion into the surface, which is known to one half.
        let giving = state.compliance.m_per_n * state.load.rate_n_per_s;
        sd2 += (0.5 * giving).powi(2);
        sd2 += (state.centre.sd_m * motion.angular.norm()).powi(2);
        let mut row = Row::zeros();
        let normal = state.normal_at_centre();
        let tangent = state.surface.frame.project(velocity);
        row[NORMAL] = tangent.x;
        row[NORMAL + 1] = tangent.y;
        state.shape_row(&mut row, velocity);
        let distance = speed * motion.dt_s;
        let alike = (FLUCTUATION_LENGTH_M / distance).max(1.0);
        let innovation = -normal.dot(velocity) - giving;
        state
            .noise
            .velocity
            .learn(innovation, distance / FLUCTUATION_LENGTH_M);
        let expected = row.dot(&(state.surface.covariance * row)) + sd2;
        state.noise.learn_unrest(innovation, expected, distance);
        self.correct(state, &row, innovation, sd2 * alike);
    }

    /// `f = N (n - mu t) + b`, measured across and along the direction of sliding.
    pub(super) fn measure_sliding_force(&self, state: &mut ContactFilterState, motion: &Motion) {
        let speed = state.slide.speed_m_per_s;
        let normal = state.normal_at_centre();
        let force = state.force(motion);
        let slide = state.slide.direction;
        let t = (slide - normal * normal.dot(&slide)).normalize();
        let expected = normal - t * state.surface.friction;
        let load = expected.dot(&force) / expected.norm_squared();
        if load < self.config.contact.force_off_n {
            return;
        }
        let line = expected.normalize();
        let across = normal.cross(&t);
        let along = across.cross(&line);
        // The wrench filter correlates neighbouring samples.
        let alike = (FLUCTUATION_LENGTH_M / (speed * motion.dt_s)).max(1.0);

        let noise = self.config.sensing.force_noise_n.powi(2)
            * (2.0 * FORCE_CORRELATION_S / motion.dt_s).max(1.0);
        let across_innovation = across.dot(&force);
        let row = state.force_row(&across, &normal, &t, load, motion);
        // Friction leaks across by the error of the direction of sliding. Half of this error is
        // that of the arm's velocity, the other half that of a tool that yields and turns.
        let sideways = 2.0 * self.config.sensing.velocity_sd_m_per_s / speed;
        let leak = (state.surface.friction * load * sideways.min(0.5)).powi(2);
        self.correct(state, &row, across_innovation, noise + leak * alike);

        let along_innovation = along.dot(&force);
        let row = state.force_row(&along, &normal, &t, load, motion);
        let fluctuation = (FRICTION_FLUCTUATION * load * state.surface.friction.max(0.1)).powi(2)
            + state.noise.friction_n2;
        self.correct(state, &row, along_innovation, noise + fluctuation * alike);
        let gain = (speed * motion.dt_s / 0.02).min(0.2);
        state.noise.friction_n2 += gain
            * ((along_innovation * along_innovation - noise).clamp(0.0, (0.3 * load).powi(2))
                - state.noise.friction_n2);
    }

    /// While pressing without sliding, friction may point anywhere inside its cone. The information
    /// grows with the load, not with the number of samples.
    pub(super) fn measure_pressing_force(&self, state: &mut ContactFilterState, motion: &Motion) {
        let force = state.force(motion);
        let frame = state.surface.frame;
        let load = frame.normal.dot(&force);
        if load < self.config.contact.force_on_n {
            return;
        }
        let s = &self.config.surface;
        let cone = s.friction_initial.hypot(s.friction_sd) / std::f64::consts::SQRT_2;
        let whole = (load - self.config.contact.force_off_n).max(0.0) / load;
        let gained = whole - state.touch.pressing_information;
        if gained < 1e-3 {
            return;
        }
        state.touch.pressing_information = whole;
        let variance = ((cone * load).powi(2) + self.config.sensing.force_noise_n.powi(2)) / gained;
        let (normal, t) = (frame.normal, Vector3::zeros());
        for axis in [frame.first, frame.second] {
            let row = state.force_row(&axis, &normal, &t, load, motion);
            self.correct(state, &row, axis.dot(&force), variance);
        }
    }
}

impl LearntNoise {
    /// Estimates how fast the curvature changes, from the ratio of the measured to the expected
    /// velocity across the surface. Only velocity is used, because no force bias disturbs it.
    fn learn_unrest(&mut self, innovation: f64, expected: f64, distance: f64) {
        let share = (distance / UNREST_LENGTH_M).min(0.2);
        self.innovation_m2_per_s2 += share * (innovation * innovation - self.innovation_m2_per_s2);
        self.expected_m2_per_s2 += share * (expected - self.expected_m2_per_s2);
        if self.expected_m2_per_s2 > 0.0 {
            let ratio = (self.innovation_m2_per_s2 / self.expected_m2_per_s2).clamp(0.02, 50.0);
            self.unrest = (self.unrest * ratio.powf(2.0 * share)).clamp(UNREST.0, UNREST.1);
        }
    }
}

impl ContactFilterState {
    fn normal_at_centre(&self) -> Vector3<f64> {
        let SurfaceState { frame, shape, .. } = &self.surface;
        let offset = shape * frame.project(&self.centre.position);
        frame.turned(&offset).normal
    }

    /// Derivative of `normal_at_centre · v` by the shape operator.
    fn shape_row(&self, row: &mut Row, v: &Vector3<f64>) {
        let r = self.surface.frame.project(&self.centre.position);
        let w = self.surface.frame.project(v);
        row[SHAPE] = w.x * r.x;
        row[SHAPE + 1] = w.y * r.y;
        row[SHAPE + 2] = w.x * r.y + w.y * r.x;
    }

    /// Derivative of `axis · f` by the states; `axis` is perpendicular to the line of the force.
    fn force_row(
        &self,
        axis: &Vector3<f64>,
        normal: &Vector3<f64>,
        t: &Vector3<f64>,
        load: f64,
        motion: &Motion,
    ) -> Row {
        let mut row = Row::zeros();
        // Turning the normal towards the direction of sliding tilts that direction out of the old
        // tangent plane.
        let sensitive = (axis + t * (self.surface.friction * axis.dot(normal))) * load;
        let tangent = self.surface.frame.project(&sensitive);
        row[NORMAL] = tangent.x;
        row[NORMAL + 1] = tangent.y;
        self.shape_row(&mut row, &sensitive);
        row[FRICTION] = -load * axis.dot(t);
        let bias = motion.rotation.tr_mul(axis);
        row.fixed_rows_mut::<3>(BIAS).copy_from(&bias);
        row[WEIGHT] = bias.dot(&self.payload.leverage);
        let turned = self.force_in_tool(motion).cross(&bias);
        row.fixed_rows_mut::<3>(ROTATION).copy_from(&turned);
        row
    }
}

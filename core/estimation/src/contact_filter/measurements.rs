//! Measurements of the contact filter: height over the surface, force while sliding, force and
//! torque while pressing.

use nalgebra::Vector3;

use super::ContactFilter;
use super::compliance::given;
use super::learnt_noise::FLUCTUATION_LENGTH_M;
use super::state::{
    BIAS, ContactFilterState, FRICTION, GIVE, HEIGHT, NORMAL, ROTATION, Row, SHAPE, SurfaceState,
    WEIGHT,
};
use crate::motion::Motion;

/// Fluctuation of friction around Coulomb's law, relative.
const FRICTION_FLUCTUATION: f64 = 0.03;

/// Error of the direction of a force by cross-talk between the sensor's axes, over the error of the
/// rotation of these axes.
const CROSS_TALK: f64 = 2.0;

/// Distance over which the contact stays at its place on the tip, m.
const PLACE_LENGTH_M: f64 = 0.02;

/// Change of the height in a sample that is a jump: a slope over the distance, and standard
/// deviations of the height.
const JUMP_SLOPE: f64 = 0.7;
const JUMP_SD: f64 = 3.0;
/// Standard deviations beyond which a height gets less weight. An error of the slope adds up in the
/// height, so that what looks like an outlier is news.
const HEIGHT_HUBER_SD: f64 = 20.0;
/// Standard deviations beyond which the height of a touch beside a lost contact gets less weight: a
/// ledge may be between them.
const TOUCH_HUBER_SD: f64 = 4.0;

impl ContactFilter {
    /// The height of the contact over the surface is what the compliance gives under the force.
    /// `distance_m` is the way since the last such measurement.
    pub(super) fn measure_height(
        &self,
        state: &mut ContactFilterState,
        motion: &Motion,
        distance_m: f64,
    ) {
        let (row, innovation) = state.height_row(motion);
        let give = state.surface.give_m_per_n;
        state.noise.learn_height(innovation, distance_m);
        let variance = state.noise.height_variance_of_sample(distance_m)
            + give.x * give.x * state.noise.force_variance_of_sample(motion.dt_s);
        // A seam or a step changes the height at once; a wrong slope changes it bit by bit.
        let jump = innovation - std::mem::replace(&mut state.slide.height_innovation_m, innovation);
        let most = JUMP_SLOPE * distance_m + JUMP_SD * state.noise.height_variance().sqrt();
        if jump.abs() > most {
            state.surface.covariance[(HEIGHT, HEIGHT)] += innovation * innovation;
        }
        let friction_max = self.config.surface.friction_max;
        state
            .surface
            .correct(HEIGHT_HUBER_SD, &row, innovation, variance, friction_max);
    }

    /// The height of a tool that touches a remembered surface elsewhere, and stands there.
    pub(super) fn measure_height_of_touch(&self, state: &mut ContactFilterState, motion: &Motion) {
        let (row, innovation) = state.height_row(motion);
        let give = state.surface.give_m_per_n;
        let force_n = self.config.sensing.force_noise_n;
        let variance = state.noise.height_variance() + (give.x * force_n).powi(2);
        let friction_max = self.config.surface.friction_max;
        state
            .surface
            .correct(TOUCH_HUBER_SD, &row, innovation, variance, friction_max);
    }

    /// `f = N (n - mu t) + b`, measured across and along the direction of sliding.
    pub(super) fn measure_sliding_force(&self, state: &mut ContactFilterState, motion: &Motion) {
        let speed = state.slide.speed_m_per_s;
        let normal = state.normal_at_centre();
        let force = state.force(motion);
        let slide = state.slide.tip_direction;
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

        let across_innovation = across.dot(&force);
        state.noise.learn_force(across_innovation, motion.dt_s);
        let noise = state.noise.force_variance_of_sample(motion.dt_s)
            + (CROSS_TALK * self.config.sensing.rotation_sd_rad * load).powi(2) * alike;
        let mut row = state.force_row(&across, &normal, &t, load, motion);
        let turned_by_give = across.dot(&state.slide.tip_by_give) / slide.norm();
        row[GIVE + 1] = -load * state.surface.friction * turned_by_give;
        // Friction leaks across by the error of the direction of sliding. Half of this error is
        // that of the arm's velocity, the other half that of a tool that yields and turns.
        let sideways = (2.0 * self.config.sensing.velocity_sd_m_per_s / speed).min(0.5);
        let turned = state.slide.tip_direction_sd_rad();
        let leak = (state.surface.friction * load * sideways.hypot(turned)).powi(2);
        let beside = self.beside_variance_of_sample(state, &across, load, speed * motion.dt_s);
        let variance = noise + leak * alike + beside;
        self.correct(state, &row, across_innovation, variance);

        let along_innovation = along.dot(&force);
        let row = state.force_row(&along, &normal, &t, load, motion);
        let fluctuation = (FRICTION_FLUCTUATION * load * state.surface.friction.max(0.1)).powi(2)
            + (state.surface.friction * load * 0.5 * turned).powi(2)
            + state.noise.friction_n2;
        let beside = self.beside_variance_of_sample(state, &along, load, speed * motion.dt_s);
        let variance = noise + fluctuation * alike + beside;
        self.correct(state, &row, along_innovation, variance);
        let gain = (speed * motion.dt_s / 0.02).min(0.2);
        state.noise.friction_n2 += gain
            * ((along_innovation * along_innovation - noise).clamp(0.0, (0.3 * load).powi(2))
                - state.noise.friction_n2);
    }

    /// Variance of the force along `axis` (N²) because the contact may be beside the assumed centre
    /// of pressure, where a curved surface has another normal. It does not average out over the
    /// `distance_m` of one sample.
    fn beside_variance_of_sample(
        &self,
        state: &ContactFilterState,
        axis: &Vector3<f64>,
        load_n: f64,
        distance_m: f64,
    ) -> f64 {
        let surface = &state.surface;
        let direction = surface.frame.project(axis);
        let unknown = surface.covariance[(SHAPE, SHAPE)].max(0.0);
        let curvature2 =
            (surface.shape * direction).norm_squared() + unknown * direction.norm_squared();
        let variance = (load_n * state.centre.sd_m).powi(2) * curvature2;
        variance * (PLACE_LENGTH_M / distance_m).max(1.0)
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

impl ContactFilterState {
    pub(super) fn normal_at_centre(&self) -> Vector3<f64> {
        let SurfaceState { frame, shape, .. } = &self.surface;
        let offset = shape * frame.project(&self.centre.position);
        frame.turned(&offset).normal
    }

    /// Derivative of the height's measurement by the states, and its innovation, m.
    fn height_row(&self, motion: &Motion) -> (Row, f64) {
        let normal = motion.rotation.tr_mul(&self.normal_at_centre());
        let force = self.force_in_tool(motion);
        let given = given(&normal, &force);
        let mut row = Row::zeros();
        row[HEIGHT] = 1.0;
        row.fixed_rows_mut::<2>(GIVE).copy_from(&given);
        // A wrong normal takes the motion of a bent tool for a slope.
        let give = self.surface.give_m_per_n;
        let bent = motion.rotation * force.component_mul(&give.yyx());
        let by_normal = self.surface.frame.project(&bent);
        row[NORMAL] += by_normal.x;
        row[NORMAL + 1] += by_normal.y;
        (row, -self.surface.height_m - given.dot(&give))
    }

    /// Derivative of `normal_at_centre · v` by the shape operator.
    pub(super) fn shape_row(&self, row: &mut Row, v: &Vector3<f64>) {
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

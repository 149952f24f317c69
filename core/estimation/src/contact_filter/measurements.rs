//! What the filter measures: velocity along the surface, force while sliding, force while pressing.

use nalgebra::Vector3;

use super::{BIAS, ContactFilter, FRICTION, NORMAL, Row, SHAPE, WEIGHT};
use crate::motion::Motion;

/// Distance over which velocity errors and friction's own fluctuations stay alike, m.
const FLUCTUATION_LENGTH_M: f64 = 0.002;
/// The wrench filter leaves samples alike for so long, s.
const FORCE_CORRELATION_S: f64 = 0.01;
/// Friction's fluctuation around Coulomb's law, relative.
const FRICTION_FLUCTUATION: f64 = 0.03;
/// Doubt of what a tilt does to the centre of pressure, relative: radius and stiffness are known
/// roughly, and a tilted pad touches with a part of itself only.
const FLUSH_DOUBT: f64 = 1.0;
/// Softest and stiffest contact believed, as compliance.
const COMPLIANCE_M_PER_N: (f64, f64) = (1e-5, 5e-3);
/// Doubt of a compliance that was not measured yet, as a factor.
const COMPLIANCE_DOUBT: f64 = 4.0;
/// Pad and tool axis are square to each other this well, rad.
const FLUSH_SD_RAD: f64 = 0.002;
/// Distance over which the surface's unrest is learnt, m.
const UNREST_LENGTH_M: f64 = 0.01;
/// Bounds of the unrest: the variance with which curvature changes, relative to the configured one.
const UNREST: (f64, f64) = (1.0, 40.0);

impl ContactFilter {
    /// The contact point moves along the surface, but for what compliance gives way.
    pub(super) fn measure_velocity(
        &mut self,
        velocity: &Vector3<f64>,
        speed: f64,
        motion: &Motion,
    ) {
        let mut sd2 = self.velocity_noise.variance();
        // Pressing harder is a motion into the surface, known by half.
        let giving = self.compliance_m_per_n * self.force_rate_n_per_s;
        sd2 += (0.5 * giving).powi(2);
        sd2 += (self.centre_sd_m * motion.angular.norm()).powi(2);
        let mut row = Row::zeros();
        let normal = self.normal_at_centre();
        let tangent = self.frame.project(velocity);
        row[NORMAL] = tangent.x;
        row[NORMAL + 1] = tangent.y;
        self.shape_row(&mut row, velocity);
        let alike = (FLUCTUATION_LENGTH_M / (speed * motion.dt_s)).max(1.0);
        let innovation = -normal.dot(velocity) - giving;
        self.velocity_noise
            .learn(innovation, speed * motion.dt_s / FLUCTUATION_LENGTH_M);
        let expected = row.dot(&(self.covariance * row)) + sd2;
        self.learn_unrest(innovation, expected, speed * motion.dt_s);
        self.correct(&row, innovation, sd2 * alike);
    }

    /// Motion across the surface that was larger than expected says that its curvature changes
    /// faster, and the other way round. Velocity alone is asked: no force bias disturbs it.
    fn learn_unrest(&mut self, innovation: f64, expected: f64, distance: f64) {
        let share = (distance / UNREST_LENGTH_M).min(0.2);
        self.innovation_m2_per_s2 += share * (innovation * innovation - self.innovation_m2_per_s2);
        self.expected_m2_per_s2 += share * (expected - self.expected_m2_per_s2);
        if self.expected_m2_per_s2 > 0.0 {
            let ratio = (self.innovation_m2_per_s2 / self.expected_m2_per_s2).clamp(0.02, 50.0);
            self.unrest = (self.unrest * ratio.powf(2.0 * share)).clamp(UNREST.0, UNREST.1);
        }
    }

    /// `f = N (n - mu t) + b`, seen across and along the direction of sliding.
    pub(super) fn measure_sliding_force(&mut self, motion: &Motion, speed: f64) {
        let normal = self.normal_at_centre();
        let force = self.force(motion);
        let t = (self.slide_direction - normal * normal.dot(&self.slide_direction)).normalize();
        let expected = normal - t * self.friction;
        let load = expected.dot(&force) / expected.norm_squared();
        if load < self.config.contact.force_off_n {
            return;
        }
        let line = expected.normalize();
        let across = normal.cross(&t);
        let along = across.cross(&line);
        // The wrench filter leaves neighbouring samples alike.
        let alike = (FLUCTUATION_LENGTH_M / (speed * motion.dt_s)).max(1.0);

        let noise = self.config.sensing.force_noise_n.powi(2)
            * (2.0 * FORCE_CORRELATION_S / motion.dt_s).max(1.0);
        let across_innovation = across.dot(&force);
        let row = self.force_row(&across, &normal, &t, load, motion);
        // Friction leaks across as far as the direction of sliding is in doubt: the arm's velocity,
        // and as much again from a tool that gives way and turns.
        let sideways = 2.0 * self.config.sensing.velocity_sd_m_per_s / speed;
        let leak = (self.friction * load * sideways.min(0.5)).powi(2);
        self.correct(&row, across_innovation, noise + leak * alike);

        let along_innovation = along.dot(&force);
        let row = self.force_row(&along, &normal, &t, load, motion);
        let fluctuation = (FRICTION_FLUCTUATION * load * self.friction.max(0.1)).powi(2)
            + self.friction_residual_n2;
        self.correct(&row, along_innovation, noise + fluctuation * alike);
        let gain = (speed * motion.dt_s / 0.02).min(0.2);
        self.friction_residual_n2 += gain
            * ((along_innovation * along_innovation - noise).clamp(0.0, (0.3 * load).powi(2))
                - self.friction_residual_n2);
    }

    /// Pressing without sliding, friction points anywhere inside its cone: one look at the force,
    /// however long it takes.
    pub(super) fn measure_pressing_force(&mut self, motion: &Motion) {
        let force = self.force(motion);
        let load = self.frame.normal.dot(&force);
        if load < self.config.contact.force_on_n {
            return;
        }
        let s = &self.config.surface;
        let cone = s.friction_initial.hypot(s.friction_sd) / std::f64::consts::SQRT_2;
        // Information grows with the load and never with time.
        let whole = (load - self.config.contact.force_off_n).max(0.0) / load;
        let gained = whole - self.pressing_information;
        if gained < 1e-3 {
            return;
        }
        self.pressing_information = whole;
        let variance = ((cone * load).powi(2) + self.config.sensing.force_noise_n.powi(2)) / gained;
        let (normal, t) = (self.frame.normal, Vector3::zeros());
        for axis in [self.frame.first, self.frame.second] {
            let row = self.force_row(&axis, &normal, &t, load, motion);
            self.correct(&row, axis.dot(&force), variance);
        }
    }

    /// Way into the surface over force, since the touch: what tool, wrist and surface give way
    /// together.
    pub(super) fn learn_compliance(&mut self, motion: &Motion, pressing_n: f64) {
        let (point, force_n) = self.touch;
        let gained_n = pressing_n - force_n;
        if gained_n < 0.3 * pressing_n {
            return;
        }
        let z: Vector3<f64> = motion.rotation.column(2).into();
        let measured = (motion.point_lagged - point).dot(&z) / gained_n;
        self.compliance_m_per_n = measured.clamp(COMPLIANCE_M_PER_N.0, COMPLIANCE_M_PER_N.1);
        self.compliance_known = true;
    }

    /// A flat pad that stands askew is pressed harder on one side: the centre of pressure says how
    /// far, as well as pad and stiffness are known. One best look: torque bias and stiffness are
    /// the same all the time.
    pub(super) fn measure_flush(&mut self, motion: &Motion, pressing_n: f64) {
        let c = &self.config.contact;
        if pressing_n < c.force_on_n || c.pad_radius_m <= 0.0 {
            return;
        }
        let z: Vector3<f64> = motion.rotation.column(2).into();
        // A bed of springs under a disk: tilt = 4 N c / (k R²), and what the surface itself turns
        // by up to there.
        let soft = 4.0 * pressing_n * self.compliance_m_per_n / c.pad_radius_m.powi(2);
        let centre = self.frame.project(&self.centre);
        let tilt = centre * soft + self.shape * centre;
        let unknown = if self.compliance_known {
            1.0
        } else {
            COMPLIANCE_DOUBT
        };
        let doubt = (unknown * soft).hypot(self.config.surface.curvature_sd_per_m);
        let variance = (FLUSH_DOUBT * doubt * centre.norm()).powi(2)
            + (doubt * self.centre_sd_m).powi(2)
            + FLUSH_SD_RAD.powi(2);
        let gained = 1.0 / variance - self.flush_information;
        if gained <= 0.02 * self.flush_information {
            return;
        }
        self.flush_information = 1.0 / variance;
        let innovation = self.frame.project(&-z) - tilt;
        for i in 0..2 {
            let mut row = Row::zeros();
            row[NORMAL + i] = 1.0;
            self.correct(&row, innovation[i], 1.0 / gained);
        }
    }

    fn normal_at_centre(&self) -> Vector3<f64> {
        let offset = self.shape * self.frame.project(&self.centre);
        self.frame.turned(&offset).normal
    }

    /// Derivative of `normal_at_centre · v` by the shape operator.
    fn shape_row(&self, row: &mut Row, v: &Vector3<f64>) {
        let r = self.frame.project(&self.centre);
        let w = self.frame.project(v);
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
        let sensitive = (axis + t * (self.friction * axis.dot(normal))) * load;
        let tangent = self.frame.project(&sensitive);
        row[NORMAL] = tangent.x;
        row[NORMAL + 1] = tangent.y;
        self.shape_row(&mut row, &sensitive);
        row[FRICTION] = -load * axis.dot(t);
        let bias = motion.rotation.tr_mul(axis);
        row.fixed_rows_mut::<3>(BIAS).copy_from(&bias);
        row[WEIGHT] = bias.dot(&self.leverage);
        row
    }
}

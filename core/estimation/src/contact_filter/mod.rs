//! The filter under every sound estimator: normal on the sphere, shape operator, friction, and
//! force bias, each with its covariance.
//!
//! While sliding with contact force `N`, the force on the tool is `f = N (n - mu t) + b` with `t`
//! the direction of sliding, and the contact point moves along the surface, `n · v = 0`. `N` is
//! never estimated: the force is used only across the line it is expected along. Ten error states:
//! the normal's two tangent components (rad), the shape operator's `k11, k22, k12` (1/m), friction,
//! the bias's three components in tool axes (N), and the weight that the payload's compensation is
//! wrong by (N), which shows as the tool turns away from where it was tared.

mod measurements;
mod residual;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};
use tangent_sensing::Validity;

use self::residual::Residual;
use crate::motion::{Motion, free_space};
use crate::tangent_frame::TangentFrame;
use crate::{EstimatorConfig, NormalEstimate};

const STATES: usize = 10;
const NORMAL: usize = 0;
const SHAPE: usize = 2;
const FRICTION: usize = 5;
const BIAS: usize = 6;
const WEIGHT: usize = 9;

type Row = SVector<f64, STATES>;

/// Correlation time of force disturbances in free space (inertia, cables), s.
const FREE_CORRELATION_S: f64 = 0.5;
/// Standard deviation of force disturbances in free space (inertia, cables), N.
const FREE_FORCE_SD_N: f64 = 0.05;
/// Standard deviation of the lag between wrench and motion, s.
const LAG_SD_S: f64 = 0.008;
/// Number of standard deviations beyond which an innovation gets less weight.
const HUBER_SD: f64 = 2.5;

/// How the tool touches the surface in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ContactState {
    Free,
    Pressing,
    Sliding,
}

#[derive(Clone, Debug)]
pub(crate) struct ContactFilter {
    config: EstimatorConfig,
    frame: TangentFrame,
    shape: Matrix2<f64>,
    friction: f64,
    bias: Vector3<f64>,
    weight_n: f64,
    /// Direction of gravity, base axes.
    gravity: Vector3<f64>,
    /// Direction of gravity in tool axes when the sensor was tared; `None` before the first sample.
    gravity_at_tare: Option<Vector3<f64>>,
    /// Force that one newton of payload weight error adds now, tool axes.
    leverage: Vector3<f64>,
    covariance: SMatrix<f64, STATES, STATES>,
    state: ContactState,
    touched: bool,
    slid: bool,
    free_distance_m: f64,
    free_time_s: f64,
    slide_direction: Vector3<f64>,
    slide_distance_m: f64,
    pressing_information: f64,
    force_n: f64,
    force_filtered_n: f64,
    force_rate_n_per_s: f64,
    friction_residual_n2: f64,
    unrest: f64,
    innovation_m2_per_s2: f64,
    expected_m2_per_s2: f64,
    velocity_noise: Residual,
    /// Information of the best tilt measurement from the pad's torque so far, 1/rad².
    flush_information: f64,
    /// Point and pressing force (N) at touchdown.
    touch: (Vector3<f64>, f64),
    compliance_m_per_n: f64,
    compliance_known: bool,
    turn_rate_rad_per_s: f64,
    speed_m_per_s: f64,
    centre: Vector3<f64>,
    centre_sd_m: f64,
}

impl ContactFilter {
    pub fn new(config: &EstimatorConfig) -> Self {
        let mut filter = Self {
            config: *config,
            frame: TangentFrame::new(Vector3::z(), Vector3::x()),
            shape: Matrix2::zeros(),
            friction: config.surface.friction_initial,
            bias: Vector3::zeros(),
            weight_n: 0.0,
            gravity: Vector3::from(config.sensing.gravity_direction_in_base).normalize(),
            gravity_at_tare: None,
            leverage: Vector3::zeros(),
            covariance: SMatrix::zeros(),
            state: ContactState::Free,
            touched: false,
            slid: false,
            free_distance_m: 0.0,
            free_time_s: 0.0,
            slide_direction: Vector3::zeros(),
            slide_distance_m: 0.0,
            pressing_information: 0.0,
            force_n: 0.0,
            force_filtered_n: 0.0,
            force_rate_n_per_s: 0.0,
            friction_residual_n2: 0.0,
            unrest: 1.0,
            innovation_m2_per_s2: 0.0,
            expected_m2_per_s2: 0.0,
            velocity_noise: Residual::new(config.sensing.velocity_sd_m_per_s),
            flush_information: 0.0,
            touch: (Vector3::zeros(), 0.0),
            compliance_m_per_n: config.sensing.compliance_m_per_n,
            compliance_known: false,
            turn_rate_rad_per_s: 0.0,
            speed_m_per_s: 0.0,
            centre: Vector3::zeros(),
            centre_sd_m: 0.0,
        };
        for i in 0..3 {
            filter.covariance[(BIAS + i, BIAS + i)] = config.sensing.force_bias_sd_n.powi(2);
        }
        filter.covariance[(WEIGHT, WEIGHT)] = config.sensing.payload_error_n.powi(2);
        filter.covariance[(FRICTION, FRICTION)] = config.surface.friction_sd.powi(2);
        filter
    }

    /// Updates the filter with the motion and force of one cycle.
    pub fn update(&mut self, motion: &Motion) {
        if motion.tared {
            *self = Self::new(&self.config);
            let s = &self.config.sensing;
            let drift = s.force_bias_drift_n_per_sqrt_s.powi(2) * motion.bias_age_s;
            for i in BIAS..BIAS + 3 {
                self.covariance[(i, i)] += drift;
            }
        }
        self.drift(motion);
        let force = self.force(motion);
        // Along the tool's axis, so that a sideways bias does not count as pressing.
        let pressing_n = -self.force_in_tool(motion).z;
        let contact = &self.config.contact;
        let threshold = if self.state == ContactState::Free {
            contact.force_on_n
        } else {
            contact.force_off_n
        };
        if pressing_n < threshold {
            self.in_free_space(motion);
            return;
        }
        if self.state == ContactState::Free {
            self.touch_down(motion, pressing_n);
        }
        self.centre_of_pressure(motion, pressing_n);
        self.travel(motion);
        self.track_force(&force, motion.dt_s);

        let velocity = self.contact_velocity(motion);
        let tangential = velocity - self.frame.normal * self.frame.normal.dot(&velocity);
        let speed = tangential.norm();
        self.speed_m_per_s = speed;
        let sliding = speed > self.config.contact.sliding_speed_min_m_per_s;
        self.track_sliding(&tangential, speed, sliding, motion.dt_s);
        if sliding {
            self.state = ContactState::Sliding;
            self.slid = true;
            self.measure_velocity(&velocity, speed, motion);
            if self.slide_distance_m >= self.config.contact.presliding_distance_m {
                self.measure_sliding_force(motion, speed);
            }
        } else {
            self.state = ContactState::Pressing;
            if !self.slid {
                self.measure_pressing_force(motion);
                self.learn_compliance(motion, pressing_n);
                self.measure_flush(motion, pressing_n);
            }
        }
    }

    /// Adds the drift of the bias, and updates how the payload's error acts at the current
    /// orientation.
    fn drift(&mut self, motion: &Motion) {
        let q = self.config.sensing.force_bias_drift_n_per_sqrt_s.powi(2) * motion.dt_s;
        for i in BIAS..BIAS + 3 {
            self.covariance[(i, i)] += q;
        }
        let gravity = motion.rotation.tr_mul(&self.gravity);
        self.leverage = gravity - *self.gravity_at_tare.get_or_insert(gravity);
    }

    /// Force on the tool without bias and payload weight error, tool axes, N.
    fn force_in_tool(&self, motion: &Motion) -> Vector3<f64> {
        motion.force_in_tool - self.bias - self.leverage * self.weight_n
    }

    /// Force on the tool without bias and payload weight error, base axes, N.
    fn force(&self, motion: &Motion) -> Vector3<f64> {
        motion.rotation * self.force_in_tool(motion)
    }

    /// Update in free space, where the sensor reads only its bias and the payload's error.
    fn in_free_space(&mut self, motion: &Motion) {
        if self.state != ContactState::Free {
            self.state = ContactState::Free;
            self.free_distance_m = 0.0;
            self.free_time_s = 0.0;
        }
        self.free_distance_m += motion.step.norm();
        self.free_time_s += motion.dt_s;
        self.slide_distance_m = 0.0;
        self.slide_direction = Vector3::zeros();
        // Just after a contact, the filtered wrench still contains part of it.
        let settled = !self.touched || self.free_time_s > 0.2;
        let bias_sd =
            self.config.sensing.force_bias_sd_n + self.config.sensing.force_bias_drift_n_per_sqrt_s;
        if !settled || bias_sd <= 0.0 {
            return;
        }
        let variance = (FREE_FORCE_SD_N.powi(2) + self.config.sensing.force_noise_n.powi(2))
            * (FREE_CORRELATION_S / motion.dt_s).max(1.0);
        for axis in 0..3 {
            let mut row = Row::zeros();
            row[BIAS + axis] = 1.0;
            row[WEIGHT] = self.leverage[axis];
            let innovation = self.force_in_tool(motion)[axis];
            self.correct(&row, innovation, variance);
        }
    }

    fn touch_down(&mut self, motion: &Motion, pressing_n: f64) {
        let c = &self.config.contact;
        let remembered = self.slid && self.free_distance_m <= c.memory_distance_m;
        self.force_filtered_n = 0.0;
        self.force_rate_n_per_s = 0.0;
        self.pressing_information = 0.0;
        self.flush_information = 0.0;
        self.touch = (motion.point_lagged, pressing_n);
        if remembered {
            let sd = self.config.surface.curvature_sd_per_m * self.free_distance_m;
            for i in NORMAL..NORMAL + 2 {
                self.covariance[(i, i)] += sd * sd;
            }
            return;
        }
        self.touched = true;
        self.slid = false;
        self.frame =
            TangentFrame::new(-motion.rotation.column(2), motion.rotation.column(0).into());
        self.shape = Matrix2::zeros();
        for i in 0..FRICTION {
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
        }
        for i in NORMAL..NORMAL + 2 {
            self.covariance[(i, i)] = c.approach_misalignment_sd_rad.powi(2);
        }
        let curvature = self.config.surface.curvature_sd_per_m.powi(2);
        self.covariance[(SHAPE, SHAPE)] = curvature;
        self.covariance[(SHAPE + 1, SHAPE + 1)] = curvature;
        self.covariance[(SHAPE + 2, SHAPE + 2)] = 0.5 * curvature;
    }

    /// Computes the centre of pressure on the pad from the torque. The more uncertain the torque,
    /// the closer it is to the middle.
    fn centre_of_pressure(&mut self, motion: &Motion, pressing_n: f64) {
        let radius = self.config.contact.pad_radius_m;
        let spread = 0.5 * radius;
        let measured_sd = self.config.sensing.torque_sd_nm / pressing_n;
        let total = spread * spread + measured_sd * measured_sd;
        if total <= 0.0 {
            self.centre = Vector3::zeros();
            self.centre_sd_m = 0.0;
            return;
        }
        let share = spread * spread / total;
        self.centre_sd_m = spread * measured_sd / total.sqrt();
        let torque = &motion.torque_in_tool;
        let mut centre = Vector3::new(torque.y, -torque.x, 0.0) * (share / pressing_n);
        if centre.norm() > radius {
            centre *= radius / centre.norm();
        }
        self.centre = motion.rotation * centre;
    }

    /// Turns the normal with the surface under the tool: `dn = S dp`.
    fn travel(&mut self, motion: &Motion) {
        let d = self.frame.project(&motion.step);
        let distance = d.norm();
        if distance <= 0.0 {
            return;
        }
        let mut f = SMatrix::<f64, STATES, STATES>::identity();
        f[(NORMAL, SHAPE)] = d.x;
        f[(NORMAL, SHAPE + 2)] = d.y;
        f[(NORMAL + 1, SHAPE + 1)] = d.y;
        f[(NORMAL + 1, SHAPE + 2)] = d.x;
        self.covariance = f * self.covariance * f.transpose();
        let s = &self.config.surface;
        let waviness = s.waviness_rad_per_sqrt_m.powi(2) * distance * self.unrest;
        let curvature = s.curvature_change_per_m_per_sqrt_m.powi(2) * distance * self.unrest;
        let friction = s.friction_change_per_sqrt_m.powi(2) * distance;
        for (state, q) in [
            (NORMAL, waviness),
            (NORMAL + 1, waviness),
            (SHAPE, curvature),
            (SHAPE + 1, curvature),
            (SHAPE + 2, 0.5 * curvature),
            (FRICTION, friction),
        ] {
            self.covariance[(state, state)] += q;
        }
        self.frame = self.frame.turned(&(self.shape * d));
    }

    fn track_force(&mut self, force: &Vector3<f64>, dt_s: f64) {
        self.force_n = self.frame.normal.dot(force);
        // A time constant of 50 ms distinguishes a touchdown from noise.
        // Written without a division by `dt_s` alone, which may be close to zero.
        self.force_rate_n_per_s = (self.force_n - self.force_filtered_n) / (0.05 + dt_s);
        self.force_filtered_n += self.force_rate_n_per_s * dt_s;
    }

    fn contact_velocity(&self, motion: &Motion) -> Vector3<f64> {
        motion.velocity + motion.angular.cross(&self.centre)
    }

    fn track_sliding(&mut self, tangential: &Vector3<f64>, speed: f64, sliding: bool, dt_s: f64) {
        if !sliding {
            self.slide_distance_m = 0.0;
            return;
        }
        let direction = tangential / speed;
        // Turn rate of the sliding direction, with a time constant of 50 ms.
        if self.slide_distance_m > 0.0 {
            let turn = direction.cross(&self.slide_direction).norm();
            self.turn_rate_rad_per_s += (turn - self.turn_rate_rad_per_s * dt_s) / (0.05 + dt_s);
        } else {
            self.turn_rate_rad_per_s = 0.0;
        }
        // More than 60 degrees; friction follows a gentler turn by itself.
        if direction.dot(&self.slide_direction) < 0.5 {
            self.slide_distance_m = 0.0;
        }
        self.slide_direction = direction;
        self.slide_distance_m += speed * dt_s;
    }

    /// Updates the state with one scalar measurement. Outliers get less weight (Huber), so that a
    /// seam does not upset the state.
    fn correct(&mut self, row: &Row, innovation: f64, variance: f64) {
        let gain = self.covariance * row;
        let mut total = row.dot(&gain) + variance;
        // A measurement without information, as after a step of almost no time.
        if !total.is_finite() {
            return;
        }
        let excess = innovation.abs() / (HUBER_SD * total.sqrt());
        if excess > 1.0 {
            total *= excess;
        }
        let gain = gain / total;
        let change = gain * innovation;
        self.covariance -= gain * gain.transpose() * total;
        // Keeps the covariance exactly symmetric, and its diagonal non-negative.
        for i in 0..STATES {
            for j in 0..i {
                let mean = 0.5 * (self.covariance[(i, j)] + self.covariance[(j, i)]);
                self.covariance[(i, j)] = mean;
                self.covariance[(j, i)] = mean;
            }
            self.covariance[(i, i)] = self.covariance[(i, i)].max(0.0);
        }
        self.frame = self.frame.turned(&Vector2::new(change[0], change[1]));
        self.shape.m11 += change[SHAPE];
        self.shape.m22 += change[SHAPE + 1];
        self.shape.m12 += change[SHAPE + 2];
        self.shape.m21 = self.shape.m12;
        self.friction =
            (self.friction + change[FRICTION]).clamp(0.0, self.config.surface.friction_max);
        self.bias += change.fixed_rows::<3>(BIAS);
        self.weight_n += change[WEIGHT];
    }

    pub fn state(&self) -> ContactState {
        self.state
    }

    /// Tangent frame of the normal at the tool's origin, at the time of the wrench.
    pub fn frame(&self) -> &TangentFrame {
        &self.frame
    }

    /// Covariance of the normal in tangent axes, rad².
    pub fn normal_covariance(&self) -> Matrix2<f64> {
        let filtered = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        // The error of the centre of pressure never averages out: a torque bias stays.
        let centre = self.shape * self.shape * self.centre_sd_m.powi(2);
        // The lag of the wrench is uncertain by some milliseconds; the turn in that time does not
        // average out either.
        let ahead = self.frame.project(&self.slide_direction);
        let across = Vector2::new(-ahead.y, ahead.x);
        let turned = self.shape * ahead * (self.speed_m_per_s * LAG_SD_S);
        let leaked = across * (self.friction * self.turn_rate_rad_per_s * LAG_SD_S);
        // The pad measures a mean over its area, which is the normal at its middle only where the
        // curvature is constant.
        let s = &self.config.surface;
        let radius = self.config.contact.pad_radius_m;
        let change = s.curvature_change_per_m_per_sqrt_m * (self.unrest * radius).sqrt();
        let mean = Matrix2::identity() * (0.25 * radius * change).powi(2);
        filtered + centre + mean + turned * turned.transpose() + leaked * leaked.transpose()
    }

    /// Unit direction of sliding in the tangent plane, base axes; zero before the tool has slid.
    pub fn slide_direction(&self) -> Vector3<f64> {
        self.slide_direction
    }

    /// Centre of pressure relative to the tool's origin, base axes, m.
    pub fn centre(&self) -> Vector3<f64> {
        self.centre
    }

    /// Standard deviation of the centre of pressure per axis, m.
    pub fn centre_sd_m(&self) -> f64 {
        self.centre_sd_m
    }

    /// Shape operator in tangent axes, 1/m.
    pub fn shape(&self) -> &Matrix2<f64> {
        &self.shape
    }

    /// Pressing force along the normal, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// The estimate at the time of the motion.
    pub fn estimate(&self, motion: &Motion) -> NormalEstimate {
        let friction = self.slid.then_some(self.friction);
        if self.state == ContactState::Free {
            return NormalEstimate {
                friction,
                ..free_space(motion)
            };
        }
        let since = self.frame.project(&(motion.point - motion.point_lagged));
        let now = self.frame.turned(&(self.shape * since));
        let covariance = self.normal_covariance();
        let sd = covariance.trace().max(0.0).sqrt() * std::f64::consts::FRAC_1_SQRT_2;
        let validity = if sd <= self.config.contact.normal_sd_max_rad {
            Validity::Valid
        } else {
            Validity::NotSliding
        };
        NormalEstimate {
            point: motion.point,
            normal: now.normal,
            covariance: now.lift_matrix(&covariance),
            validity,
            friction,
            curvature: Some(now.lift_matrix(&self.shape)),
        }
    }
}

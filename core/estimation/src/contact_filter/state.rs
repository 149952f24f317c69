//! Memory of the contact filter, in groups that are set and reset together.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::learnt_noise::LearntNoise;
use super::slide::Slide;
use super::tilt_memory::TiltMemory;
use super::torque_mean::TorqueMean;
use super::unrest::{CurvatureNews, Unrest};
use crate::EstimatorConfig;
use crate::motion::Motion;
use crate::tangent_frame::TangentFrame;

/// Number of error states, and the places of the groups among them.
pub(super) const STATES: usize = 19;
pub(super) const NORMAL: usize = 0;
pub(super) const SHAPE: usize = 2;
pub(super) const FRICTION: usize = 5;
pub(super) const BIAS: usize = 6;
pub(super) const WEIGHT: usize = 9;
pub(super) const ROTATION: usize = 10;
pub(super) const HEIGHT: usize = 13;
pub(super) const GIVE: usize = 14;
pub(super) const TIP: usize = 16;

/// One row of a measurement matrix.
pub(super) type Row = SVector<f64, STATES>;

/// How the tool touches the surface in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ContactPhase {
    Free,
    Pressing,
    Sliding,
}

/// Range of a measured compliance, m/N. Values outside are clamped.
pub(super) const COMPLIANCE_M_PER_N: (f64, f64) = (1e-5, 5e-3);
/// Standard deviation of the tip's stated position along x, y and z, m.
const TIP_SD_M: [f64; 3] = [6e-4, 6e-4, 1.2e-3];
/// Time over which the reading of a pressing tool is averaged, s, and the share of it down to which
/// the tool presses as before.
const HELD_S: f64 = 1.0;
const HELD_SHARE: f64 = 0.6;
/// Largest bias, in standard deviations of its zero.
const BIAS_SDS: f64 = 4.0;

/// Memory of a [`ContactFilter`](super::ContactFilter). A new one is the reset.
#[derive(Clone, Debug)]
pub(crate) struct ContactFilterState {
    pub(super) surface: SurfaceState,
    pub(super) payload: PayloadState,
    pub(super) phase: ContactPhase,
    /// Whether the tool has touched a surface since the tare.
    pub(super) has_touched: bool,
    /// Whether the tool has slid on the present surface.
    pub(super) has_slid: bool,
    pub(super) memory: HeightMemory,
    /// Distance travelled since the last contact, m.
    pub(super) free_distance_m: f64,
    /// Displacement since the last contact, world axes, m.
    pub(super) free_way_m: Vector3<f64>,
    /// Time since the last contact, s.
    pub(super) free_time_s: f64,
    pub(super) touch: Touchdown,
    pub(super) tilt: TiltMemory,
    pub(super) slide: Slide,
    /// Pressing force along the normal, N.
    pub(super) force_n: f64,
    pub(super) centre: CentreOfPressure,
    pub(super) torque: TorqueMean,
    pub(super) noise: LearntNoise,
    pub(super) unrest: Unrest,
    pub(super) compliance: Compliance,
}

/// What is known of the height over the present surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HeightMemory {
    /// Nothing.
    None,
    /// That of the place where the tool first pressed.
    Here,
    /// The tool has slid from there, or touched beside it: its height is followed.
    Followed,
}

/// Mean and covariance of the Kalman filter.
#[derive(Clone, Debug)]
pub(super) struct SurfaceState {
    /// Normal and tangent axes, world axes.
    pub frame: TangentFrame,
    /// Shape operator, tangent axes, 1/m.
    pub shape: Matrix2<f64>,
    pub friction: f64,
    /// Force bias, tool axes, N.
    pub bias: Vector3<f64>,
    /// Error of the compensated payload weight, N.
    pub weight_n: f64,
    /// Rotation of the sensor's true axes against those stated, tool axes, rad.
    pub rotation: Vector3<f64>,
    /// Height of the point of contact over the undented surface, m.
    pub height_m: f64,
    /// Compliance along the tool's axis and across it, m/N.
    pub give_m_per_n: Vector2<f64>,
    /// Largest compliance across the tool's axis, m/N.
    pub give_across_most_m_per_n: f64,
    /// Error of the tip's stated position, tool axes, m.
    pub tip_m: Vector3<f64>,
    pub covariance: SMatrix<f64, STATES, STATES>,
    /// What the measurements of this sample say of the curvature along the motion.
    pub news: CurvatureNews,
}

/// How an error of the payload's weight acts on the sensor.
#[derive(Clone, Copy, Debug)]
pub(super) struct PayloadState {
    /// Direction of gravity in tool axes when the sensor was tared; `None` before the first sample.
    pub gravity_at_tare: Option<Vector3<f64>>,
    /// Force that one newton of payload weight error adds now, tool axes.
    pub leverage: Vector3<f64>,
}

/// The beginning of the present contact.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touchdown {
    /// Tool's origin at touchdown, world axes, m.
    pub point: Vector3<f64>,
    /// Pressing force at touchdown, N.
    pub force_n: f64,
    /// Mean of the reading along the tool's axis while it presses, N.
    pub held_n: f64,
    /// Information that the force has given since then while pressing, relative to a full load.
    pub pressing_information: f64,
    /// Time for which the tool presses and stands, s.
    pub pressed_s: f64,
    /// Whether the tool touches beside the place where it lost contact, and the height there is
    /// still to be measured.
    pub is_beside: bool,
}

/// Centre of pressure on the pad.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CentreOfPressure {
    /// Relative to the tool's origin, world axes, m.
    pub position: Vector3<f64>,
    /// Standard deviation per axis, m.
    pub sd_m: f64,
}

/// Compliance of tool, wrist and surface along the tool's axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Compliance {
    /// Across the tool's axis, m/N: smallest motion per force since the tare. `None` before a
    /// measurement.
    pub across_m_per_n: Option<f64>,
    pub m_per_n: f64,
    /// Whether it was measured since the tare.
    pub is_measured: bool,
    /// Pressing force up to which its change with the force is accounted for, N.
    pub at_force_n: f64,
}

impl Touchdown {
    /// Averages the reading along the tool's axis, N.
    pub fn hold(&mut self, read_n: f64, dt_s: f64) {
        self.held_n += (read_n - self.held_n) * (dt_s / HELD_S).min(1.0);
    }
}

impl ContactFilterState {
    /// State in free space, just after a tare.
    pub fn new(config: &EstimatorConfig) -> Self {
        Self {
            surface: SurfaceState::new(config),
            payload: PayloadState {
                gravity_at_tare: None,
                leverage: Vector3::zeros(),
            },
            phase: ContactPhase::Free,
            has_touched: false,
            has_slid: false,
            memory: HeightMemory::None,
            free_distance_m: 0.0,
            free_way_m: Vector3::zeros(),
            free_time_s: 0.0,
            touch: Touchdown {
                point: Vector3::zeros(),
                force_n: 0.0,
                held_n: 0.0,
                pressing_information: 0.0,
                pressed_s: 0.0,
                is_beside: false,
            },
            tilt: TiltMemory::default(),
            slide: Slide::default(),
            force_n: 0.0,
            centre: CentreOfPressure::default(),
            torque: TorqueMean::default(),
            noise: LearntNoise::new(config),
            unrest: Unrest::default(),
            compliance: Compliance {
                across_m_per_n: None,
                m_per_n: config.sensing.compliance_m_per_n,
                is_measured: false,
                at_force_n: 0.0,
            },
        }
    }

    /// Updates how the payload's error acts, with the direction of gravity in tool axes.
    pub(super) fn turn_payload(&mut self, gravity: &Vector3<f64>) {
        let payload = &mut self.payload;
        payload.leverage = gravity - *payload.gravity_at_tare.get_or_insert(*gravity);
    }

    /// Force on the tool without bias, payload weight error and the sensor's rotation, tool axes,
    /// N.
    pub(super) fn force_in_tool(&self, motion: &Motion) -> Vector3<f64> {
        let force = motion.force_in_tool
            - self.surface.bias
            - self.payload.leverage * self.surface.weight_n;
        force - self.surface.rotation.cross(&force)
    }

    /// Whether a tool in contact still reads the force along its axis with which it pressed, N.
    pub(super) fn is_held(&self, read_n: f64) -> bool {
        self.phase != ContactPhase::Free && read_n > HELD_SHARE * self.touch.held_n
    }

    /// Standard deviation that the zero of the force has by its age, N.
    pub(super) fn zero_sd_n(&self, config: &EstimatorConfig, motion: &Motion) -> f64 {
        let s = &config.sensing;
        let drift_n2 = s.force_bias_drift_n_per_sqrt_s.powi(2) * motion.bias_age_s;
        (s.force_bias_sd_n.powi(2) + drift_n2).sqrt()
    }

    /// Force on the tool without bias and payload weight error, world axes, N.
    pub(super) fn force(&self, motion: &Motion) -> Vector3<f64> {
        motion.rotation * self.force_in_tool(motion)
    }

    /// Resets what is counted from touchdown.
    pub(super) fn begin_contact(&mut self, motion: &Motion, pressing_n: f64) {
        self.touch = Touchdown {
            point: motion.point_lagged,
            force_n: pressing_n,
            held_n: -motion.force_in_tool.z,
            pressing_information: 0.0,
            pressed_s: 0.0,
            is_beside: false,
        };
    }

    pub fn phase(&self) -> ContactPhase {
        self.phase
    }

    /// Tangent frame of the normal at the tool's origin, at the time of the wrench.
    pub fn frame(&self) -> &TangentFrame {
        &self.surface.frame
    }

    /// Shape operator in tangent axes, 1/m.
    pub fn shape(&self) -> &Matrix2<f64> {
        &self.surface.shape
    }

    /// Unit direction of sliding in the tangent plane, world axes; zero before the tool has slid.
    pub fn slide_direction(&self) -> Vector3<f64> {
        self.slide.direction
    }

    /// Centre of pressure relative to the tool's origin, world axes, m.
    pub fn centre(&self) -> Vector3<f64> {
        self.centre.position
    }

    /// Standard deviation of the centre of pressure per axis, m.
    pub fn centre_sd_m(&self) -> f64 {
        self.centre.sd_m
    }

    /// Pressing force along the normal, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }
}

impl SurfaceState {
    fn new(config: &EstimatorConfig) -> Self {
        let mut covariance = SMatrix::zeros();
        for i in BIAS..BIAS + 3 {
            covariance[(i, i)] = config.sensing.force_bias_sd_n.powi(2);
        }
        covariance[(WEIGHT, WEIGHT)] = config.sensing.payload_error_n.powi(2);
        for i in ROTATION..ROTATION + 3 {
            covariance[(i, i)] = config.sensing.rotation_sd_rad.powi(2);
        }
        covariance[(FRICTION, FRICTION)] = config.surface.friction_sd.powi(2);
        for (axis, sd_m) in TIP_SD_M.into_iter().enumerate() {
            covariance[(TIP + axis, TIP + axis)] = sd_m.powi(2);
        }
        Self {
            frame: TangentFrame::new(Vector3::z(), Vector3::x()),
            shape: Matrix2::zeros(),
            friction: config.surface.friction_initial,
            bias: Vector3::zeros(),
            weight_n: 0.0,
            rotation: Vector3::zeros(),
            height_m: 0.0,
            give_m_per_n: Vector2::repeat(config.sensing.compliance_m_per_n),
            give_across_most_m_per_n: COMPLIANCE_M_PER_N.1,
            tip_m: Vector3::zeros(),
            covariance,
            news: CurvatureNews::default(),
        }
    }

    /// Adds the drift of the bias over a time (s).
    pub fn add_bias_drift(&mut self, config: &EstimatorConfig, time_s: f64) {
        let q = config.sensing.force_bias_drift_n_per_sqrt_s.powi(2) * time_s;
        for i in BIAS..BIAS + 3 {
            self.covariance[(i, i)] += q;
        }
    }

    /// Keeps the bias within what a zero of the age `age_s` (s) can have: a larger one is a force
    /// that the model does not explain, and would hide a contact.
    pub fn bound_bias(&mut self, config: &EstimatorConfig, age_s: f64) {
        let s = &config.sensing;
        let variance = s.force_bias_sd_n.powi(2) + s.force_bias_drift_n_per_sqrt_s.powi(2) * age_s;
        let bound = BIAS_SDS * variance.sqrt();
        let length = self.bias.norm();
        if length > bound {
            self.bias *= bound / length;
        }
    }

    /// Forgets a bias that says that a pressing tool does not press, and the friction with it: the
    /// zero has the standard deviation `sd_n`, N.
    pub fn deny_bias(&mut self, config: &EstimatorConfig, sd_n: f64) {
        self.bias = Vector3::zeros();
        for axis in 0..3 {
            self.restart(BIAS + axis, sd_n.powi(2));
        }
        self.restart(FRICTION, config.surface.friction_sd.powi(2));
    }

    /// Gives one state a new variance, without correlation with the others.
    pub fn restart(&mut self, i: usize, variance: f64) {
        self.covariance.row_mut(i).fill(0.0);
        self.covariance.column_mut(i).fill(0.0);
        self.covariance[(i, i)] = variance;
    }

    /// Resets normal and shape to the tool's axis and a flat surface, as at a first touchdown.
    pub fn forget_normal(&mut self, config: &EstimatorConfig, motion: &Motion) {
        self.frame =
            TangentFrame::new(-motion.rotation.column(2), motion.rotation.column(0).into());
        self.shape = Matrix2::zeros();
        for i in NORMAL..SHAPE {
            self.restart(i, config.contact.approach_misalignment_sd_rad.powi(2));
        }
        let curvature = config.surface.curvature_sd_per_m.powi(2);
        self.restart(SHAPE, curvature);
        self.restart(SHAPE + 1, curvature);
        self.restart(SHAPE + 2, 0.5 * curvature);
    }

    /// Propagates the covariance over a displacement `d` (tangent axes, m), with `height_row` the
    /// derivative of the height's change by the states.
    pub fn propagate(&mut self, d: &Vector2<f64>, height_row: &Row) {
        // Only the rows of height and normal differ from the identity. The height comes first: it
        // follows from the normal before the step.
        let p = &mut self.covariance;
        let height = p.row(HEIGHT) + height_row.transpose() * *p;
        p.set_row(HEIGHT, &height);
        let first = p.row(NORMAL) + p.row(SHAPE) * d.x + p.row(SHAPE + 2) * d.y;
        let second = p.row(NORMAL + 1) + p.row(SHAPE + 1) * d.y + p.row(SHAPE + 2) * d.x;
        p.set_row(NORMAL, &first);
        p.set_row(NORMAL + 1, &second);
        let height = p.column(HEIGHT) + *p * height_row;
        p.set_column(HEIGHT, &height);
        let first = p.column(NORMAL) + p.column(SHAPE) * d.x + p.column(SHAPE + 2) * d.y;
        let second = p.column(NORMAL + 1) + p.column(SHAPE + 1) * d.y + p.column(SHAPE + 2) * d.x;
        p.set_column(NORMAL, &first);
        p.set_column(NORMAL + 1, &second);
    }

    /// Updates mean and covariance with one scalar measurement. Beyond `huber_sd` standard
    /// deviations it gets less weight, so that a seam does not upset the state.
    pub fn correct(
        &mut self,
        huber_sd: f64,
        row: &Row,
        innovation: f64,
        variance: f64,
        friction_max: f64,
    ) {
        let gain = self.covariance * row;
        let mut total = row.dot(&gain) + variance;
        // A measurement without information, as after a step of almost no time.
        if !total.is_finite() {
            return;
        }
        let excess = innovation.abs() / (huber_sd * total.sqrt());
        if excess > 1.0 {
            total *= excess;
        }
        let gain = gain / total;
        let change = gain * innovation;
        let of_shape = gain.fixed_rows::<3>(SHAPE).into_owned();
        self.news.add(&of_shape, innovation, total);
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
        self.add(&change, friction_max);
    }

    /// Adds `change` to the mean, within the states' bounds.
    pub fn add(&mut self, change: &Row, friction_max: f64) {
        self.frame = self.frame.turned(&Vector2::new(change[0], change[1]));
        self.shape.m11 += change[SHAPE];
        self.shape.m22 += change[SHAPE + 1];
        self.shape.m12 += change[SHAPE + 2];
        self.shape.m21 = self.shape.m12;
        self.friction = (self.friction + change[FRICTION]).clamp(0.0, friction_max);
        self.bias += change.fixed_rows::<3>(BIAS);
        self.weight_n += change[WEIGHT];
        self.rotation += change.fixed_rows::<3>(ROTATION);
        self.height_m += change[HEIGHT];
        let (least, most) = COMPLIANCE_M_PER_N;
        let give = self.give_m_per_n + change.fixed_rows::<2>(GIVE);
        let most_across = self.give_across_most_m_per_n;
        self.give_m_per_n =
            Vector2::new(give.x.clamp(least, most), give.y.clamp(least, most_across));
        self.tip_m += change.fixed_rows::<3>(TIP);
    }
}

//! What the controller takes and gives, once per robot cycle.

use nalgebra::{Matrix3, Vector3};
use tangent_estimation::NormalEstimate;
use tangent_mechanics::{Aligned, Base, Joints, Pose, Tool, Twist, Wrench};
use tangent_schemas::CommandKind;
use tangent_sensing::{BaseMotion, Validity};

use crate::{Clearance, Fault, Phase, SwitchCause};

/// A period outside these is a mistake, s.
const PERIOD_S: std::ops::RangeInclusive<f64> = 1e-5..=0.1;
/// No joint turns further, rad.
const POSITION_MAX_RAD: f64 = 100.0;
/// Nothing that an arm touches is further from its base, m.
const PLACE_MAX_M: f64 = 1000.0;
/// No direction is known less well, rad².
const VARIANCE_MAX: f64 = 100.0;
/// No surface that a tool can wipe bends more sharply, 1/m.
const CURVATURE_MAX_PER_M: f64 = 1e4;
/// No sensor feels more, N and Nm.
const WRENCH_MAX: f64 = 1e6;
/// No joint turns faster, rad/s, and no tool moves faster, m/s.
const SPEED_MAX_RAD_PER_S: f64 = 100.0;

/// Whether a law can compute with this cycle's clock, s, and its period, s: neither is a matter of
/// the arm, and no time-out runs on one that is no number.
pub(crate) fn is_time(time_s: f64, dt_s: f64) -> bool {
    time_s.is_finite() && PERIOD_S.contains(&dt_s)
}

/// Whether these can be an arm's joints, rad and rad/s: finite, and not so large that what follows
/// from them is not.
pub(crate) fn is_arm_state<const N: usize>(q: &Joints<N>, qd: &Joints<N>) -> bool {
    within(q.as_slice(), POSITION_MAX_RAD) && within(qd.as_slice(), SPEED_MAX_RAD_PER_S)
}

/// Whether this can be a pose near an arm, `translation` m: what is finite but beyond all reach
/// overflows further on.
pub(crate) fn is_place<A, B>(pose: &Pose<A, B>) -> bool {
    within(pose.translation().as_slice(), PLACE_MAX_M)
        && (pose.rotation().coords.norm() - 1.0).abs() < 1e-6
}

/// Whether this can be a tool's velocity, m/s and rad/s.
pub(crate) fn is_velocity<F>(twist: &Twist<F>) -> bool {
    within(twist.linear.as_slice(), SPEED_MAX_RAD_PER_S)
        && within(twist.angular.as_slice(), SPEED_MAX_RAD_PER_S)
}

/// Whether this can be a point near an arm, m.
pub(crate) fn is_point(point: &Vector3<f64>) -> bool {
    within(point.as_slice(), PLACE_MAX_M)
}

/// Whether this can be the covariance of a direction, rad²: symmetric, not negative in any
/// direction, and not beyond all doubt.
pub(crate) fn is_covariance(c: &Matrix3<f64>) -> bool {
    if !within(c.as_slice(), VARIANCE_MAX) {
        return false;
    }
    let rounding = 1e-9 * (1.0 + c.trace().abs());
    (0..3).all(|i| {
        let j = (i + 1) % 3;
        let minor = c[(i, i)] * c[(j, j)] - c[(i, j)] * c[(j, i)];
        c[(i, i)] >= -rounding
            && (c[(i, j)] - c[(j, i)]).abs() <= rounding
            && minor >= -rounding * (1.0 + c.trace().abs())
    })
}

/// Whether this can be how a surface bends, 1/m.
pub(crate) fn is_curvature(c: &Matrix3<f64>) -> bool {
    within(c.as_slice(), CURVATURE_MAX_PER_M)
}

/// Whether this can be a wrench that a sensor feels, N and Nm: what is finite but beyond every
/// sensor overflows further on.
pub(crate) fn is_wrench<F>(wrench: &Wrench<F>) -> bool {
    within(wrench.force.as_slice(), WRENCH_MAX) && within(wrench.torque.as_slice(), WRENCH_MAX)
}

/// Also false for what is no number.
fn within(values: &[f64], most: f64) -> bool {
    values.iter().all(|x| x.abs() <= most)
}

/// Estimators that a task can name.
pub const MAX_ESTIMATORS: usize = 8;

/// One estimator's newest estimate.
#[derive(Clone, Copy, Debug)]
pub struct EstimateInput {
    /// What it says.
    pub estimate: NormalEstimate,
    /// How old it is now, s.
    pub age_s: f64,
}

/// How far the reading, before any zero is taken off and without the payload, is from an unloaded
/// sensor: no zero hides a load in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UntaredLoad {
    /// Force beyond the last good zero, N; none without one.
    pub beyond_reference_n: Option<f64>,
    /// Largest share of the sensor's rating in any axis; none where that is not known.
    pub rated_share: Option<f64>,
}

/// One cycle as the controller sees it. Frames and signs as in DESIGN: the wrench is what the
/// environment does to the tool, so a pressing tool reads a negative z.
#[derive(Clone, Copy, Debug)]
pub struct ControlInput {
    /// Time of this cycle, s, on any clock that does not jump.
    pub time_s: f64,
    /// Nominal period, s.
    pub dt_s: f64,
    /// Measured joint positions, rad.
    pub q: Joints<6>,
    /// Measured joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Measured tool pose.
    pub base_from_tool: Pose<Base, Tool>,
    /// Measured velocity of the tool's origin, base axes.
    pub twist: Twist<Aligned<Tool, Base>>,
    /// Speed scaling in force on the robot, 0 to 1.
    pub speed_scaling: f64,
    /// Whether a command would move the arm now.
    pub arm_ready: bool,
    /// Conditioned wrench at the tool.
    pub wrench: Wrench<Tool>,
    /// Whether to use it.
    pub wrench_validity: Validity,
    /// How old it is now, s.
    pub wrench_age_s: f64,
    /// Delay of its filter, s.
    pub wrench_delay_s: f64,
    /// Age of the tare in force, s; none if there was never one.
    pub bias_age_s: Option<f64>,
    /// Error of the zero that its age implies, N; none where that is not known.
    pub zero_bound_n: Option<f64>,
    /// The reading before any zero was taken off; none where the sensor's service does not tell.
    pub untared: Option<UntaredLoad>,
    /// Newest estimates, in the order of [`crate::Controller::estimators`].
    pub estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// How the base moves now; none where it stands for good.
    pub base: Option<BaseMotion>,
}

/// One cycle's command and everything that `ControlState` publishes.
#[derive(Clone, Copy, Debug)]
pub struct ControlOutput {
    /// Kind of command.
    pub kind: CommandKind,
    /// Joint velocities, rad/s.
    pub qd: Joints<6>,
    /// Bound on joint acceleration for this cycle, rad/s².
    pub acceleration: f64,
    /// The tool's velocity that `qd` stands for, base axes.
    pub twist_commanded: Twist<Aligned<Tool, Base>>,
    /// Phase after this cycle.
    pub phase: Phase,
    /// Counts task starts.
    pub activation: u64,
    /// Index in [`crate::Controller::estimators`] of the one in use.
    pub estimator: usize,
    /// Why that one.
    pub estimator_cause: SwitchCause,
    /// Changes of it since the task started.
    pub estimator_switches: u32,
    /// Normal in use, base axes, out of the material.
    pub normal: Vector3<f64>,
    /// Pressing force asked for along the normal, N.
    pub force_reference_n: f64,
    /// Pressing force measured along the normal, N; none where no wrench can be used.
    pub force_n: Option<f64>,
    /// Wrench used, tool axes; none when there is none to use.
    pub wrench: Option<Wrench<Tool>>,
    /// Whether the tool may touch something. The next start goes by it, whichever controller makes
    /// it.
    pub clearance: Clearance,
    /// The zero in force turned out to be taken in contact: the caller has the sensor's service
    /// take it back.
    pub zero_withdrawn: bool,
    /// Where the path wants the tool's origin, base axes, m.
    pub path_reference: Vector3<f64>,
    /// Distance from it in the tangent plane, m.
    pub path_error_m: f64,
    /// 0 to 1.
    pub path_progress: f64,
    /// Angle between the normal in use and `-z_tool`, rad.
    pub alignment_error_rad: f64,
    /// Age of the wrench used, s.
    pub wrench_age_s: f64,
    /// Age of the estimate in use, s; -1 without one.
    pub estimate_age_s: f64,
    /// Age of the base's pose in use, s; -1 where the base stands for good.
    pub base_age_s: f64,
    /// `sqrt(det(J Jᵀ))` at the tool.
    pub manipulability: f64,
    /// Contact losses since the task started.
    pub contact_lost_count: u32,
    /// The tool touches the surface, by the force.
    pub in_contact: bool,
    /// A tare is due now: the caller asks for one, and keeps the arm's state coming.
    pub tare_requested: bool,
    /// Contact stiffness in use, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the admittance in use along the normal, Ns/m.
    pub damping_n_s_per_m: f64,
    /// Energy that may still be put into the surface, J; none where nothing bounds it.
    pub force_tank_j: Option<f64>,
    /// The last fault since the task started.
    pub fault: Option<Fault>,
}

impl ControlOutput {
    /// Nothing to do: the arm stands still, the tool's own axis for a normal.
    pub fn hold(input: &ControlInput) -> Self {
        // What is said is a number even where the arm's pose is none.
        let (normal, path_reference) = if is_place(&input.base_from_tool) {
            let tool = &input.base_from_tool;
            (-tool.z_axis(), tool.translation())
        } else {
            (Vector3::z(), Vector3::zeros())
        };
        Self {
            kind: CommandKind::Hold,
            qd: Joints::<6>::zeros(),
            acceleration: 0.0,
            twist_commanded: Twist::zero(),
            phase: Phase::Idle,
            activation: 0,
            estimator: 0,
            estimator_cause: SwitchCause::Task,
            estimator_switches: 0,
            normal,
            force_reference_n: 0.0,
            force_n: None,
            wrench: None,
            clearance: Clearance::Assumed,
            zero_withdrawn: false,
            path_reference,
            path_error_m: 0.0,
            path_progress: 0.0,
            alignment_error_rad: 0.0,
            wrench_age_s: input.wrench_age_s,
            estimate_age_s: -1.0,
            base_age_s: input.base.map_or(-1.0, |base| base.age_s),
            manipulability: 0.0,
            contact_lost_count: 0,
            in_contact: false,
            tare_requested: false,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            force_tank_j: None,
            fault: None,
        }
    }
}

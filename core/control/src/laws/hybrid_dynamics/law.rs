//! The law itself: resolved accelerations, eqs. (30)-(32), and the torques that produce them.

use nalgebra::{Matrix3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Arm, Base, Flange, JointFriction, Joints, Pose, Tool};

use super::{ForceChannel, ForceGains, HybridDynamicsConfig, MotionGains};
use crate::laws::stacked::stacked;
use crate::limits::joint_guard::{bounded_acceleration, bounded_torque};
use crate::limits::{Limits, clamp_norm};

/// Bound of the accelerations from the integral of eq. (31): linear, m/s², and angular, rad/s².
const INTEGRAL_MAX_M_PER_S2: f64 = 2.0;
const INTEGRAL_MAX_RAD_PER_S2: f64 = 20.0;

/// State of the arm in one period: everything that follows from q and q̇ alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct ArmNow<const N: usize> {
    pub q: Joints<N>,
    pub qd: Joints<N>,
    pub tool: Pose<Base, Tool>,
    pub jacobian: SMatrix<f64, 6, N>,
    /// Mass matrix, and torques against gravity and Coriolis forces, Nm.
    pub dynamics: (SMatrix<f64, N, N>, Joints<N>),
    /// J̇ q̇
    pub drift: Vector6<f64>,
    /// Linear velocity of the tip, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity of the tip, rad/s.
    pub angular: Vector3<f64>,
}

impl<const N: usize> ArmNow<N> {
    pub fn new(
        model: &Arm<N>,
        flange_from_tool: &Pose<Flange, Tool>,
        q: &Joints<N>,
        qd: &Joints<N>,
    ) -> Self {
        let (tool, jacobian) = model.tool_and_jacobian(q, flange_from_tool);
        let twist = jacobian * qd;
        Self {
            q: *q,
            qd: *qd,
            tool,
            jacobian,
            dynamics: model.mass_matrix_and_bias(q, qd),
            drift: model.jacobian_dot_at(q, qd, flange_from_tool) * qd,
            linear: twist.fixed_rows::<3>(0).into_owned(),
            angular: twist.fixed_rows::<3>(3).into_owned(),
        }
    }
}

/// Reference motion of the tool, base axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionReference {
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    pub angular: Vector3<f64>,
}

impl MotionReference {
    pub fn at_rest(pose: &Pose<Base, Tool>) -> Self {
        Self {
            position: pose.translation(),
            velocity: Vector3::zeros(),
            acceleration: Vector3::zeros(),
            rotation: pose.rotation(),
            angular: Vector3::zeros(),
        }
    }
}

/// The constraint φ = 0 under the tip, base axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constraint {
    /// Unit, out of the material.
    pub normal: Vector3<f64>,
    /// Hessian of φ divided by the norm of its gradient, 1/m.
    pub hessian: Matrix3<f64>,
    /// Velocity of the surface point, m/s.
    pub velocity: Vector3<f64>,
}

/// State of eq. (31)'s integral.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MotionIntegral {
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

impl MotionIntegral {
    /// Removes the component along `normal` (unit): the force is controlled there, and a position
    /// error has no meaning.
    pub fn forget_along(&mut self, normal: &Vector3<f64>) {
        self.linear -= normal * normal.dot(&self.linear);
    }
}

/// State of eq. (32).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ForceIntegral {
    /// The integral, N.
    value_n: f64,
}

impl ForceIntegral {
    fn step(&mut self, gains: &ForceGains, error_n: f64, dt_s: f64) {
        let grown = self.value_n + gains.integral_per_s * error_n * dt_s;
        self.value_n = grown.clamp(-gains.integral_max_n, gains.integral_max_n);
    }
}

/// Accelerations (m/s², then rad/s²) of eq. (31), the motion controller, in all six directions.
pub(super) fn motion_acceleration<const N: usize>(
    gains: &MotionGains,
    integral: &mut MotionIntegral,
    now: &ArmNow<N>,
    reference: &MotionReference,
    dt_s: f64,
) -> Vector6<f64> {
    let away = reference.position - now.tool.translation();
    let turn = (reference.rotation * now.tool.rotation().inverse()).scaled_axis();
    let gain = gains.integral_per_s3 * dt_s;
    integral.linear = clamp_norm(integral.linear + away * gain, INTEGRAL_MAX_M_PER_S2);
    integral.angular = clamp_norm(integral.angular + turn * gain, INTEGRAL_MAX_RAD_PER_S2);
    let linear = reference.acceleration
        + (reference.velocity - now.linear) * gains.position_damping_per_s
        + away * gains.position_per_s2
        + integral.linear;
    let angular = (reference.angular - now.angular) * gains.orientation_damping_per_s
        + turn * gains.orientation_per_s2
        + integral.angular;
    stacked(&linear, &angular)
}

/// Command of the hybrid law: an acceleration of the tool, and torques that push.
pub(super) struct HybridCommand<const N: usize> {
    pub acceleration: Vector6<f64>,
    pub push: Joints<N>,
}

/// Eqs. (30)-(32). `motion` is eq. (31) for all directions, of which those along the surface are
/// kept; `pressing_n` and `wanted_n` are -λ and -λ_d; `force` and `moment` are the wrench of the
/// environment on the tip, base axes, N and Nm.
#[allow(clippy::too_many_arguments)]
pub(super) fn hybrid<const N: usize>(
    gains: &ForceGains,
    integral: &mut ForceIntegral,
    now: &ArmNow<N>,
    constraint: &Constraint,
    motion: &Vector6<f64>,
    wanted_n: f64,
    pressing_n: f64,
    wrench: &Vector6<f64>,
    dt_s: f64,
) -> HybridCommand<N> {
    let n = &constraint.normal;
    let error_n = wanted_n - pressing_n;
    integral.step(gains, error_n, dt_s);
    let relative = now.linear - constraint.velocity;
    let along = n.dot(&relative);
    // r̈_F = nᵀ p̈ + ṗᵀ H ṗ: on a curved surface the tip must accelerate to stay on it.
    let mut normal_acceleration =
        -relative.dot(&(constraint.hessian * relative)) - gains.damping_per_s * along;
    let push = match gains.channel {
        ForceChannel::Torque => {
            let jphi = now.jacobian.fixed_rows::<3>(0).tr_mul(n);
            jphi * -(wanted_n + integral.value_n)
        }
        ForceChannel::Acceleration => {
            normal_acceleration -= gains.error_per_kg * (error_n + integral.value_n);
            -now.jacobian.tr_mul(wrench)
        }
    };
    let linear = motion.fixed_rows::<3>(0).into_owned();
    let across = linear - n * n.dot(&linear);
    let angular = motion.fixed_rows::<3>(3).into_owned();
    HybridCommand {
        acceleration: stacked(&(across + n * normal_acceleration), &angular),
        push,
    }
}

/// -λ of the paper, N: J_φ† Jᵀ h with the unit normal for φ's gradient.
pub(super) fn pressing_force<const N: usize>(
    now: &ArmNow<N>,
    normal: &Vector3<f64>,
    force: &Vector3<f64>,
) -> f64 {
    let at_tip = now.jacobian.fixed_rows::<3>(0);
    let jphi: Joints<N> = at_tip.tr_mul(normal);
    jphi.dot(&at_tip.tr_mul(force)) / jphi.norm_squared().max(1e-9)
}

/// Torques that compensate the modelled friction of the joints, Nm.
pub(super) fn friction_torque<const N: usize>(
    cell: &Limits,
    config: &HybridDynamicsConfig,
    friction: &JointFriction<N>,
    now: &ArmNow<N>,
    reference_twist: &Vector6<f64>,
) -> Joints<N> {
    if !config.friction_at_reference {
        return friction.torque(&now.qd);
    }
    let inverse = inverse_of(cell, now);
    friction.torque(&inverse.map_or_else(Joints::zeros, |i| i * reference_twist))
}

/// Torques for an acceleration of the tool, and whether a limit cut them: τ = B J⁻¹ (a - J̇ q̇) + C
/// q̇ + g + friction + push. `rubbed` are those against friction, Nm.
pub(super) fn torque<const N: usize>(
    model: &Arm<N>,
    cell: &Limits,
    config: &HybridDynamicsConfig,
    now: &ArmNow<N>,
    acceleration: &Vector6<f64>,
    rubbed: &Joints<N>,
    push: &Joints<N>,
) -> (Joints<N>, bool) {
    let (mass, bias) = now.dynamics;
    let inverse = inverse_of(cell, now);
    let solve = |twist: &Vector6<f64>| inverse.map_or_else(Joints::zeros, |i| i * twist);
    let mut wanted = solve(&(acceleration - now.drift));
    if N > 6 {
        // q̈ of the least norm leaves the null-space motion as it is: without damping, a redundant
        // joint would drift.
        let spare = now.qd - solve(&(now.jacobian * now.qd));
        wanted -= spare * config.motion.orientation_damping_per_s;
    }
    let (qdd, cut) = bounded_acceleration(model.limits(), cell, &now.q, &now.qd, &wanted);
    let (torque, left) = bounded_torque(model.limits(), &(bias + push), &(mass * qdd + rubbed));
    (torque, cut || left < 1.0)
}

fn inverse_of<const N: usize>(cell: &Limits, now: &ArmNow<N>) -> Option<SMatrix<f64, N, 6>> {
    let singularity = &cell.singularity;
    damped_inverse(
        &now.jacobian,
        singularity.damping_max,
        singularity.threshold,
    )
}

/// Jᵀ (J Jᵀ + λ² I)⁻¹, λ² = λ_max² (1 - w/w₀)² below a manipulability of w₀ (Nakamura, Hanafusa
/// 1986). Without damping it is the pseudo-inverse, and for six joints the plain inverse.
fn damped_inverse<const N: usize>(
    jacobian: &SMatrix<f64, 6, N>,
    damping_max: f64,
    threshold: f64,
) -> Option<SMatrix<f64, N, 6>> {
    let manipulability = manipulability(jacobian);
    let mut square = jacobian * jacobian.transpose();
    // In metres and radians the smallest singular value is the manipulability over the product of
    // the others, which is near 1.
    if manipulability < threshold * 0.5 {
        let share = 1.0 - manipulability / (threshold * 0.5);
        square += Matrix6::identity() * ((damping_max * share).powi(2) + 1e-9);
    } else if N == 6 {
        let inverse = jacobian.fixed_view::<6, 6>(0, 0).try_inverse()?;
        return Some(SMatrix::from_fn(|i, j| inverse[(i, j)]));
    }
    let mut inverse = SMatrix::<f64, N, 6>::zeros();
    for i in 0..6 {
        let unit = Vector6::from_fn(|j, _| f64::from(i == j));
        let column = solve_positive_definite(&square, &unit)?;
        inverse.set_column(i, &jacobian.tr_mul(&column));
    }
    Some(inverse)
}

/// `sqrt(det(J Jᵀ))`; for six joints |det J|, which is the same at less cost.
pub(super) fn manipulability<const N: usize>(jacobian: &SMatrix<f64, 6, N>) -> f64 {
    if N == 6 {
        jacobian
            .fixed_view::<6, 6>(0, 0)
            .into_owned()
            .determinant()
            .abs()
    } else {
        (jacobian * jacobian.transpose())
            .determinant()
            .max(0.0)
            .sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::presets::Presets;
    use proptest::prelude::*;
    use tangent_mechanics::ModelData;

    fn arm() -> Arm<6> {
        Arm::new(&ModelData::builtin("smart3s_substitute").unwrap()).unwrap()
    }

    fn now(arm: &Arm<6>, q: [f64; 6], qd: [f64; 6]) -> ArmNow<6> {
        let tool = Pose::new(Vector3::new(0.0, 0.0, 0.25), UnitQuaternion::identity());
        let q = arm.home() + Joints::<6>::from(q);
        ArmNow::new(arm, &tool, &q, &qd.into())
    }

    proptest! {
        #[test]
        fn the_arm_accelerates_as_asked(q in prop::array::uniform6(-0.2f64..0.2), qd in prop::array::uniform6(-0.1f64..0.1), a in prop::array::uniform6(-0.5f64..0.5)) {
            let arm = arm();
            let now = now(&arm, q, qd);
            let (config, cell) = (HybridDynamicsConfig::default(), Limits::default());
            let (torque, cut) = torque(&arm, &cell, &config, &now, &a.into(), &Joints::zeros(), &Joints::zeros());
            prop_assert!(!cut);
            let qdd = arm.forward_dynamics(&now.q, &now.qd, &torque);
            let reached = now.jacobian * qdd + now.drift;
            prop_assert!((reached - Vector6::from(a)).amax() < 1e-8);
        }

        #[test]
        fn a_force_error_moves_only_along_the_normal(q in prop::array::uniform6(-0.2f64..0.2), n in prop::array::uniform3(-1.0f64..1.0), force in 1.0f64..30.0) {
            // Against a real contact force: the tip accelerates along the normal by the error, and
            // in no other direction.
            let n = Vector3::from(n) + Vector3::z() * 2.0;
            let n = n.normalize();
            let arm = arm();
            let now = now(&arm, q, [0.0; 6]);
            let (config, cell) = (HybridDynamicsConfig::default(), Limits::default());
            let constraint = Constraint { normal: n, hessian: Matrix3::zeros(), velocity: Vector3::zeros() };
            let h = stacked(&(n * force), &Vector3::zeros());
            let gains = ForceGains { integral_per_s: 0.0, ..config.force };
            prop_assert!((pressing_force(&now, &n, &(n * force)) - force).abs() < 1e-9);
            let command = hybrid(&gains, &mut ForceIntegral::default(), &now, &constraint, &Vector6::zeros(), 20.0, force, &h, 1e-3);
            let (torque, _) = torque(&arm, &cell, &config, &now, &command.acceleration, &Joints::zeros(), &command.push);
            let qdd = arm.forward_dynamics(&now.q, &now.qd, &(torque + now.jacobian.tr_mul(&h)));
            let reached = now.jacobian * qdd + now.drift;
            let expected = stacked(&(n * (gains.error_per_kg * (force - 20.0))), &Vector3::zeros());
            prop_assert!((reached - expected).amax() < 1e-8, "{reached} {expected}");
        }

        #[test]
        fn the_published_law_in_balance_with_the_contact_does_not_move(q in prop::array::uniform6(-0.2f64..0.2)) {
            let n = Vector3::new(0.1, -0.2, 1.0).normalize();
            let arm = arm();
            let now = now(&arm, q, [0.0; 6]);
            let config = HybridDynamicsConfig::preset("paper").unwrap();
            let cell = Limits::default();
            let constraint = Constraint { normal: n, hessian: Matrix3::zeros(), velocity: Vector3::zeros() };
            let h = stacked(&(n * 20.0), &Vector3::zeros());
            let command = hybrid(&config.force, &mut ForceIntegral::default(), &now, &constraint, &Vector6::zeros(), 20.0, 20.0, &h, 1e-3);
            let (torque, _) = torque(&arm, &cell, &config, &now, &command.acceleration, &Joints::zeros(), &command.push);
            let qdd = arm.forward_dynamics(&now.q, &now.qd, &(torque + now.jacobian.tr_mul(&h)));
            prop_assert!(qdd.amax() < 1e-8);
        }
    }

    #[test]
    fn sliding_over_a_sphere_accelerates_towards_its_centre() {
        let arm = arm();
        let now = now(&arm, [0.1; 6], [0.1, -0.05, 0.08, 0.0, 0.1, 0.0]);
        let n = now.linear.cross(&Vector3::x()).normalize();
        let radius = 0.3;
        let constraint = Constraint {
            normal: n,
            hessian: (Matrix3::identity() - n * n.transpose()) / radius,
            velocity: Vector3::zeros(),
        };
        let gains = ForceGains::default();
        let command = hybrid(
            &gains,
            &mut ForceIntegral::default(),
            &now,
            &constraint,
            &Vector6::zeros(),
            20.0,
            20.0,
            &Vector6::zeros(),
            1e-3,
        );
        let expected = -now.linear.norm_squared() / radius;
        let along = n.dot(&command.acceleration.fixed_rows::<3>(0));
        assert!((along - expected).abs() < 1e-12);
    }

    #[test]
    fn near_a_singularity_the_inverse_stays_bounded() {
        let arm = arm();
        let q = Joints::<6>::from([0.4, 0.3, -1.3, 0.7, 0.0, -0.5]);
        let jacobian = arm.jacobian(&q);
        let inverse = damped_inverse(&jacobian, 0.04, 0.06).unwrap();
        assert!(inverse.amax() < 50.0, "{}", inverse.amax());
    }
}

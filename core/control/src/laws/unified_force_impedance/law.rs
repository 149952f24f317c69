//! The torques: eqs. (7)-(13), (31) and (73), grouped by the source of their energy.
//!
//! Signs. The wrench is that of the environment on the robot, so a pressing tool measures a
//! negative z in its own axes; the paper's f_d is the force of the robot on the environment, along
//! +z. The pressing force is therefore `p = -f_z`, and eq. (12)'s error enters eq. (11) as `f_d -
//! p`.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Arm, Base, Flange, Joints, Pose, Tool};

use super::config::{ForceLoopConfig, ImpedanceConfig, PostureConfig};
use crate::laws::stacked::stacked;

/// Regularizes the tool's inertia at a singularity, 1/kg.
const SINGULAR: f64 = 1e-6;
/// Maximum product of damping rate and delay: at π/2 a single mass would oscillate without end, and
/// an arm has less margin.
const DELAYED_DAMPING: f64 = 0.8;
/// Damping of the inverse Jacobian for the joint velocities of a reference.
const VELOCITY_DAMPING: f64 = 1e-5;

/// State of the arm in one period: everything that follows from q and q̇ alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct ArmNow<const N: usize> {
    pub q: Joints<N>,
    pub qd: Joints<N>,
    pub tool: Pose<Base, Tool>,
    pub jacobian: SMatrix<f64, 6, N>,
    /// Linear velocity of the tool's origin, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity of the tool, rad/s.
    pub angular: Vector3<f64>,
    pub gravity: Joints<N>,
    /// M⁻¹ Jᵀ
    mobility_columns: SMatrix<f64, N, 6>,
    /// J M⁻¹ Jᵀ: the inverse of eq. (4), without a pseudo-inverse.
    mobility: SMatrix<f64, 6, 6>,
}

impl<const N: usize> ArmNow<N> {
    pub fn new(
        model: &Arm<N>,
        flange_from_tool: &Pose<Flange, Tool>,
        q: &Joints<N>,
        qd: &Joints<N>,
    ) -> Self {
        let (tool, jacobian) = model.tool_and_jacobian(q, flange_from_tool);
        // At zero velocity the bias is gravity: Coriolis forces are not compensated, as in eq. (2).
        let (mass, gravity) = model.mass_matrix_and_bias(q, &Joints::zeros());
        let mut columns = SMatrix::<f64, N, 6>::zeros();
        for i in 0..6 {
            let row: SVector<f64, N> = jacobian.row(i).transpose();
            let column = solve_positive_definite(&mass, &row).unwrap_or_else(SVector::zeros);
            columns.set_column(i, &column);
        }
        let twist = jacobian * qd;
        Self {
            q: *q,
            qd: *qd,
            tool,
            jacobian,
            linear: twist.fixed_rows::<3>(0).into_owned(),
            angular: twist.fixed_rows::<3>(3).into_owned(),
            gravity,
            mobility: jacobian * columns + SMatrix::identity() * SINGULAR,
            mobility_columns: columns,
        }
    }

    /// `sqrt(det(J Jᵀ))`.
    pub fn manipulability(&self) -> f64 {
        let square = (self.jacobian * self.jacobian.transpose()).determinant();
        square.max(0.0).sqrt()
    }

    /// Effective inertia along each of the tool's axes, then about each: kg, kg m².
    pub fn inertia(&self) -> [f64; 6] {
        let turn = self.tool.rotation().to_rotation_matrix();
        let block = |at: usize| -> Matrix3<f64> {
            turn.matrix().transpose() * self.mobility.fixed_view::<3, 3>(at, at) * turn.matrix()
        };
        let (linear, angular) = (block(0), block(3));
        std::array::from_fn(|i| {
            let mobility = if i < 3 {
                linear[(i, i)]
            } else {
                angular[(i - 3, i - 3)]
            };
            1.0 / mobility.max(SINGULAR)
        })
    }

    /// The wrench that accelerates the tool by `acceleration` (m/s², rad/s²): Λ a.
    pub fn wrench_for(&self, acceleration: &Vector6<f64>) -> Vector6<f64> {
        solve_positive_definite(&self.mobility, acceleration).unwrap_or_else(Vector6::zeros)
    }

    /// Part of `torque` that does not accelerate the tool: (I - Jᵀ Λ J M⁻¹) τ.
    pub fn unseen(&self, torque: &Joints<N>) -> Joints<N> {
        let seen = self.mobility_columns.tr_mul(torque);
        torque - self.jacobian.tr_mul(&self.wrench_for(&seen))
    }

    /// Part of q̇ that does not move the tool: (I - J⁺ J) q̇, rad/s.
    pub fn spare_velocity(&self) -> Joints<N> {
        self.qd - self.joint_velocity(&stacked(&self.linear, &self.angular))
    }

    /// Minimum-norm joint velocities for a twist of the tool, rad/s.
    pub fn joint_velocity(&self, twist: &Vector6<f64>) -> Joints<N> {
        let square = self.jacobian * self.jacobian.transpose()
            + SMatrix::<f64, 6, 6>::identity() * VELOCITY_DAMPING;
        self.jacobian
            .tr_mul(&solve_positive_definite(&square, twist).unwrap_or_else(Vector6::zeros))
    }

    /// Rotates a wrench from tool to base axes, both at the tool's origin.
    pub fn in_base(&self, wrench: &Vector6<f64>) -> Vector6<f64> {
        let r = self.tool.rotation();
        stacked(
            &(r * wrench.fixed_rows::<3>(0)),
            &(r * wrench.fixed_rows::<3>(3)),
        )
    }

    /// Rotates a vector from base to tool axes.
    pub fn in_tool(&self, vector: &Vector6<f64>) -> Vector6<f64> {
        let r = self.tool.rotation().inverse();
        stacked(
            &(r * vector.fixed_rows::<3>(0)),
            &(r * vector.fixed_rows::<3>(3)),
        )
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

/// x̃ of eq. (7) in tool axes, m and rad: deviation of the tool from its reference.
pub(super) fn pose_error<const N: usize>(
    now: &ArmNow<N>,
    wanted: &MotionReference,
) -> Vector6<f64> {
    let turn = (now.tool.rotation() * wanted.rotation.inverse()).scaled_axis();
    now.in_tool(&stacked(&(now.tool.translation() - wanted.position), &turn))
}

/// Diagonals of K and D in tool axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Impedance {
    pub stiffness: Vector6<f64>,
    pub damping: Vector6<f64>,
}

impl Impedance {
    /// `pressing`: the published K_max; otherwise all translations have the same stiffness. Damping
    /// follows the full stiffness, not the shaped one: an arm made compliant must stay damped. A
    /// damper that acts with the delay `delay_s` (s) excites oscillations if it is too strong for
    /// that delay, so the damping is limited.
    pub fn new<const N: usize>(
        config: &ImpedanceConfig,
        now: &ArmNow<N>,
        pressing: bool,
        delay_s: f64,
    ) -> Self {
        let inertia = now.inertia();
        let stiffness = Vector6::from_fn(|i, _| match (i, pressing) {
            (0..=2, true) => config.stiffness_n_per_m[i],
            (0..=2, false) => config.free_stiffness_n_per_m,
            _ => config.stiffness_nm_per_rad[i - 3],
        });
        let mut damping = Vector6::from_fn(|i, _| {
            2.0 * config.damping_ratio[i] * (stiffness[i] * inertia[i]).sqrt()
        });
        if pressing {
            damping[2] += config.normal_damping_n_s_per_m;
        }
        for i in 0..6 {
            damping[i] = damping[i].min(DELAYED_DAMPING * inertia[i] / delay_s);
        }
        Self { stiffness, damping }
    }
}

/// State of eq. (11).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ForceLoop {
    integral_n: f64,
    filtered_n: f64,
}

impl ForceLoop {
    /// Pushing force (N, along the tool's axis) for a desired and a measured pressing force.
    /// `shaped` is ρ_frc: an error that the shaping suppresses is not integrated.
    pub fn step(
        &mut self,
        config: &ForceLoopConfig,
        wanted_n: f64,
        pressing_n: f64,
        shaped: f64,
        dt_s: f64,
    ) -> f64 {
        let error = wanted_n - pressing_n;
        self.filtered_n += (error - self.filtered_n) * (dt_s / (config.filter_s + dt_s));
        let grown = self.integral_n + config.integral_per_s * error * shaped * dt_s;
        let most = config.integral_max_n;
        self.integral_n = grown.max(-most).min(most);
        wanted_n + config.proportional * self.filtered_n + self.integral_n
    }
}

/// Stiffness of the springs at the joints' end stops, Nm/rad.
const END_STIFFNESS_NM_PER_RAD: f64 = 400.0;

/// Torques of springs that begin at twice the cell's margin before the joints' end stops, Nm. The
/// springs are fixed, so they need no tank: they return the energy that they take.
pub(super) fn before_the_ends<const N: usize>(
    model: &Arm<N>,
    margin_rad: f64,
    q: &Joints<N>,
) -> Joints<N> {
    let limits = model.limits();
    Joints::from_fn(|i, _| {
        let above = (q[i] - limits.position_upper[i] + 2.0 * margin_rad).max(0.0);
        let below = (limits.position_lower[i] + 2.0 * margin_rad - q[i]).max(0.0);
        END_STIFFNESS_NM_PER_RAD * (below - above)
    })
}

/// Torques that keep the redundant joint away from its limits and damp the null-space motion.
pub(super) fn posture<const N: usize>(
    config: &PostureConfig,
    model: &Arm<N>,
    now: &ArmNow<N>,
) -> (Joints<N>, Joints<N>) {
    let limits = model.limits();
    let spring = Joints::from_fn(|i, _| {
        let half = 0.5 * (limits.position_upper[i] - limits.position_lower[i]);
        let middle = 0.5 * (limits.position_upper[i] + limits.position_lower[i]);
        let u = (now.q[i] - middle) / half;
        // Ten times as steep at the end stops as in the middle.
        -config.stiffness_nm_per_rad * half * u * (1.0 + 9.0 * u * u * u * u)
    });
    // (I - J⁺ J) is symmetric, so this dissipates power in every posture; the dynamically
    // consistent projector, which would not affect the tool at all, would not. The tool is affected
    // only while the redundant joint moves.
    let damper = -now.spare_velocity() * config.damping_nm_s_per_rad;
    (now.unseen(&spring), damper)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::ModelData;

    fn panda() -> Arm<7> {
        Arm::new(&ModelData::builtin("panda").unwrap()).unwrap()
    }

    fn now(arm: &Arm<7>, dq: [f64; 7], qd: [f64; 7]) -> ArmNow<7> {
        let tool = Pose::new(Vector3::new(0.0, 0.0, 0.12), UnitQuaternion::identity());
        let q = arm.home() + Joints::<7>::from(dq);
        ArmNow::new(arm, &tool, &q, &qd.into())
    }

    proptest! {
        #[test]
        fn the_posture_does_not_move_the_tool(dq in prop::array::uniform7(-0.3f64..0.3)) {
            let arm = panda();
            let now = now(&arm, dq, [0.0; 7]);
            let config = PostureConfig { stiffness_nm_per_rad: 20.0, damping_nm_s_per_rad: 1.0 };
            let (spring, _) = posture(&config, &arm, &now);
            let qdd = arm.forward_dynamics(&now.q, &now.qd, &(now.gravity + spring));
            let plain = posture(&config, &arm, &now).0.amax();
            prop_assert!((now.jacobian * qdd).amax() < 2e-3 * (1.0 + plain), "{}", now.jacobian * qdd);
        }

        #[test]
        fn the_dampers_never_give_power(dq in prop::array::uniform7(-0.3f64..0.3), qd in prop::array::uniform7(-1.0f64..1.0)) {
            let arm = panda();
            let now = now(&arm, dq, qd);
            let d = Impedance::new(&ImpedanceConfig::default(), &now, true, 2.5e-3).damping;
            let twist = now.in_tool(&stacked(&now.linear, &now.angular));
            let torque = now.jacobian.tr_mul(&now.in_base(&-d.component_mul(&twist)));
            prop_assert!(torque.dot(&now.qd) <= 1e-12);
            let spare = PostureConfig { stiffness_nm_per_rad: 0.0, damping_nm_s_per_rad: 5.0 };
            let (_, damper) = posture(&spare, &arm, &now);
            prop_assert!(damper.dot(&now.qd) <= 1e-12, "{}", damper.dot(&now.qd));
        }

        #[test]
        fn the_tool_accelerates_as_its_inertia_says(dq in prop::array::uniform7(-0.3f64..0.3), a in prop::array::uniform6(-1.0f64..1.0)) {
            let arm = panda();
            let now = now(&arm, dq, [0.0; 7]);
            let a = Vector6::from(a);
            let torque = now.gravity + now.jacobian.tr_mul(&now.wrench_for(&a));
            let qdd = arm.forward_dynamics(&now.q, &now.qd, &torque);
            prop_assert!((now.jacobian * qdd - a).amax() < 0.02);
        }
    }

    #[test]
    fn too_little_pressing_pushes_harder() {
        let config = ForceLoopConfig {
            filter_s: 0.0,
            ..ForceLoopConfig::default()
        };
        let mut force = ForceLoop::default();
        let push = force.step(&config, 15.0, 10.0, 1.0, 1e-3);
        assert!(push > 15.0);
        for _ in 0..100_000 {
            force.step(&config, 15.0, 0.0, 1.0, 1e-3);
        }
        assert!(force.integral_n <= config.integral_max_n);
    }
}

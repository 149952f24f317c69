//! The state that the robot sends in every cycle.

use nalgebra::Matrix4;
use tangent_franka::fci::{ControllerMode, MotionMode, MoveController, MoveGenerator, RobotState};
use tangent_mechanics::Joints;

use super::FciRobot;
use crate::settings::{column_major, matrix};

/// Number of answers over which the success rate is computed.
const RATE_WINDOW: u32 = 100;

impl FciRobot {
    /// State of the robot in this cycle.
    pub fn state(&self) -> RobotState {
        let reading = self.plant.reading();
        let base_from_flange = self.model.base_from_flange(&reading.q).matrix();
        let f_t_ee = matrix(&self.settings.ne_t_ee);
        let desired = self.model.base_from_flange(&self.q_d).matrix() * f_t_ee;
        let elbow = |q: &Joints<7>| [q[2], if q[3] < 0.0 { -1.0 } else { 1.0 }];
        let (motion_mode, controller) = match self.moving() {
            None => (MotionMode::Idle, ControllerMode::Other),
            Some(motion) => (
                match motion.generator {
                    MoveGenerator::JointPosition => MotionMode::JointPosition,
                    MoveGenerator::JointVelocity => MotionMode::JointVelocity,
                    MoveGenerator::CartesianPosition => MotionMode::CartesianPosition,
                    MoveGenerator::CartesianVelocity => MotionMode::CartesianVelocity,
                },
                match motion.controller {
                    MoveController::JointImpedance => ControllerMode::JointImpedance,
                    MoveController::CartesianImpedance => ControllerMode::CartesianImpedance,
                    MoveController::External => ControllerMode::External,
                },
            ),
        };
        let in_time = self.answered & ((1 << RATE_WINDOW) - 1);
        RobotState {
            message_id: self.message_id,
            o_t_ee: column_major(&(base_from_flange * f_t_ee)),
            o_t_ee_d: column_major(&desired),
            o_t_ee_c: column_major(&desired),
            f_t_ee: column_major(&f_t_ee),
            ee_t_k: self.settings.ee_t_k,
            f_t_ne: column_major(&Matrix4::identity()),
            ne_t_ee: self.settings.ne_t_ee,
            m_load: self.settings.load.mass_kg,
            i_load: self.settings.load.inertia_kg_m2,
            f_x_cload: self.settings.load.com_in_flange_m,
            elbow: elbow(&reading.q),
            elbow_d: elbow(&self.q_d),
            elbow_c: elbow(&self.q_d),
            tau_j: self.tau_motor.into(),
            tau_j_d: self.tau_d.into(),
            dtau_j: self.tau_motor_rate.into(),
            q: reading.q.into(),
            q_d: self.q_d.into(),
            dq: reading.qd.into(),
            dq_d: self.dq_d.into(),
            joint_contact: self.felt.joint_contact,
            cartesian_contact: self.felt.cartesian_contact,
            joint_collision: self.felt.joint_collision,
            cartesian_collision: self.felt.cartesian_collision,
            // The vendor's sign: wrench of the robot on the environment.
            tau_ext_hat_filtered: (-reading.external).into(),
            o_f_ext_hat_k: (-self.wrench_o).into(),
            k_f_ext_hat_k: (-self.wrench_k).into(),
            o_ddp_o: self.model.gravity_in_base().into(),
            theta: reading.q.into(),
            dtheta: reading.qd.into(),
            motion_generator_mode: motion_mode.number(),
            controller_mode: controller.number(),
            errors: self.errors,
            reflex_reason: self.reflex_reason,
            robot_mode: self.mode().number(),
            control_command_success_rate: if self.moving().is_some() {
                f64::from(in_time.count_ones()) / f64::from(RATE_WINDOW)
            } else {
                0.0
            },
            ..RobotState::default()
        }
    }
}

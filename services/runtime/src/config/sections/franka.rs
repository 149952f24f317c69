//! `[robot.franka]`: settings of the bridge to a Franka arm beyond `[robot]`. Lists per joint run
//! from base to flange; forces and moments are x, y, z and about x, y, z.

use serde::Deserialize;

use super::check_port;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Share of the robot's own limit on the torque rate that the bridge allows.
pub const FRANKA_TORQUE_RATE_SHARE: f64 = 0.9;
/// Largest delay of an answer that the law compensates, in periods of 1 ms.
const DELAY_PERIODS_MAX: usize = 8;

/// `[robot.franka]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrankaConfig {
    /// TCP port of the FCI.
    pub fci_port: u16,
    /// External joint torque from which the robot reports a contact, Nm.
    pub contact_torque_nm: [f64; 7],
    /// External joint torque at which the robot stops with a reflex, Nm.
    pub collision_torque_nm: [f64; 7],
    /// External force and moment from which the robot reports a contact, N, Nm.
    pub contact_force_n_nm: [f64; 6],
    /// External force and moment at which the robot stops with a reflex, N, Nm.
    pub collision_force_n_nm: [f64; 6],
    /// Stiffness with which the robot holds its pose without commands, Nm/rad.
    pub joint_impedance_nm_per_rad: [f64; 7],
    /// Inertia of the tool about its centre of mass, kg m²: about x, y, z.
    pub tool_inertia_kg_m2: [f64; 3],
    /// Share of a joint's largest torque that a command may use, 0 to 1.
    pub torque_share: f64,
    /// Number of 1 ms periods, beyond the current one, until the answer to a state takes effect.
    /// The law's energy tanks and dampers use it.
    pub delay_periods: usize,
    /// Stiffness with which the bridge holds the arm in a torque motion while no command moves it,
    /// Nm/rad.
    pub hold_stiffness_nm_per_rad: [f64; 7],
    /// Damping with which the bridge holds the arm in a torque motion while no command moves it, Nm
    /// s/rad.
    pub hold_damping_nm_s_per_rad: [f64; 7],
    /// Largest force that a tare may accept as the zero of the robot's wrench estimate, N.
    pub zero_max_n: f64,
    /// Largest difference between a new zero and the last good one, N in any axis. The error of the
    /// robot's estimate differs with the pose.
    pub zero_jump_max_n: f64,
    /// Largest difference between a new zero and the last good one, Nm about any axis.
    pub zero_jump_max_nm: f64,
}

impl Default for FrankaConfig {
    fn default() -> Self {
        Self {
            fci_port: 1337,
            contact_torque_nm: [15.0, 15.0, 15.0, 15.0, 8.0, 8.0, 8.0],
            collision_torque_nm: [40.0, 40.0, 40.0, 40.0, 12.0, 12.0, 12.0],
            contact_force_n_nm: [20.0, 20.0, 20.0, 8.0, 8.0, 8.0],
            collision_force_n_nm: [60.0, 60.0, 60.0, 20.0, 20.0, 20.0],
            joint_impedance_nm_per_rad: [3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0],
            tool_inertia_kg_m2: [0.001, 0.001, 0.001],
            torque_share: 0.8,
            delay_periods: 0,
            hold_stiffness_nm_per_rad: [200.0, 200.0, 200.0, 200.0, 50.0, 30.0, 10.0],
            hold_damping_nm_s_per_rad: [20.0, 20.0, 20.0, 20.0, 4.0, 3.0, 1.0],
            zero_max_n: 5.0,
            zero_jump_max_n: 2.0,
            zero_jump_max_nm: 0.5,
        }
    }
}

impl FrankaConfig {
    pub(super) fn check(&self, checker: &Checker<'_>, port_offset: u16) -> Result<(), ConfigError> {
        check_port(checker, "robot.franka.fci_port", self.fci_port, port_offset)?;
        let lists: [(&str, &[f64], f64, f64, &str); 8] = [
            (
                "contact_torque_nm",
                &self.contact_torque_nm,
                0.5,
                100.0,
                "Nm",
            ),
            (
                "collision_torque_nm",
                &self.collision_torque_nm,
                0.5,
                100.0,
                "Nm",
            ),
            (
                "contact_force_n_nm",
                &self.contact_force_n_nm,
                0.5,
                200.0,
                "N, Nm",
            ),
            (
                "collision_force_n_nm",
                &self.collision_force_n_nm,
                0.5,
                200.0,
                "N, Nm",
            ),
            (
                "joint_impedance_nm_per_rad",
                &self.joint_impedance_nm_per_rad,
                10.0,
                14_250.0,
                "Nm/rad",
            ),
            (
                "tool_inertia_kg_m2",
                &self.tool_inertia_kg_m2,
                0.0,
                1.0,
                "kg m²",
            ),
            (
                "hold_stiffness_nm_per_rad",
                &self.hold_stiffness_nm_per_rad,
                0.0,
                2000.0,
                "Nm/rad",
            ),
            (
                "hold_damping_nm_s_per_rad",
                &self.hold_damping_nm_s_per_rad,
                0.1,
                100.0,
                "Nm s/rad",
            ),
        ];
        for (key, list, least, most, unit) in lists {
            checker.ranges(&format!("robot.franka.{key}"), list, least..=most, unit)?;
        }
        let ordered = |lower: &[f64], upper: &[f64]| lower.iter().zip(upper).all(|(l, u)| l <= u);
        checker.require(
            ordered(&self.contact_torque_nm, &self.collision_torque_nm),
            "robot.franka.contact_torque_nm",
            format!("{:?}", self.contact_torque_nm),
            "for each joint at most collision_torque_nm",
        )?;
        checker.require(
            ordered(&self.contact_force_n_nm, &self.collision_force_n_nm),
            "robot.franka.contact_force_n_nm",
            format!("{:?}", self.contact_force_n_nm),
            "for each axis at most collision_force_n_nm",
        )?;
        checker.range(
            "robot.franka.torque_share",
            self.torque_share,
            0.05..=1.0,
            "",
        )?;
        for (key, value, most, unit) in [
            ("zero_max_n", self.zero_max_n, 20.0, "N"),
            ("zero_jump_max_n", self.zero_jump_max_n, 20.0, "N"),
            ("zero_jump_max_nm", self.zero_jump_max_nm, 5.0, "Nm"),
        ] {
            checker.range(&format!("robot.franka.{key}"), value, 0.1..=most, unit)?;
        }
        checker.require(
            self.delay_periods <= DELAY_PERIODS_MAX,
            "robot.franka.delay_periods",
            self.delay_periods.to_string(),
            "0 to 8",
        )
    }
}

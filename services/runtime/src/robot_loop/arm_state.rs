//! The part of `arm/state` that every robot has: joints, tool, time, and the counts of commands.

use std::time::Instant;

use nalgebra::SMatrix;
use tangent_actuation::CommandAccount;
use tangent_actuation::admission::Admission;
use tangent_actuation::lease::Lease;
use tangent_mechanics::{Aligned, Arm, Base, Flange, Joints, Pose, Tool, Twist};
use tangent_schemas::Text;
use tangent_schemas::convert::joint_array;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::ArmState;

use crate::clock;

/// What a robot reported in one cycle, in the terms that all robots share.
#[derive(Clone, Copy, Debug)]
pub struct ArmReading<const N: usize> {
    /// Time of arrival of its packet.
    pub arrival: Instant,
    /// Number of robot packets since the start.
    pub cycle: u64,
    /// The robot's own clock, s.
    pub robot_time_s: f64,
    /// Time between robot packets, s.
    pub period_s: f64,
    /// Joint angles, base to flange, rad.
    pub q: Joints<N>,
    /// Joint speeds, rad/s.
    pub qd: Joints<N>,
    /// Target joint speeds of the robot's own controller, rad/s.
    pub qd_target: Joints<N>,
    /// Robot packets lost since the start.
    pub packets_lost: u64,
}

/// Pose of the tool, and its Jacobian.
#[derive(Clone, Copy, Debug)]
pub struct ToolMotion<const N: usize> {
    /// Pose of the tool.
    pub base_from_tool: Pose<Base, Tool>,
    /// Jacobian: maps joint velocities to the twist of the tool's origin, base axes; linear rows in
    /// m/s per rad/s above angular ones.
    pub jacobian: SMatrix<f64, 6, N>,
}

/// Fills the vendor-neutral part of `arm/state` in each cycle. Allocates nothing.
#[derive(Debug)]
pub struct ArmStateWriter<const N: usize> {
    arm: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
    account: CommandAccount,
}

impl<const N: usize> ArmStateWriter<N> {
    /// Writer for an arm with its tool.
    pub fn new(arm: Arm<N>, flange_from_tool: Pose<Flange, Tool>) -> Self {
        Self {
            arm,
            flange_from_tool,
            account: CommandAccount::default(),
        }
    }

    /// Writes the robot's report into `state`, which is that of the previous cycle, and returns the
    /// motion of the tool. The bridge itself fills modes, readiness and latency.
    pub fn fill(&self, state: &mut ArmState, reading: &ArmReading<N>) -> ToolMotion<N> {
        let (base_from_tool, jacobian) = self
            .arm
            .tool_and_jacobian(&reading.q, &self.flange_from_tool);
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * reading.qd));
        state.header = Header::in_frame::<Base>(clock::stamp_ns(reading.arrival));
        state.cycle = reading.cycle;
        state.robot_time_s = reading.robot_time_s;
        state.period_s = reading.period_s;
        state.q = joint_array(&reading.q);
        state.qd = joint_array(&reading.qd);
        state.qd_target = joint_array(&reading.qd_target);
        state.tool_pose = (&base_from_tool).into();
        state.tool_twist = (&twist).into();
        state.packets_lost = reading.packets_lost;
        ToolMotion {
            base_from_tool,
            jacobian,
        }
    }

    /// Writes the source that commands the arm and the refused commands, at time `now_s` of the
    /// lease's clock.
    pub fn fill_account<T: Copy>(
        &mut self,
        state: &mut ArmState,
        admission: &Admission<T>,
        lease: &Lease,
        now_s: f64,
    ) {
        self.account.fill(state, admission, lease, now_s);
    }

    /// Replaces the reason of the last refusal, see [`CommandAccount::overrule`].
    pub fn overrule(&mut self, state: &mut ArmState, reason: Text) {
        self.account.overrule(state, reason);
    }
}

//! The arm's state as a message on the bus. No allocation.

use tangent_mechanics::{Aligned, Arm, Base, Flange, Pose, Tool, Twist};
use tangent_schemas::Text;
use tangent_schemas::convert::{cut, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::ArmState;
use tangent_simulation::ArmMeasurement;

/// Value of RTDE's `robot_mode` and `safety_mode` that every reader of `arm/state` understands.
const RUNNING: i32 = 7;
const NORMAL: i32 = 1;
const EMERGENCY_STOP: i32 = 7;
/// `runtime_state`: a program plays.
const PLAYING: u32 = 2;

/// Builds the messages.
pub struct StateMaker {
    model: Arm<6>,
    flange_from_tool: Pose<Flange, Tool>,
    period_s: f64,
}

impl StateMaker {
    /// Builds messages for the nominal model of the arm.
    pub fn new(model: Arm<6>, flange_from_tool: Pose<Flange, Tool>, period_s: f64) -> Self {
        Self {
            model,
            flange_from_tool,
            period_s,
        }
    }

    /// State of the arm in this cycle, without the part on commands; `stopped`: the emergency stop
    /// is pressed.
    pub fn of(
        &self,
        arm: &ArmMeasurement,
        cycle: u64,
        stamp_ns: i64,
        stopped: bool,
        answer_s: f64,
    ) -> ArmState {
        let (pose, jacobian) = self.model.tool_and_jacobian(&arm.q, &self.flange_from_tool);
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * arm.qd));
        ArmState {
            header: Header::new(stamp_ns, "base"),
            cycle,
            robot_time_s: arm.time_s,
            period_s: self.period_s,
            q: joint_array(&arm.q),
            qd: joint_array(&arm.qd),
            qd_target: joint_array(&arm.qd_target),
            tool_pose: (&pose).into(),
            tool_twist: (&twist).into(),
            robot_mode: RUNNING,
            safety_mode: if stopped { EMERGENCY_STOP } else { NORMAL },
            runtime_state: PLAYING,
            program_state: 1,
            ready: !stopped,
            not_ready_reason: if stopped {
                cut("emergency stop pressed: release it")
            } else {
                Text::new()
            },
            speed_scaling: 1.0,
            command_latency_s: self.period_s,
            packet_to_command_s: answer_s,
            ..ArmState::default()
        }
    }
}

//! The arm's state as it travels on the bus. No allocation.

use tangent_actuation::lease;
use tangent_mechanics::{Aligned, Arm, Base, Flange, Pose, Tool, Twist};
use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format, joint_array};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::ArmState;
use tangent_simulation::ArmMeasurement;

use super::gate::TorqueGate;

/// `robot_mode` and `safety_mode` of RTDE: what every reader of `arm/state` knows.
const RUNNING: i32 = 7;
const NORMAL: i32 = 1;
const EMERGENCY_STOP: i32 = 7;
/// `runtime_state`: a program plays.
const PLAYING: u32 = 2;

/// Makes the messages.
pub struct StateMaker {
    model: Arm<6>,
    flange_from_tool: Pose<Flange, Tool>,
    period_s: f64,
}

impl StateMaker {
    /// For the arm as its users know it.
    pub fn new(model: Arm<6>, flange_from_tool: Pose<Flange, Tool>, period_s: f64) -> Self {
        Self {
            model,
            flange_from_tool,
            period_s,
        }
    }

    /// What the arm says in this cycle; `stopped`: the emergency stop is pressed.
    pub fn of(
        &self,
        arm: &ArmMeasurement,
        cycle: u64,
        stamp_ns: i64,
        gate: &TorqueGate,
        stopped: bool,
        answer_s: f64,
    ) -> ArmState {
        let (pose, jacobian) = self.model.tool_and_jacobian(&arm.q, &self.flange_from_tool);
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * arm.qd));
        let holder = gate.lease().holder();
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
            command_cycle_accepted: gate.admission().cycle_accepted(),
            commands_refused: gate.admission().refused() + gate.lease().refused(),
            refusal_reason: *gate.reason(),
            activation_latched: gate.admission().activation_latched(),
            packet_to_command_s: answer_s,
            missed_cycles: gate.admission().missed(),
            commanded_by: holder.map_or_else(Default::default, |source| {
                cut_format(format_args!("{source}"))
            }),
            commander_id: holder.map_or([0; 16], |source| lease::mark(&source.publisher)),
            ..ArmState::default()
        }
    }
}

//! State of the arm.

use super::arguments::finite;
use super::{Done, bool, builtins, float, integer, pose, six};
use crate::error::ScriptError;
use crate::robot::Robot;
use crate::value::Value;

/// Force from which the tool counts as in contact, N.
const TOOL_CONTACT_N: f64 = 5.0;

builtins! {
    get_steptime() = |r, _| float(r.step_s());
    get_actual_joint_positions() = |r, _| six(r.joint_positions(false));
    get_joint_positions() = |r, _| six(r.joint_positions(false));
    get_actual_joint_positions_history(steps) = |r, _| six(r.joint_positions(false));
    get_target_joint_positions() = |r, _| six(r.joint_positions(true));
    get_actual_joint_speeds() = |r, _| six(r.joint_speeds(false));
    get_joint_speeds() = |r, _| six(r.joint_speeds(false));
    get_target_joint_speeds() = |r, _| six(r.joint_speeds(true));
    get_joint_torques() = |r, _| six(r.joint_torques());
    get_actual_tcp_pose() = |r, _| pose(r.tcp_pose(false));
    get_target_tcp_pose() = |r, _| pose(r.tcp_pose(true));
    get_target_waypoint() = |r, _| pose(r.tcp_pose(true));
    get_actual_tcp_speed() = |r, _| six(r.tcp_speed(false));
    get_target_tcp_speed() = |r, _| six(r.tcp_speed(true));
    get_tcp_force() = |r, _| six(r.tcp_force());
    force() = |r, _| { let f = r.tcp_force(); float((f[0] * f[0] + f[1] * f[1] + f[2] * f[2]).sqrt()) };
    get_actual_tool_flange_pose() = |r, _| { let q = r.joint_positions(false); pose(r.forward(&q, &[0.0; 6])) };
    get_target_tool_flange_pose() = |r, _| { let q = r.joint_positions(true); pose(r.forward(&q, &[0.0; 6])) };
    get_tcp_offset() = |r, _| pose(r.tcp_offset());
    get_forward_kin(q, tcp) = |r, a| {
        let q = if a[0] == Value::None { r.joint_positions(false) } else { finite(a[0].six()?)? };
        let tcp = if a[1] == Value::None { r.tcp_offset() } else { finite(a[1].six()?)? };
        pose(r.forward(&q, &tcp))
    };
    get_inverse_kin(x, qnear, maxPositionError, maxOrientationError) = |r, a| match solution(r, a)? {
        Some(q) => six(q),
        None => Err(ScriptError::NoSolution),
    };
    get_inverse_kin_has_solution(x, qnear, maxPositionError, maxOrientationError) = |r, a| bool(solution(r, a)?.is_some());
    is_within_safety_limits(pose) = |r, a| {
        let q = match &a[0] {
            Value::Pose(p) => r.inverse(&finite(*p)?, None),
            other => Some(finite(other.six()?)?),
        };
        bool(q.is_some_and(|q| r.within_limits(&q)))
    };
    is_steady() = |r, _| bool(!r.moving());
    tool_contact(direction) = |r, a| contact(r, &a[0]);
    get_speed_fraction() = |r, _| float(r.speed_fraction());
    get_controller_temp() = |_, _| float(25.0);
    get_joint_temp(j) = |_, a| match a[0].integer()? {
        0..=5 => float(25.0),
        number => Err(ScriptError::NoPort { number }),
    };
}

/// Number of cycles since contact began: one while the tool is pushed against the direction of its
/// motion, or of `direction`; otherwise zero.
fn contact(r: &dyn Robot, direction: &Value) -> Done {
    let along = match direction {
        Value::None => r.tcp_speed(false),
        given => finite(given.six()?)?,
    };
    let force = r.tcp_force();
    let length = along[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
    let push: f64 = (0..3).map(|i| -force[i] * along[i]).sum();
    let touched = length > 0.0 && push / length > TOOL_CONTACT_N;
    integer(touched.into())
}

fn solution(r: &dyn Robot, a: &[Value]) -> Result<Option<[f64; 6]>, ScriptError> {
    let near = if a[1] == Value::None {
        None
    } else {
        Some(finite(a[1].six()?)?)
    };
    Ok(r.inverse(&finite(a[0].six()?)?, near))
}

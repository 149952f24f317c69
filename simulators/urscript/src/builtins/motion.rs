//! Functions that move the arm or wait.

use super::arguments::{finite, or, positive, within};
use super::{Done, Outcome, Wait, builtins};
use crate::error::ScriptError;
use crate::robot::{Motion, Robot};
use crate::value::Value;

builtins! {
    speedj(qd, a, t) = |_, a| speed(Motion::SpeedJ { qd: finite(a[0].six()?)?, a: acceleration(&a[1])? }, &a[2]);
    speedl(xd, a, t, aRot) = |_, a| speed(Motion::SpeedL { xd: finite(a[0].six()?)?, a: acceleration(&a[1])? }, &a[2]);
    servoj(q, a, v, t, lookahead_time, gain) = |r, a| {
        let step = r.step_s();
        let t = or(&a[3], step)?;
        let lookahead = within("servoj", "lookahead_time", or(&a[4], 0.1)?, 0.03..=0.2)?;
        let gain = within("servoj", "gain", or(&a[5], 300.0)?, 100.0..=2000.0)?;
        // High gain follows as closely as the look-ahead lets it.
        let lookahead_s = lookahead * (300.0 / gain).sqrt().clamp(0.3, 1.0);
        Ok(Outcome::Move(Motion::ServoJ { q: finite(a[0].six()?)?, lookahead_s }, Wait::MotionFor(t.max(step))))
    };
    movej(q, a, v, t, r) = |r, a| {
        let q = joints_or_pose(r, &a[0])?;
        Ok(Outcome::Move(Motion::MoveJ { q, a: positive(&a[1], 1.4, "a")?, v: positive(&a[2], 1.05, "v")?, t: or(&a[3], 0.0)? }, Wait::Motion))
    };
    movel(pose, a, v, t, r) = |r, a| line(r, a);
    movep(pose, a, v, t, r) = |r, a| line(r, a);
    movec(pose_via, pose_to, a, v, r, mode) = |r, a| {
        let (via, to) = (pose_or_joints(r, &a[0])?, pose_or_joints(r, &a[1])?);
        let (acceleration, v) = (positive(&a[2], 1.2, "a")?, positive(&a[3], 0.25, "v")?);
        let follows_arc = within("movec", "mode", or(&a[5], 0.0)?, 0.0..=1.0)? >= 0.5;
        Ok(Outcome::Move(Motion::MoveC { via, to, a: acceleration, v, follows_arc }, Wait::Motion))
    };
    servoc(pose, a, v, r) = |r, a| {
        let pose = pose_or_joints(r, &a[0])?;
        Ok(Outcome::Move(Motion::MoveL { pose, a: positive(&a[1], 1.2, "a")?, v: positive(&a[2], 0.25, "v")?, t: 0.0 }, Wait::Motion))
    };
    stopj(a) = |_, a| Ok(Outcome::Move(Motion::Stop { a: positive(&a[0], 2.0, "a")? }, Wait::Motion));
    stopl(a, aRot) = |_, a| Ok(Outcome::Move(Motion::Stop { a: positive(&a[0], 2.0, "a")? }, Wait::Motion));
    sync() = |_, _| Ok(Outcome::Wait(Wait::Frame));
    sleep(t) = |_, a| { let t = a[0].float()?; Ok(Outcome::Wait(Wait::Sleep(if t.is_finite() { t } else { 0.0 }))) };
}

/// Clients that follow a spline request no acceleration where its speed is constant.
fn acceleration(value: &Value) -> Result<f64, ScriptError> {
    match or(value, 0.5)? {
        0.0 => Ok(0.0),
        _ => positive(value, 0.5, "a"),
    }
}

fn speed(motion: Motion, t: &Value) -> Done {
    let t = or(t, 0.0)?;
    let wait = if t > 0.0 {
        Wait::MotionFor(t)
    } else {
        Wait::Motion
    };
    Ok(Outcome::Move(motion, wait))
}

fn line(r: &mut dyn Robot, a: &[Value]) -> Done {
    let pose = pose_or_joints(r, &a[0])?;
    let (acceleration, v) = (positive(&a[1], 1.2, "a")?, positive(&a[2], 0.25, "v")?);
    let t = or(&a[3], 0.0)?;
    Ok(Outcome::Move(
        Motion::MoveL {
            pose,
            a: acceleration,
            v,
            t,
        },
        Wait::Motion,
    ))
}

fn pose_or_joints(r: &dyn Robot, value: &Value) -> Result<[f64; 6], ScriptError> {
    match value {
        Value::Pose(p) => finite(*p),
        other => Ok(r.forward(&finite(other.six()?)?, &r.tcp_offset())),
    }
}

fn joints_or_pose(r: &dyn Robot, value: &Value) -> Result<[f64; 6], ScriptError> {
    match value {
        Value::Pose(p) => r
            .inverse(&finite(*p)?, None)
            .ok_or(ScriptError::NoJointPositions),
        other => finite(other.six()?),
    }
}

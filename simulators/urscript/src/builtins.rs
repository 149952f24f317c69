//! The controller's built-in functions, as far as bridges and clients use them.

use std::ops::RangeInclusive;

use crate::error::ScriptError;
use crate::pose;
use crate::value::Value;

/// Interface of the controller for a program.
pub trait Robot {
    /// Control period, s.
    fn step_s(&self) -> f64;
    /// Whether it is an e-Series; otherwise a CB3.
    fn is_e_series(&self) -> bool;
    /// Speed slider, 0 to 1: time in motions runs this much slower.
    fn speed_fraction(&self) -> f64;
    /// Input register; `None` when there is no such register.
    fn input_integer(&self, n: i32) -> Option<i32>;
    /// Input register.
    fn input_float(&self, n: i32) -> Option<f64>;
    /// Input register.
    fn input_bit(&self, n: i32) -> Option<bool>;
    /// Output register, to read and to write.
    fn output_integer(&mut self, n: i32) -> Option<&mut i32>;
    /// Output register, to read and to write.
    fn output_float(&mut self, n: i32) -> Option<&mut f64>;
    /// Writes an output register; false when there is no such register.
    fn set_output_bit(&mut self, n: i32, on: bool) -> bool;
    /// Digital output 0 to 17; false when there is no such output.
    fn set_digital_output(&mut self, n: i32, on: bool) -> bool;
    /// Digital input 0 to 17.
    fn digital_input(&self, n: i32) -> Option<bool>;
    /// Joint positions, rad: measured, or those the servo aims for.
    fn joint_positions(&self, target: bool) -> [f64; 6];
    /// Joint speeds, rad/s.
    fn joint_speeds(&self, target: bool) -> [f64; 6];
    /// Joint torques, Nm.
    fn joint_torques(&self) -> [f64; 6];
    /// Pose of the tool centre point, base axes, m and rotation vector.
    fn tcp_pose(&self, target: bool) -> [f64; 6];
    /// Speed of the tool centre point, base axes, m/s and rad/s.
    fn tcp_speed(&self, target: bool) -> [f64; 6];
    /// Force on the tool centre point, base axes, N and Nm.
    fn tcp_force(&self) -> [f64; 6];
    /// `flange_from_tcp`.
    fn tcp_offset(&self) -> [f64; 6];
    /// Sets `flange_from_tcp`.
    fn set_tcp(&mut self, pose: [f64; 6]);
    /// Joint positions for a pose of the tool centre point, near `near` or the present ones.
    fn inverse(&self, pose: &[f64; 6], near: Option<[f64; 6]>) -> Option<[f64; 6]>;
    /// Pose of a tool centre point `tcp` on the flange at `q`.
    fn forward(&self, q: &[f64; 6], tcp: &[f64; 6]) -> [f64; 6];
    /// Joint positions within the limits.
    fn within_limits(&self, q: &[f64; 6]) -> bool;
    /// Sets mass, kg, and centre of gravity, m.
    fn set_payload(&mut self, mass: f64, centre: Option<[f64; 3]>);
    /// Mass, kg, and centre of gravity, m, as set.
    fn payload(&self) -> (f64, [f64; 3]);
    /// Begins a motion, replacing the one under way.
    fn start_motion(&mut self, motion: Motion) -> Result<(), ScriptError>;
    /// Whether the motion begun last has ended.
    fn motion_done(&self) -> bool;
    /// Whether the arm moves.
    fn moving(&self) -> bool;
    /// Adds a line to the log and sends it to clients.
    fn text_message(&mut self, text: String);
    /// Monitors an input variable.
    fn watchdog(&mut self, variable: &str, rate_hz: f64, action: &str) -> Result<(), ScriptError>;
    /// Causes a protective stop.
    fn protective_stop(&mut self);
}

/// A motion that a program requests.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Joint velocity.
    SpeedJ {
        /// Joint velocity, rad/s.
        qd: [f64; 6],
        /// Acceleration, rad/s².
        a: f64,
    },
    /// Velocity of the tool centre point.
    SpeedL {
        /// Velocity, base axes, m/s and rad/s.
        xd: [f64; 6],
        /// Acceleration, m/s².
        a: f64,
    },
    /// Position to follow.
    ServoJ {
        /// Joint positions, rad.
        q: [f64; 6],
        /// Smoothing time, s.
        lookahead_s: f64,
    },
    /// Moves all joints at once to joint positions.
    MoveJ {
        /// Joint positions, rad.
        q: [f64; 6],
        /// Acceleration of the leading axis, rad/s².
        a: f64,
        /// Speed of the leading axis, rad/s.
        v: f64,
        /// Duration instead of `a` and `v`, s.
        t: f64,
    },
    /// Moves in a straight line.
    MoveL {
        /// Target `base_from_tcp`.
        pose: [f64; 6],
        /// Acceleration, m/s².
        a: f64,
        /// Speed, m/s.
        v: f64,
        /// Duration instead of `a` and `v`, s.
        t: f64,
    },
    /// Decelerates to a stop.
    Stop {
        /// Deceleration, rad/s².
        a: f64,
    },
}

/// Force from which the tool counts as in contact, N.
const TOOL_CONTACT_N: f64 = 5.0;

/// Condition for which a thread waits.
#[derive(Clone, Debug, PartialEq)]
pub enum Wait {
    Not,
    /// The next frame.
    Frame,
    /// Remaining time, s.
    Sleep(f64),
    /// Remaining time of a motion, s.
    MotionFor(f64),
    /// The motion's end.
    Motion,
    /// A thread's end.
    Join(i32),
}

impl Wait {
    pub fn is_motion(&self) -> bool {
        matches!(self, Self::MotionFor(_) | Self::Motion)
    }
}

pub enum Outcome {
    Value(Value),
    Wait(Wait),
    Move(Motion, Wait),
}

type Done = Result<Outcome, ScriptError>;

/// One built-in function.
#[derive(Debug)]
pub struct Builtin {
    pub name: &'static str,
    /// Names for keyword arguments; arguments that are left out are `Value::None`.
    pub parameters: &'static [&'static str],
    pub e_series_only: bool,
    pub call: fn(&mut dyn Robot, &[Value]) -> Done,
}

macro_rules! builtins {
    ($($(#[$e:ident])? $name:ident($($parameter:ident),*) = $call:expr;)*) => {
        pub static BUILTINS: &[Builtin] = &[$(Builtin {
            name: stringify!($name),
            parameters: &[$(stringify!($parameter)),*],
            e_series_only: builtins!(@$($e)?),
            call: $call,
        }),*];
    };
    (@e_series) => { true };
    (@) => { false };
}

builtins! {
    // Registers.
    read_input_integer_register(address) = |r, a| register(a, |n| r.input_integer(n).map(Value::Integer));
    read_input_float_register(address) = |r, a| register(a, |n| r.input_float(n).map(Value::Float));
    read_input_boolean_register(address) = |r, a| register(a, |n| r.input_bit(n).map(Value::Bool));
    read_output_integer_register(address) = |r, a| register(a, |n| r.output_integer(n).map(|x| Value::Integer(*x)));
    read_output_float_register(address) = |r, a| register(a, |n| r.output_float(n).map(|x| Value::Float(*x)));
    write_output_integer_register(address, value) = |r, a| {
        let value = a[1].integer()?;
        register(a, |n| r.output_integer(n).map(|x| { *x = value; Value::None }))
    };
    write_output_float_register(address, value) = |r, a| {
        let value = a[1].float()?;
        register(a, |n| r.output_float(n).map(|x| { *x = value; Value::None }))
    };
    write_output_boolean_register(address, value) = |r, a| {
        let on = a[1].truth()?;
        register(a, |n| r.set_output_bit(n, on).then_some(Value::None))
    };
    set_digital_out(n, b) = |r, a| { let on = a[1].truth()?; register(a, |n| r.set_digital_output(n, on).then_some(Value::None)) };
    set_standard_digital_out(n, b) = |r, a| { let on = a[1].truth()?; register(a, |n| r.set_digital_output(n, on).then_some(Value::None)) };
    get_digital_in(n) = |r, a| register(a, |n| r.digital_input(n).map(Value::Bool));
    get_standard_digital_in(n) = |r, a| register(a, |n| r.digital_input(n).map(Value::Bool));

    // Motion.
    speedj(qd, a, t) = |_, a| speed(Motion::SpeedJ { qd: finite(a[0].six()?)?, a: positive(&a[1], 0.5, "a")? }, &a[2]);
    speedl(xd, a, t, aRot) = |_, a| speed(Motion::SpeedL { xd: finite(a[0].six()?)?, a: positive(&a[1], 0.5, "a")? }, &a[2]);
    servoj(q, a, v, t, lookahead_time, gain) = |r, a| {
        let step = r.step_s();
        let t = or(&a[3], step)?;
        let lookahead = or(&a[4], 0.1)?;
        within("servoj", "lookahead_time", lookahead, 0.03..=0.2)?;
        let gain = or(&a[5], 300.0)?;
        within("servoj", "gain", gain, 100.0..=2000.0)?;
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
    servoc(pose, a, v, r) = |r, a| {
        let pose = pose_or_joints(r, &a[0])?;
        Ok(Outcome::Move(Motion::MoveL { pose, a: positive(&a[1], 1.2, "a")?, v: positive(&a[2], 0.25, "v")?, t: 0.0 }, Wait::Motion))
    };
    stopj(a) = |_, a| Ok(Outcome::Move(Motion::Stop { a: positive(&a[0], 2.0, "a")? }, Wait::Motion));
    stopl(a, aRot) = |_, a| Ok(Outcome::Move(Motion::Stop { a: positive(&a[0], 2.0, "a")? }, Wait::Motion));
    sync() = |_, _| Ok(Outcome::Wait(Wait::Frame));
    sleep(t) = |_, a| { let t = a[0].float()?; Ok(Outcome::Wait(Wait::Sleep(if t.is_finite() { t } else { 0.0 }))) };

    // State of the arm.
    get_steptime() = |r, _| float(r.step_s());
    get_actual_joint_positions() = |r, _| six(r.joint_positions(false));
    get_joint_positions() = |r, _| six(r.joint_positions(false));
    get_actual_joint_positions_history(steps) = |r, _| six(r.joint_positions(false));
    get_target_joint_positions() = |r, _| six(r.joint_positions(true));
    get_actual_joint_speeds() = |r, _| six(r.joint_speeds(false));
    get_target_joint_speeds() = |r, _| six(r.joint_speeds(true));
    get_joint_torques() = |r, _| six(r.joint_torques());
    get_actual_tcp_pose() = |r, _| pose(r.tcp_pose(false));
    get_target_tcp_pose() = |r, _| pose(r.tcp_pose(true));
    get_target_waypoint() = |r, _| pose(r.tcp_pose(true));
    get_actual_tcp_speed() = |r, _| six(r.tcp_speed(false));
    get_target_tcp_speed() = |r, _| six(r.tcp_speed(true));
    get_tcp_force() = |r, _| six(r.tcp_force());
    get_actual_tool_flange_pose() = |r, _| { let q = r.joint_positions(false); pose(r.forward(&q, &[0.0; 6])) };
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

    // Settings.
    set_tcp(pose) = |r, a| { let p = finite(a[0].six()?)?; r.set_tcp(p); nothing() };
    set_payload(m, cog) = |r, a| payload(r, a);
    set_target_payload(m, cog, inertia, transition_time) = |r, a| payload(r, a);
    get_target_payload() = |r, _| float(r.payload().0);
    set_gravity(d) = |_, a| upright(&a[0]);
    // Functions that end an unsupported mode do nothing; functions that begin one fail instead of
    // succeeding silently.
    force_mode(task_frame, selection_vector, wrench, type, limits) = |_, _| absent("force_mode");
    end_force_mode() = |_, _| nothing();
    force_mode_set_damping(damping) = |_, _| nothing();
    #[e_series] force_mode_set_gain_scaling(scaling) = |_, _| nothing();
    // CB3 compiles it (clients' programs name it) and has no such sensor.
    zero_ftsensor() = |r, _| if r.is_e_series() { nothing() } else { Err(ScriptError::NoForceSensor) };
    teach_mode() = |_, _| absent("teach_mode");
    end_teach_mode() = |_, _| nothing();
    #[e_series] freedrive_mode(freeAxes, feature) = |_, _| absent("freedrive_mode");
    #[e_series] end_freedrive_mode() = |_, _| nothing();
    #[e_series] get_freedrive_status() = |_, _| Ok(Outcome::Value(Value::Integer(0)));
    #[e_series] ft_rtde_input_enable(enable, sensor_mass, sensor_measuring_offset, sensor_cog) = |_, a| external_sensor(&a[0]);
    enable_external_ft_sensor(enable, sensor_mass, sensor_measuring_offset, sensor_cog) = |_, a| external_sensor(&a[0]);
    #[e_series] get_target_payload_cog() = |r, _| {
        let centre = r.payload().1;
        Ok(Outcome::Value(Value::list(centre.into_iter().map(Value::Float).collect())?))
    };
    // The simulated payload is a point.
    #[e_series] get_target_payload_inertia() = |_, _| six([0.0; 6]);
    protective_stop() = |r, _| { r.protective_stop(); Ok(Outcome::Wait(Wait::Frame)) };
    rtde_set_watchdog(variable_name, min_frequency, action) = |r, a| {
        let Value::Text(name) = &a[0] else {
            return Err(ScriptError::WatchdogWithoutName { found: a[0].kind() });
        };
        let action = match &a[2] {
            Value::Text(action) => action.to_string(),
            _ => "pause".to_owned(),
        };
        r.watchdog(name, positive(&a[1], 1.0, "min_frequency")?, &action)?;
        nothing()
    };

    // Text and numbers.
    textmsg(s1, s2) = |r, a| { r.text_message(joined(a)); nothing() };
    popup(s, title, warning, error, blocking) = |r, a| { r.text_message(a[0].to_string()); nothing() };
    to_str(val) = |_, a| Ok(Outcome::Value(Value::text(a[0].to_string())?));
    str_cat(op1, op2) = |_, a| Ok(Outcome::Value(Value::text(joined(a))?));
    norm(a) = |_, a| float(a[0].numbers()?.iter().map(|x| x * x).sum::<f64>().sqrt());
    get_list_length(v) = |_, a| Ok(Outcome::Value(Value::Integer(a[0].length()?)));
    length(v) = |_, a| Ok(Outcome::Value(Value::Integer(a[0].length()?)));
    pow(base, exponent) = |_, a| float(a[0].float()?.powf(a[1].float()?));
    sqrt(f) = |_, a| float(a[0].float()?.sqrt());
    sin(f) = |_, a| float(a[0].float()?.sin());
    cos(f) = |_, a| float(a[0].float()?.cos());
    tan(f) = |_, a| float(a[0].float()?.tan());
    asin(f) = |_, a| float(a[0].float()?.asin());
    acos(f) = |_, a| float(a[0].float()?.acos());
    atan(f) = |_, a| float(a[0].float()?.atan());
    atan2(x, y) = |_, a| float(a[0].float()?.atan2(a[1].float()?));
    floor(f) = |_, a| Ok(Outcome::Value(Value::Integer(Value::Float(a[0].float()?.floor()).integer()?)));
    ceil(f) = |_, a| Ok(Outcome::Value(Value::Integer(Value::Float(a[0].float()?.ceil()).integer()?)));
    d2r(d) = |_, a| float(a[0].float()?.to_radians());
    r2d(r) = |_, a| float(a[0].float()?.to_degrees());
    pose_trans(p_from, p_from_to) = |_, a| pose(pose::compose(&a[0].six()?, &a[1].six()?));
    pose_inv(p_from) = |_, a| pose(pose::invert(&a[0].six()?));
    pose_sub(p_to, p_from) = |_, a| pose(pose::difference(&a[0].six()?, &a[1].six()?));
    pose_add(p_1, p_2) = |_, a| pose(pose::sum(&a[0].six()?, &a[1].six()?));
}

fn nothing() -> Done {
    Ok(Outcome::Value(Value::None))
}

fn absent(function: &'static str) -> Done {
    Err(ScriptError::NoMode { function })
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
    Ok(Outcome::Value(Value::Integer(touched.into())))
}

fn upright(direction: &Value) -> Done {
    let d = direction.numbers()?;
    match d[..] {
        [x, y, z] if x.hypot(y) < 0.1 && z > 0.0 => nothing(),
        _ => Err(ScriptError::Tilted { direction: d }),
    }
}

fn external_sensor(enable: &Value) -> Done {
    if enable.truth()? {
        return Err(ScriptError::NoExternalSensor);
    }
    nothing()
}

fn float(x: f64) -> Done {
    Ok(Outcome::Value(Value::Float(x)))
}

fn bool(x: bool) -> Done {
    Ok(Outcome::Value(Value::Bool(x)))
}

fn six(x: [f64; 6]) -> Done {
    Ok(Outcome::Value(Value::joints(&x)))
}

fn pose(x: [f64; 6]) -> Done {
    Ok(Outcome::Value(Value::Pose(x)))
}

fn joined(a: &[Value]) -> String {
    a.iter()
        .filter(|v| **v != Value::None)
        .map(Value::to_string)
        .collect()
}

fn register(a: &[Value], access: impl FnOnce(i32) -> Option<Value>) -> Done {
    let number = a[0].integer()?;
    let value = access(number).ok_or(ScriptError::NoPort { number })?;
    Ok(Outcome::Value(value))
}

fn or(value: &Value, default: f64) -> Result<f64, ScriptError> {
    let x = match value {
        Value::None => default,
        given => given.float()?,
    };
    if x.is_finite() {
        Ok(x)
    } else {
        Err(ScriptError::NotFinite { value: x })
    }
}

fn within(
    function: &'static str,
    name: &'static str,
    value: f64,
    allowed: RangeInclusive<f64>,
) -> Result<(), ScriptError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    Err(ScriptError::ArgumentOutOfRange {
        function,
        name,
        value,
        least: *allowed.start(),
        most: *allowed.end(),
    })
}

fn positive(value: &Value, default: f64, name: &'static str) -> Result<f64, ScriptError> {
    let x = or(value, default)?;
    if x > 0.0 {
        Ok(x)
    } else {
        Err(ScriptError::NotPositive { name, value: x })
    }
}

fn finite(x: [f64; 6]) -> Result<[f64; 6], ScriptError> {
    if x.iter().all(|x| x.is_finite()) {
        Ok(x)
    } else {
        Err(ScriptError::MotionNotFinite { numbers: x })
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

fn solution(r: &dyn Robot, a: &[Value]) -> Result<Option<[f64; 6]>, ScriptError> {
    let near = if a[1] == Value::None {
        None
    } else {
        Some(finite(a[1].six()?)?)
    };
    Ok(r.inverse(&finite(a[0].six()?)?, near))
}

fn payload(r: &mut dyn Robot, a: &[Value]) -> Done {
    let centre = match &a[1] {
        Value::None => None,
        given => <[f64; 3]>::try_from(given.numbers()?).ok(),
    };
    r.set_payload(a[0].float()?, centre);
    nothing()
}

//! Settings of the robot: tool, payload, force mode, freedrive, watchdogs.

use super::arguments::{finite, or, positive, text_or, within};
use super::{Done, Outcome, Wait, builtins, float, integer, list, nothing, six};
use crate::error::ScriptError;
use crate::robot::{Compliance, ForceModeTuning, Robot, TaskFrame};
use crate::value::Value;

/// Speed limits of a hand-guided tool, m/s and rad/s.
const FREEDRIVE_SPEED_MAX: [f64; 6] = [0.5, 0.5, 0.5, 1.5, 1.5, 1.5];

builtins! {
    set_tcp(pose, tcp_name) = |r, a| { let p = finite(a[0].six()?)?; r.set_tcp(p); nothing() };
    set_payload(m, cog) = |r, a| payload(r, a);
    set_target_payload(m, cog, inertia, transition_time) = |r, a| payload(r, a);
    set_payload_mass(m) = |r, a| { let mass = or(&a[0], 0.0)?; r.set_payload(mass, None); nothing() };
    set_payload_cog(cog) = |r, a| { let (mass, _) = r.payload(); r.set_payload(mass, Some(three(&a[0])?)); nothing() };
    get_target_payload() = |r, _| float(r.payload().0);
    #[e_series] get_target_payload_cog() = |r, _| list(r.payload().1.into_iter().map(Value::Float).collect());
    // The simulated payload is a point.
    #[e_series] get_target_payload_inertia() = |_, _| six([0.0; 6]);
    set_gravity(d) = |_, a| upright(&a[0]);

    force_mode(task_frame, selection_vector, wrench, type, limits) = |r, a| {
        let compliance = force_mode(a)?;
        r.set_compliance(Some(compliance));
        nothing()
    };
    end_force_mode() = |r, _| { r.set_compliance(None); nothing() };
    force_mode_set_damping(damping) = |r, a| {
        let damping = within("force_mode_set_damping", "damping", or(&a[0], 0.0)?, 0.0..=1.0)?;
        r.tune_force_mode(ForceModeTuning::Damping(damping));
        nothing()
    };
    // CB3 compiles it: clients' programs name it, but call it on e-Series only.
    force_mode_set_gain_scaling(scaling) = |r, a| {
        let gain = within("force_mode_set_gain_scaling", "scaling", or(&a[0], 1.0)?, 0.0..=2.0)?;
        r.tune_force_mode(ForceModeTuning::Gain(gain));
        nothing()
    };
    teach_mode() = |r, _| { r.set_compliance(Some(freedrive([true; 6], TaskFrame::Fixed([0.0; 6])))); nothing() };
    end_teach_mode() = |r, _| { r.set_compliance(None); nothing() };
    freedrive_mode(freeAxes, feature) = |r, a| {
        let axes = if a[0] == Value::None { [true; 6] } else { selection(&a[0])? };
        let frame = match &a[1] {
            Value::None => TaskFrame::Fixed([0.0; 6]),
            Value::Text(feature) if &**feature == "tool" => TaskFrame::Tool,
            Value::Text(_) => TaskFrame::Fixed([0.0; 6]),
            pose => TaskFrame::Fixed(finite(pose.six()?)?),
        };
        r.set_compliance(Some(freedrive(axes, frame)));
        nothing()
    };
    end_freedrive_mode() = |r, _| { r.set_compliance(None); nothing() };
    // 0: no warning about a singularity.
    #[e_series] get_freedrive_status() = |_, _| integer(0);

    // CB3 compiles it (clients' programs name it) and has no such sensor.
    zero_ftsensor() = |r, _| if r.is_e_series() { nothing() } else { Err(ScriptError::NoForceSensor) };
    ft_rtde_input_enable(enable, sensor_mass, sensor_measuring_offset, sensor_cog) = |r, a| external_sensor(r, a);
    enable_external_ft_sensor(enable, sensor_mass, sensor_measuring_offset, sensor_cog) = |r, a| external_sensor(r, a);

    protective_stop() = |r, _| { r.protective_stop(); Ok(Outcome::Wait(Wait::Frame)) };
    rtde_set_watchdog(variable_name, min_frequency, action) = |r, a| {
        let Value::Text(name) = &a[0] else {
            return Err(ScriptError::WatchdogWithoutName { found: a[0].kind() });
        };
        let action = text_or(&a[2], "pause")?;
        r.watchdog(name, positive(&a[1], 1.0, "min_frequency")?, &action)?;
        nothing()
    };
}

fn upright(direction: &Value) -> Done {
    let d = direction.numbers()?;
    match d[..] {
        [x, y, z] if x.hypot(y) < 0.1 && z > 0.0 => nothing(),
        _ => Err(ScriptError::Tilted { direction: d }),
    }
}

fn three(value: &Value) -> Result<[f64; 3], ScriptError> {
    let numbers = value.numbers()?;
    let count = numbers.len();
    <[f64; 3]>::try_from(numbers).map_err(|_| ScriptError::NotThree { count })
}

fn payload(r: &mut dyn Robot, a: &[Value]) -> Done {
    let centre = match &a[1] {
        Value::None => None,
        given => Some(three(given)?),
    };
    r.set_payload(or(&a[0], 0.0)?, centre);
    nothing()
}

/// The simulated sensor is massless, so only the first argument has an effect.
fn external_sensor(r: &mut dyn Robot, a: &[Value]) -> Done {
    let enable = a[0].truth()?;
    r.use_external_force(enable);
    nothing()
}

fn selection(value: &Value) -> Result<[bool; 6], ScriptError> {
    Ok(value.six()?.map(|x| x != 0.0))
}

fn freedrive(selection: [bool; 6], frame: TaskFrame) -> Compliance {
    Compliance {
        frame,
        selection,
        wrench: [0.0; 6],
        speed_max: FREEDRIVE_SPEED_MAX,
        hand_guided: true,
    }
}

fn force_mode(a: &[Value]) -> Result<Compliance, ScriptError> {
    let frame = finite(a[0].six()?)?;
    let selection = selection(&a[1])?;
    let wrench = finite(a[2].six()?)?;
    let kind = within("force_mode", "type", or(&a[3], 2.0)?, 1.0..=3.0)?;
    let limits = finite(a[4].six()?)?;
    for (limit, compliant) in limits.iter().zip(selection) {
        if compliant && *limit <= 0.0 {
            return Err(ScriptError::NotPositive {
                name: "limits",
                value: *limit,
            });
        }
    }
    Ok(Compliance {
        frame: if kind < 1.5 {
            TaskFrame::TowardsOrigin(frame)
        } else if kind < 2.5 {
            TaskFrame::Fixed(frame)
        } else {
            TaskFrame::AlongMotion(frame)
        },
        selection,
        wrench,
        speed_max: limits,
        hand_guided: false,
    })
}

//! Registers, digital and analog inputs and outputs.

use super::{Done, Outcome, builtins, float, nothing};
use crate::error::ScriptError;
use crate::value::Value;

/// First configurable and first tool input or output.
const CONFIGURABLE: i32 = 8;
const TOOL: i32 = 16;

builtins! {
    read_input_integer_register(address) = |r, a| port(a, |n| r.input_integer(n).map(Value::Integer));
    read_input_float_register(address) = |r, a| port(a, |n| r.input_float(n).map(Value::Float));
    read_input_boolean_register(address) = |r, a| port(a, |n| r.input_bit(n).map(Value::Bool));
    read_output_integer_register(address) = |r, a| port(a, |n| r.output_integer(n).map(|x| Value::Integer(*x)));
    read_output_float_register(address) = |r, a| port(a, |n| r.output_float(n).map(|x| Value::Float(*x)));
    read_output_boolean_register(address) = |r, a| port(a, |n| r.output_bit(n).map(Value::Bool));
    write_output_integer_register(address, value) = |r, a| {
        let value = a[1].integer()?;
        port(a, |n| r.output_integer(n).map(|x| { *x = value; Value::None }))
    };
    write_output_float_register(address, value) = |r, a| {
        let value = a[1].float()?;
        port(a, |n| r.output_float(n).map(|x| { *x = value; Value::None }))
    };
    write_output_boolean_register(address, value) = |r, a| {
        let on = a[1].truth()?;
        port(a, |n| r.set_output_bit(n, on).then_some(Value::None))
    };

    set_digital_out(n, b) = |r, a| switch(a, 0, 18, |n, on| r.set_digital_output(n, on));
    set_standard_digital_out(n, b) = |r, a| switch(a, 0, 8, |n, on| r.set_digital_output(n, on));
    set_configurable_digital_out(n, b) = |r, a| switch(a, CONFIGURABLE, 8, |n, on| r.set_digital_output(n, on));
    set_tool_digital_out(n, b) = |r, a| switch(a, TOOL, 2, |n, on| r.set_digital_output(n, on));
    get_digital_out(n) = |r, a| bit(a, 0, 18, |n| r.digital_output(n));
    get_standard_digital_out(n) = |r, a| bit(a, 0, 8, |n| r.digital_output(n));
    get_configurable_digital_out(n) = |r, a| bit(a, CONFIGURABLE, 8, |n| r.digital_output(n));
    get_tool_digital_out(n) = |r, a| bit(a, TOOL, 2, |n| r.digital_output(n));
    get_digital_in(n) = |r, a| bit(a, 0, 18, |n| r.digital_input(n));
    get_standard_digital_in(n) = |r, a| bit(a, 0, 8, |n| r.digital_input(n));
    get_configurable_digital_in(n) = |r, a| bit(a, CONFIGURABLE, 8, |n| r.digital_input(n));
    get_tool_digital_in(n) = |r, a| bit(a, TOOL, 2, |n| r.digital_input(n));

    // Outputs are shares of their range. Nothing is connected to the inputs, which read 0.
    set_analog_out(n, f) = |r, a| set_analog(a, |n| r.analog_output(n));
    set_standard_analog_out(n, f) = |r, a| set_analog(a, |n| r.analog_output(n));
    get_analog_out(n) = |r, a| port(a, |n| r.analog_output(n).map(|x| Value::Float(*x)));
    get_standard_analog_out(n) = |r, a| port(a, |n| r.analog_output(n).map(|x| Value::Float(*x)));
    set_analog_outputdomain(port, domain) = |r, a| {
        let voltage = a[1].integer()? == 1;
        port(a, |n| r.set_analog_output_voltage(n, voltage).then_some(Value::None))
    };
    get_analog_in(n) = |_, a| port(a, |n| (0..4).contains(&n).then_some(Value::Float(0.0)));
    get_standard_analog_in(n) = |_, a| port(a, |n| (0..2).contains(&n).then_some(Value::Float(0.0)));
    get_tool_analog_in(n) = |_, a| port(a, |n| (0..2).contains(&n).then_some(Value::Float(0.0)));
    set_standard_analog_input_domain(port, domain) = |_, a| port(a, |n| (0..2).contains(&n).then_some(Value::None));
    set_tool_analog_input_domain(port, domain) = |_, a| port(a, |n| (0..2).contains(&n).then_some(Value::None));
    set_analog_inputrange(port, range) = |_, a| port(a, |n| (0..4).contains(&n).then_some(Value::None));

    // There is no tool with electronics of its own: its supply and its serial line do nothing.
    set_tool_voltage(voltage) = |_, a| match a[0].integer()? {
        0 | 12 | 24 => nothing(),
        _ => Err(ScriptError::ToolVoltage { value: a[0].float()? }),
    };
    set_tool_communication(enabled, baud_rate, parity, stop_bits, rx_idle_chars, tx_idle_chars) = |_, a| {
        a[0].truth()?;
        nothing()
    };
    get_tool_current() = |_, _| float(0.0);
}

fn port(a: &[Value], access: impl FnOnce(i32) -> Option<Value>) -> Done {
    let number = a[0].integer()?;
    let value = access(number).ok_or(ScriptError::NoPort { number })?;
    Ok(Outcome::Value(value))
}

fn switch(a: &[Value], first: i32, count: i32, set: impl FnOnce(i32, bool) -> bool) -> Done {
    let on = a[1].truth()?;
    port(a, |n| {
        ((0..count).contains(&n) && set(first + n, on)).then_some(Value::None)
    })
}

fn bit(a: &[Value], first: i32, count: i32, get: impl FnOnce(i32) -> Option<bool>) -> Done {
    port(a, |n| {
        let on = (0..count).contains(&n).then(|| get(first + n))?;
        on.map(Value::Bool)
    })
}

fn set_analog<'r>(a: &[Value], output: impl FnOnce(i32) -> Option<&'r mut f64>) -> Done {
    let share = super::arguments::or(&a[1], 0.0)?.clamp(0.0, 1.0);
    port(a, |n| {
        output(n).map(|x| {
            *x = share;
            Value::None
        })
    })
}

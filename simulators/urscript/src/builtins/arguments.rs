//! Arguments of built-in functions: defaults and bounds.

use std::ops::RangeInclusive;
use std::sync::Arc;

use crate::error::ScriptError;
use crate::value::Value;

/// The number, or `default` if it is left out.
pub fn or(value: &Value, default: f64) -> Result<f64, ScriptError> {
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

pub fn truth_or(value: &Value, default: bool) -> Result<bool, ScriptError> {
    match value {
        Value::None => Ok(default),
        given => given.truth(),
    }
}

pub fn text_or(value: &Value, default: &str) -> Result<Arc<str>, ScriptError> {
    match value {
        Value::None => Ok(default.into()),
        Value::Text(text) => Ok(text.clone()),
        other => Err(ScriptError::Kind {
            needed: "a text",
            found: other.kind(),
        }),
    }
}

pub fn within(
    function: &'static str,
    name: &'static str,
    value: f64,
    allowed: RangeInclusive<f64>,
) -> Result<f64, ScriptError> {
    if allowed.contains(&value) {
        return Ok(value);
    }
    Err(ScriptError::ArgumentOutOfRange {
        function,
        name,
        value,
        least: *allowed.start(),
        most: *allowed.end(),
    })
}

pub fn positive(value: &Value, default: f64, name: &'static str) -> Result<f64, ScriptError> {
    let x = or(value, default)?;
    if x > 0.0 {
        Ok(x)
    } else {
        Err(ScriptError::NotPositive { name, value: x })
    }
}

pub fn finite(x: [f64; 6]) -> Result<[f64; 6], ScriptError> {
    if x.iter().all(|x| x.is_finite()) {
        Ok(x)
    } else {
        Err(ScriptError::MotionNotFinite { numbers: x })
    }
}

//! Texts, and messages to the operator.

use super::arguments::truth_or;
use super::{Done, Outcome, Wait, bool, builtins, integer, nothing};
use crate::error::ScriptError;
use crate::value::Value;

builtins! {
    textmsg(s1, s2) = |r, a| { r.text_message(joined(a)); nothing() };
    popup(s, title, warning, error, blocking) = |r, a| {
        let text = a[0].to_string();
        r.text_message(text.clone());
        r.popup(text);
        if truth_or(&a[4], false)? {
            return Ok(Outcome::Wait(Wait::Popup));
        }
        nothing()
    };
    to_str(val) = |_, a| text(a[0].to_string());
    to_num(str) = |_, a| {
        let source = a[0].to_string();
        let trimmed = source.trim();
        if let Ok(n) = trimmed.parse::<i32>() {
            return integer(n);
        }
        match trimmed.parse::<f64>() {
            Ok(x) => super::float(x),
            Err(_) => Err(ScriptError::NoNumber { text: source }),
        }
    };
    str_cat(op1, op2) = |_, a| text(joined(a));
    str_len(str) = |_, a| integer(characters(&a[0])?.len() as i32);
    str_empty(str) = |_, a| bool(characters(&a[0])?.is_empty());
    str_at(src, index) = |_, a| {
        let index = a[1].integer()?;
        let found = usize::try_from(index).ok().and_then(|n| characters(&a[0]).ok()?.get(n).copied());
        match found {
            Some(c) => text(c.to_string()),
            None => Err(ScriptError::IndexOutOfRange { index }),
        }
    };
    str_sub(src, index, len) = |_, a| {
        let source = characters(&a[0])?;
        let index = a[1].integer()?;
        let from = usize::try_from(index).ok().filter(|n| *n <= source.len());
        let from = from.ok_or(ScriptError::IndexOutOfRange { index })?;
        // A negative length, or none, is the rest.
        let length = match &a[2] {
            Value::None => usize::MAX,
            given => usize::try_from(given.integer()?).unwrap_or(usize::MAX),
        };
        text(source[from..].iter().take(length).collect())
    };
    str_find(src, target, start_from) = |_, a| {
        let (source, target) = (characters(&a[0])?, characters(&a[1])?);
        let index = if a[2] == Value::None { 0 } else { a[2].integer()? };
        let from = usize::try_from(index).ok().filter(|n| *n <= source.len());
        let from = from.ok_or(ScriptError::IndexOutOfRange { index })?;
        let found = (from..=source.len()).find(|at| source[*at..].starts_with(&target));
        integer(found.map_or(-1, |at| at as i32))
    };
    assert(expression) = |_, a| {
        if a[0].truth()? { nothing() } else { Err(ScriptError::Asserted) }
    };
}

fn text(text: String) -> Done {
    Ok(Outcome::Value(Value::text(text)?))
}

fn characters(value: &Value) -> Result<Vec<char>, ScriptError> {
    match value {
        Value::Text(text) => Ok(text.chars().collect()),
        other => Err(ScriptError::Kind {
            needed: "a text",
            found: other.kind(),
        }),
    }
}

fn joined(a: &[Value]) -> String {
    a.iter()
        .filter(|v| **v != Value::None)
        .map(Value::to_string)
        .collect()
}

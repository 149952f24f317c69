//! TCP connections of a program.

use std::sync::Arc;

use super::arguments::{or, text_or, within};
use super::{Done, Outcome, Wait, bool, builtins, nothing};
use crate::error::ScriptError;
use crate::robot::Robot;
use crate::sockets::{Read, SocketWait};
use crate::value::Value;

/// Name of a connection whose name is left out.
const DEFAULT_NAME: &str = "socket_0";
/// Time after which an attempt to connect fails, s.
const CONNECT_S: f64 = 2.0;
/// Time after which a read fails if its timeout is left out, s.
const READ_S: f64 = 2.0;
/// Most numbers in one read.
const NUMBERS_MAX: f64 = 30.0;

builtins! {
    socket_open(address, port, socket_name) = |r, a| {
        let host = text_or(&a[0], "")?;
        let port = within("socket_open", "port", or(&a[1], 0.0)?, 1.0..=65_535.0)?;
        let name = text_or(&a[2], DEFAULT_NAME)?;
        r.sockets().open(&name, &host, port as u16);
        wait(r, SocketWait::new(name, Read::Connection, CONNECT_S))
    };
    socket_close(socket_name) = |r, a| { let name = text_or(&a[0], DEFAULT_NAME)?; r.sockets().close(&name); nothing() };
    socket_send_string(str, socket_name) = |r, a| send(r, &a[1], a[0].to_string().as_bytes());
    socket_send_line(str, socket_name) = |r, a| send(r, &a[1], format!("{}\n", a[0]).as_bytes());
    socket_send_int(value, socket_name) = |r, a| { let n = a[0].integer()?; send(r, &a[1], &n.to_be_bytes()) };
    socket_send_byte(value, socket_name) = |r, a| {
        let n = within("socket_send_byte", "value", or(&a[0], 0.0)?, 0.0..=255.0)?;
        send(r, &a[1], &[n as u8])
    };
    socket_set_var(name, value, socket_name) = |r, a| {
        let line = format!("SET {} {}\n", text_or(&a[0], "")?, a[1].integer()?);
        send(r, &a[2], line.as_bytes())
    };
    socket_get_var(name, socket_name) = |r, a| {
        let name = text_or(&a[0], "")?;
        send(r, &a[1], format!("GET {name}\n").as_bytes())?;
        read(r, &a[1], Read::Variable(name), &Value::None)
    };
    socket_read_ascii_float(number, socket_name, timeout) = |r, a| read(r, &a[1], Read::Floats(count(a)?), &a[2]);
    socket_read_binary_integer(number, socket_name, timeout) = |r, a| read(r, &a[1], Read::Integers(count(a)?), &a[2]);
    socket_read_byte_list(number, socket_name, timeout) = |r, a| read(r, &a[1], Read::Bytes(count(a)?), &a[2]);
    socket_read_line(socket_name, timeout) = |r, a| read(r, &a[0], Read::Line, &a[1]);
    socket_read_string(socket_name, prefix, suffix, interpret_escape, timeout) = |r, a| {
        let escapes = super::arguments::truth_or(&a[3], false)?;
        let mark = |value: &Value| -> Result<Arc<str>, ScriptError> {
            let text = text_or(value, "")?;
            Ok(if escapes { unescaped(&text).into() } else { text })
        };
        let (prefix, suffix) = (mark(&a[1])?, mark(&a[2])?);
        read(r, &a[0], Read::Text { prefix, suffix }, &a[4])
    };
}

fn send(r: &mut dyn Robot, name: &Value, bytes: &[u8]) -> Done {
    let name = text_or(name, DEFAULT_NAME)?;
    bool(r.sockets().send(&name, bytes))
}

fn count(a: &[Value]) -> Result<usize, ScriptError> {
    let number = f64::from(a[0].integer()?);
    Ok(within("socket_read", "number", number, 1.0..=NUMBERS_MAX)? as usize)
}

fn read(r: &mut dyn Robot, name: &Value, read: Read, timeout: &Value) -> Done {
    let name = text_or(name, DEFAULT_NAME)?;
    wait(r, SocketWait::new(name, read, or(timeout, READ_S)?))
}

/// A failure counts in the next frame, so that a loop over a closed connection takes its turns.
fn wait(r: &mut dyn Robot, wait: SocketWait) -> Done {
    if wait.is_for_connection() {
        return Ok(Outcome::Wait(Wait::Socket(wait)));
    }
    Ok(match wait.now(r.sockets())? {
        Some(value) => Outcome::Value(value),
        None => Outcome::Wait(Wait::Socket(wait)),
    })
}

fn unescaped(text: &str) -> String {
    let mut out = String::new();
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        let escaped = if c == '\\' { chars.next() } else { None };
        out.push(match escaped {
            Some('n') => '\n',
            Some('r') => '\r',
            Some('t') => '\t',
            Some('0') => '\0',
            Some(other) => other,
            None => c,
        });
    }
    out
}

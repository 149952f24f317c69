//! The controller's built-in functions, as far as bridges and clients use them.

mod arguments;
mod io;
mod motion;
mod numbers;
mod settings;
mod socket;
mod state;
mod text;

use crate::error::ScriptError;
use crate::robot::{Motion, Robot};
use crate::sockets::SocketWait;
use crate::value::Value;

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
    /// A connection, or what arrives over it.
    Socket(SocketWait),
    /// An operator who closes a message.
    Popup,
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

impl Builtin {
    /// Whether a thread that has used much of a frame goes on with it in the next one: a client may
    /// send faster than a program can read.
    pub fn takes_turns(&self) -> bool {
        self.name.starts_with("socket_read")
    }
}

macro_rules! builtins {
    ($($(#[$e:ident])? $name:ident($($parameter:ident),*) = $call:expr;)*) => {
        pub static BUILTINS: &[$crate::builtins::Builtin] = &[$($crate::builtins::Builtin {
            name: stringify!($name),
            parameters: &[$(stringify!($parameter)),*],
            e_series_only: $crate::builtins::builtins!(@$($e)?),
            call: $call,
        }),*];
    };
    (@e_series) => { true };
    (@) => { false };
}
use builtins;

/// The built-in function of this name.
pub fn find(name: &str, e_series: bool) -> Option<&'static Builtin> {
    [
        io::BUILTINS,
        motion::BUILTINS,
        numbers::BUILTINS,
        settings::BUILTINS,
        socket::BUILTINS,
        state::BUILTINS,
        text::BUILTINS,
    ]
    .into_iter()
    .flatten()
    .find(|b| b.name == name && (e_series || !b.e_series_only))
}

fn nothing() -> Done {
    Ok(Outcome::Value(Value::None))
}

fn float(x: f64) -> Done {
    Ok(Outcome::Value(Value::Float(x)))
}

fn integer(n: i32) -> Done {
    Ok(Outcome::Value(Value::Integer(n)))
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

fn list(items: Vec<Value>) -> Done {
    Ok(Outcome::Value(Value::list(items)?))
}

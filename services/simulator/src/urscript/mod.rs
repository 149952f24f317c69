//! The subset of URScript that a bridge's and a client's control program use: text to a running
//! program.
//!
//! [`Program::compile`] turns a program's text into instructions, [`Machine::frame`] runs them one
//! control cycle at a time against a [`Robot`]. Nothing here knows sockets, clocks or the simulated
//! arm. Whatever the text says, memory, recursion and time per frame are bounded.

mod builtins;
mod compile;
mod lexer;
mod machine;
mod names;
mod parser;
mod syntax;
#[cfg(test)]
mod tests;
mod value;

pub use builtins::{Motion, Robot};
pub use compile::Program;
pub use machine::{Frame, Machine, RuntimeError};
pub use value::Value;

/// Longest program text, bytes.
pub const PROGRAM_BYTES_MAX: usize = 1 << 20;

/// Why a text is no program.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {reason}")]
pub struct CompileError {
    /// Counted from 1.
    pub line: u32,
    /// Counted from 1.
    pub column: u32,
    /// What is wrong and what is allowed.
    pub reason: String,
    /// The text is well formed, but calls or reads a name that does not exist. The controller
    /// reports these on its ports; about a text that is not well formed it says nothing there.
    pub unknown_name: bool,
}

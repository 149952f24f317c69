//! Reasons why a program is refused.

/// Error of [`crate::Program::compile`]: the text is not a program that this controller runs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {reason}")]
pub struct CompileError {
    /// Line, counted from 1.
    pub line: u32,
    /// Column, counted from 1.
    pub column: u32,
    /// What is wrong and what is allowed.
    pub reason: String,
    /// The text is well formed, but calls or reads a name that does not exist. The controller
    /// reports these on its ports, but not texts that are not well formed.
    pub unknown_name: bool,
}

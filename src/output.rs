//! How a command ends: words or JSON on standard output, and an exit code.

use std::fmt;

use anyhow::Result;
use serde::Serialize;

/// How a command that ran to its end fared; its number is the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Outcome {
    /// Everything asked for was done.
    Done = 0,
    /// It was tried and did not work out.
    Failed = 1,
    /// What was given is not right: said file by file.
    Refused = 2,
    /// Done, but something was lost on the way.
    Lossy = 3,
}

/// A mistake in how the command was called or configured: exit code 2 instead of 1.
#[derive(Debug)]
pub struct BadUsage(pub String);

impl fmt::Display for BadUsage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadUsage {}

/// Wraps any configuration error as [`BadUsage`].
pub fn bad_usage(error: impl fmt::Display) -> anyhow::Error {
    BadUsage(error.to_string()).into()
}

/// Prints one JSON object.
///
/// # Errors
/// When the value cannot be written as JSON.
pub fn print_json(value: &impl Serialize) -> Result<()> {
    println!("{}", serde_json::to_string_pretty(value)?);
    Ok(())
}

/// Lets the program end quietly when its output is closed, as in
/// `tangent status | head`. To the standard library that is a panic; every other panic is told as
/// before.
pub fn end_with_the_reader() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let gone = panic
            .payload()
            .downcast_ref::<String>()
            .is_some_and(|said| {
                said.starts_with("failed printing to stdout") && said.contains("Broken pipe")
            });
        if gone {
            std::process::exit(Outcome::Done as i32);
        }
        tell(panic);
    }));
}

//! Result of a command: text or JSON on standard output, and an exit code.

use std::fmt;
use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;
use tangent_calibrate::CalibrateError;
use tangent_check::CheckError;
use tangent_client::ClientError;
use tangent_compose::ComposeError;
use tangent_faults::FaultsError;
use tangent_follow::FollowError;
use tangent_keys::KeysError;
use tangent_new_cell::NewCellError;
use tangent_simulated_cell::SimulatedCellError;

/// Outcome of a command that ran to its end; its number is the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Outcome {
    /// Everything requested was done.
    Done = 0,
    /// The command was tried and failed.
    Failed = 1,
    /// The input is invalid; messages per file say why.
    Refused = 2,
    /// Everything was done, but something was lost on the way.
    Lossy = 3,
}

/// An error in the call or configuration of the command: exit code 2 instead of 1.
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

/// The file that a command writes: `output`, or the one named by default. One that exists is
/// replaced only with --force.
///
/// # Errors
/// The file exists.
pub fn file_to_write(output: Option<&PathBuf>, default: String, force: bool) -> Result<PathBuf> {
    let file = output.cloned().unwrap_or_else(|| PathBuf::from(default));
    if file.exists() && !force {
        return Err(bad_usage(format!(
            "{} exists: choose another --output, or replace it with --force",
            file.display()
        )));
    }
    Ok(file)
}

/// Whether the user has to change the command or a file that it names: exit code 2. Every other
/// error is a failure.
pub fn is_usage(error: &anyhow::Error) -> bool {
    error.is::<BadUsage>()
        || error.is::<CheckError>()
        || matches!(error.downcast_ref(), Some(FaultsError::Usage(_)))
        || matches!(error.downcast_ref(), Some(KeysError::Usage(_)))
        || error.downcast_ref().is_some_and(NewCellError::is_usage)
        || matches!(error.downcast_ref(), Some(ClientError::NoSuchCell { .. }))
        || error.downcast_ref().is_some_and(ComposeError::is_usage)
        || error.downcast_ref().is_some_and(CalibrateError::is_usage)
        || error.downcast_ref().is_some_and(FollowError::is_usage)
        || error
            .downcast_ref()
            .is_some_and(SimulatedCellError::is_usage)
}

/// A number with this many decimals, or a dash. What rounds to zero has no sign.
pub fn or_dash(x: Option<f64>, digits: usize) -> String {
    let Some(x) = x else {
        return "-".to_owned();
    };
    let text = format!("{x:.digits$}");
    let zero = text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.'));
    text.strip_prefix('-')
        .filter(|_| zero)
        .map_or(text.clone(), str::to_owned)
}

/// Prints one JSON object.
///
/// # Errors
/// The value cannot be written as JSON.
pub fn print_json(value: &impl Serialize) -> Result<()> {
    println!("{}", serde_json::to_string_pretty(value)?);
    Ok(())
}

/// Lets the program end quietly if its output is closed, as in `tangent status | head`. The
/// standard library panics in this case; every other panic is reported as before.
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

#[cfg(test)]
mod tests {
    use super::or_dash;

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!(or_dash(Some(-0.000_4), 3), "0.000");
        assert_eq!(or_dash(Some(-0.0), 0), "0");
        assert_eq!(or_dash(Some(-0.000_6), 3), "-0.001");
        assert_eq!(or_dash(None, 3), "-");
    }
}

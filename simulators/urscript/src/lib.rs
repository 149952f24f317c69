//! The subset of URScript that bridges and third-party clients use in their control programs:
//! compiler and interpreter.
//!
//! [`Program::compile`] turns the text of a program into instructions. [`Machine::frame`] runs them
//! against a [`Robot`], one control cycle per call. The simulated UR controller
//! (`tangent-simulated-ur`) calls both; the fuzz targets call them with arbitrary text. No socket,
//! no clock and no arm is involved. For every text, memory, recursion depth and instructions per
//! frame are bounded.
//!
//! ```
//! use tangent_urscript::Program;
//!
//! let text = "def wipe():\n  speedj([0.1, 0, 0, 0, 0, 0], 1.0, 0.008)\n  stopj(2.0)\nend\n";
//! let program = Program::compile(text, false)?;
//! assert_eq!(program.name(), "wipe");
//!
//! let error = Program::compile("def wipe():\n  fly_away(1)\nend\n", false).unwrap_err();
//! assert!(error.unknown_name);
//! assert_eq!((error.line, error.column), (2, 3));
//! # Ok::<(), tangent_urscript::CompileError>(())
//! ```

mod builtins;
mod compile;
mod error;
mod lexer;
mod limits;
mod machine;
mod matrix;
mod names;
mod parser;
pub mod pose;
mod robot;
mod sockets;
mod syntax;
#[cfg(test)]
mod tests;
mod value;

pub use compile::Program;
pub use error::{CompileError, RuntimeError, ScriptError};
pub use lexer::PROGRAM_BYTES_MAX;
pub use machine::{Frame, Machine};
pub use robot::{Compliance, ForceModeTuning, Motion, Robot, TaskFrame};
pub use sockets::{SocketState, Sockets};
pub use value::Value;

//! Measures on this machine how long each step takes, how long a message takes over the bus, and
//! how soon a request is answered.
//!
//! - [`steps::run`] runs one step after another on the inputs of a simulated wipe.
//! - [`bus::run`] sends messages within one process and between processes, idle and loaded;
//!   [`peer::run`] is the other end of that measurement.
//! - [`requests::run`] stops the task of a private cell, with and without a flood of other
//!   requests.
//!
//! Each returns [`Row`]s of quantiles, which `tangent bench` prints with the [`Machine`].
//! [`fixtures`] holds the steps and their inputs; the Criterion benchmarks in `benches/steps.rs`
//! use them too.

pub mod bus;
mod error;
pub mod fixtures;
mod load;
pub mod peer;
mod python;
pub mod requests;
mod row;
pub mod steps;

pub use error::BenchError;
pub use row::{Machine, Row};

//! Recorder service: every topic of the cell to MCAP, and recordings read back.
//!
//! It listens to everything through a bounded queue of its own, so that a slow disk costs recorded
//! messages and never a publisher's time; what could not be written is counted and said.

mod cells;
mod config;
mod disk;
mod error;
mod files;
mod former;
mod inquiry;
mod keeper;
mod ledger;
mod message;
mod order;
mod packing;
mod pattern;
#[cfg(test)]
mod power_cut;
mod publisher;
mod recall;
mod recording;
pub mod repair;
mod retention;
mod service;
mod stream;
mod writer;

pub use config::RecorderConfig;
pub use disk::Disk;
pub use error::RecorderError;
pub use message::{Record, RecordedMessage};
pub use recording::Recording;
pub use service::{SERVICE, Summary, run, run_for};
pub use stream::RecordingStream;
pub use writer::{FileOptions, RecordingWriter};

//! Recorder service: writes every topic of the cell to MCAP files, and reads recordings back.
//!
//! It subscribes through a bounded queue, so that a slow disk never delays a publisher. Messages
//! that could not be written are counted and reported, and requested again from their publishers.
//!
//! [`run`] is the service, started by `tangent run recorder`. [`Recording`] and [`RecordingStream`]
//! read a file, [`RecordingWriter`] writes one, and [`repair`] repairs a truncated one.

mod cells;
mod config;
mod disk;
mod error;
mod files;
mod former;
mod inquiry;
mod keeper;
mod latched;
mod ledger;
mod message;
mod order;
mod outline;
mod packing;
mod pattern;
#[cfg(test)]
mod power_cut;
mod publisher;
mod reader;
mod recall;
mod recording;
mod records;
pub mod repair;
mod retention;
mod selection;
mod service;
mod stream;
mod unpacker;
mod utc_name;
mod walk;
mod writer;

pub use config::RecorderConfig;
pub use disk::Disk;
pub use error::RecorderError;
pub use message::{Record, RecordedMessage};
pub use pattern::matches_any;
pub use recording::Recording;
pub use selection::{Contents, Held, Stored};
pub use service::{Definitions, SERVICE, Summary, run, run_for};
pub use stream::RecordingStream;
pub use writer::{FileOptions, RecordingWriter};

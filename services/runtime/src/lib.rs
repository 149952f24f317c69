//! Framework of every service: bus, configuration, liveliness, health, parameters, shutdown.
//!
//! Every service has the shape `run(config, bus, stop)`: it reads a [`CellConfig`], communicates
//! through a [`Bus`], ends when its [`Stop`] is triggered, reports its state through a
//! [`HealthReporter`] and takes live [`Parameters`]. No other crate uses Zenoh directly.
//!
//! ```no_run
//! use std::time::Duration;
//! use tangent_runtime::{Bus, CellConfig, HealthReporter, Role, Stop};
//! use tangent_schemas::topics;
//!
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     let config = CellConfig::load("deploy/cell.toml".as_ref())?;
//!     let stop = Stop::on_signals()?;
//!     let bus = Bus::open_until(&config, Role::Client, None, &stop)?;
//!     let health = HealthReporter::start(&bus, "watcher")?;
//!     let states = bus.subscribe(&topics::ARM_STATE, 100)?;
//!     health.running();
//!     while !stop.is_stopped() {
//!         if let Some(received) = states.recv_timeout(Duration::from_millis(100)) {
//!             println!("{} {:?}", received.sequence, received.message.q);
//!         }
//!     }
//!     Ok(())
//! }
//! ```

pub mod arm_commands;
mod base_reader;
pub mod bus;
pub mod clock;
pub mod clock_offset;
pub mod config;
pub mod ending;
pub mod health;
pub mod log;
pub mod meter;
pub mod parameters;
pub mod places;
pub mod realtime;
pub mod ring;
pub mod robot_loop;
pub mod security;
mod state_folder;
pub mod stop;
pub mod systemd;
pub mod ticket;
mod usage;
pub mod watchdog;

pub use base_reader::BaseReader;
pub use bus::{
    Alive, AliveToken, Asked, Attachment, Bus, BusError, Counts, Handle, Lane, Latest,
    PlainPublisher, PlainQuery, PlainSample, PlainSession, Publisher, PushedOut, Question,
    RawMessage, RawPublisher, RawSubscription, Received, Refused, Reply, Role, SPANS_MAX, Span,
    Subscription,
};
pub use config::{CellConfig, ConfigError};
pub use health::{HealthReporter, State};
pub use meter::{Age, Counter, Gauge, Histogram, Rate};
pub use parameters::{Parameter, Parameters, Ramp};
pub use realtime::RealtimeReport;
pub use state_folder::{StateError, StateFolder};
pub use stop::Stop;
pub use watchdog::Beat;

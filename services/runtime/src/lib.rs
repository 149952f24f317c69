//! The one way to be a service: bus, configuration, liveliness, health, parameters, shutdown.
//!
//! Every service has the shape `run(config, bus, stop)`: it reads a [`CellConfig`], speaks through a [`Bus`], ends
//! when its [`Stop`] says so, tells how it fares through a [`HealthReporter`] and takes live [`Parameters`]. Zenoh is
//! named nowhere else.

pub mod bus;
pub mod clock;
pub mod config;
pub mod health;
pub mod meter;
pub mod parameters;
pub mod realtime;
pub mod stop;

pub use bus::{
    Alive, AliveToken, Bus, BusError, Counts, Handle, Latest, Publisher, RawMessage, RawPublisher,
    RawSubscription, Received, Role, Subscription,
};
pub use config::{CellConfig, ConfigError};
pub use health::{HealthReporter, State};
pub use meter::{Age, Counter, Gauge, Histogram, Rate};
pub use parameters::{Parameter, Parameters, Ramp};
pub use realtime::RealtimeReport;
pub use stop::Stop;

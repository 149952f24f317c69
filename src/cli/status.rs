//! `tangent status` and `tangent health`.

use clap::Args;

use super::seconds::waiting_time;

/// Options of `tangent status`.
#[derive(Debug, Args)]
pub struct Status {
    /// Show every cell on the router's network, not only this one.
    #[arg(long)]
    pub all: bool,
    /// Show one line per service, and refresh it in place until Ctrl-C.
    #[arg(long)]
    pub watch: bool,
}

/// Options of `tangent health`.
#[derive(Debug, Args)]
pub struct Health {
    /// Services: router, netft, rtde, franka, camera, estimator, controller, recorder, ros2,
    /// simulator, or one that you added.
    #[arg(required = true)]
    pub services: Vec<String>,
    /// Only services on this host, or in this container.
    #[arg(long)]
    pub here: bool,
    /// Seconds to wait for a service's health message, which is published once a second.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = waiting_time)]
    pub patience_s: f64,
}

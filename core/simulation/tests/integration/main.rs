//! Integration tests of this crate, in one binary: each links the whole crate once more.

// The tests of `core` read scenarios, print tables and measure time; `core` itself does not.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_macros,
    clippy::disallowed_methods
)]

mod any_torque_input;
mod any_world;
mod covariance;
mod coverage;
mod covered_surfaces;
mod dead_sensor;
mod deaf_sensor;
mod depth_normal;
mod depth_scenes;
mod energy_balance;
mod late_arm;
mod learning;
mod moving_base;
mod nees;
mod object_pose;
mod opposed_retraction;
mod other_arms;
mod pause;
mod pushed;
mod scenarios;
mod sensor_faults;
mod shown_force;
mod stated;
mod suite;
mod swap;
mod tactile;
mod tactile_cells;
mod tactile_energy;
mod tactile_passivity;
mod tactile_step;
mod three_laws;
mod torque_truth;
mod touchdown;
mod travel_touch;
mod truth;
mod waves;

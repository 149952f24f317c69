//! Whole cells on loopback with one process per service, driven by the `tangent` command as a
//! user would.

#![allow(clippy::unwrap_used)]

mod calibration;
mod cell;
mod commands;
#[path = "../common/mod.rs"]
mod common;
mod endings;
mod failures;
mod franka;
mod impostor;
mod learning;
mod object;
mod priorities;
mod recordings;
mod requests;
mod restarts;
mod robot;
mod scan;
mod teach;
mod terminal;
mod topics;

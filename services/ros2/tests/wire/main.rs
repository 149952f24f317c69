//! The service at the wire: a plain Zenoh session in place of a program of ROS 2.

#![allow(clippy::unwrap_used)]

mod commands;
mod common;
mod inputs;
mod package;
mod states;

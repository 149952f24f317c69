//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod bridge;
mod common;
mod dashboard_and_scripts;
mod external_control;
mod hand_guiding;
mod primary_state;

mod rtde;
mod script_clients;
mod script_sockets;
mod ur_rtde;

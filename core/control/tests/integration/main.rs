//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod any_input;
mod bench;
mod controller;
mod moving_base;
mod pause;
mod task_files;
mod travel;

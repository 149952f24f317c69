//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod base;
mod common;
mod requests;
mod swap;
mod task;

//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod common;
mod definitions;
mod independent;

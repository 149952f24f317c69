//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod interop;
mod killed;
mod mending;
mod packing;
mod restart;
mod selection;

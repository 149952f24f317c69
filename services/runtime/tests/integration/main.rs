//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod access;
mod bounds;
mod cell_file;
mod common;
mod ending;
mod far_lane;
mod images;
mod listeners;
mod near_lane;
mod python;
mod recall;
mod second_publishers;

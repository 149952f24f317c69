//! Integration tests of this crate, in one binary: each links the whole crate once more.

#![allow(clippy::unwrap_used)]

mod accuracy;
mod creeps;
mod depth_normal;
mod noise;
mod object_pose_step;
mod robustness;
mod samples;
mod synthetic;
mod tilts;
mod touches;
mod weak_touches;

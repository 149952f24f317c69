//! Compares `depth_normal` with the pipeline of PCL 1.13 on the same frames in one run: time per
//! frame, error and coverage.
//!
//! `cargo run --release -p tangent-simulation --example depth_against_pcl [WIDTH HEIGHT FOCAL_PX]`
#![allow(clippy::disallowed_methods, clippy::disallowed_macros)]

#[path = "../tests/integration/depth_scenes/mod.rs"]
mod depth_scenes;

use depth_scenes::table::{self, Options};

fn main() {
    let given: Vec<usize> = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse().ok())
        .collect();
    let mut options = Options::default();
    if let [width, height, focal, ..] = given[..] {
        options.image_px = [width, height];
        options.focal_px = focal as f64;
    }
    let (table, _) = table::side_by_side(&options);
    println!("{table}");
}

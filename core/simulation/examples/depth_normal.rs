//! Normals from depth for each scene: error, coverage and time of each part.
//!
//! `cargo run --release -p tangent-simulation --example depth_normal [WIDTH HEIGHT FOCAL]`
#![allow(
    clippy::disallowed_methods,
    clippy::disallowed_macros,
    clippy::unwrap_used
)]

#[path = "../tests/integration/depth_scenes/mod.rs"]
mod depth_scenes;

use std::time::Instant;

use depth_scenes::{errors_deg, image, median, metres, scenes, true_normals};
use tangent_estimation::depth_normal::{
    DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, ToolTarget,
};
use tangent_mechanics::Pose;
use tangent_simulation::depth_camera::{DepthCamera, DepthNoiseConfig};

fn main() {
    let arguments: Vec<f64> = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse().ok())
        .collect();
    let (size, focal) = match arguments[..] {
        [width, height, focal, ..] => ([width as usize, height as usize], focal),
        _ => ([640, 480], 385.0),
    };
    let sd = arguments.get(3).copied().unwrap_or(0.0015);
    let share = arguments.get(4).copied().unwrap_or(0.05);
    let noise = DepthNoiseConfig {
        sd_at_half_metre_m: sd,
        neighbour_share: share,
        ..DepthNoiseConfig::default()
    };
    let step = DepthNormal::new(&DepthNormalConfig::default()).unwrap();
    println!(
        "| scene | error median deg | p90 deg | covered % | render ms | step ms | every pixel ms |"
    );
    println!("|---|---|---|---|---|---|---|");
    for scene in scenes(size, focal, noise) {
        let mut camera = DepthCamera::new(&scene.camera, &Pose::identity(), 1).unwrap();
        let mut state = DepthNormalState::default();
        let mut normals = vec![[0.0; 3]; size[0] * size[1]];
        let mut errors = Vec::new();
        let (mut covered, mut with_depth) = (0, 0);
        let mut times = [const { Vec::new() }; 3];
        let mut per_view = String::new();
        for (k, pose) in scene.base_from_flange.iter().enumerate() {
            let begin = Instant::now();
            let frame = camera.picture(0.0, k as u64, pose, &scene.surface);
            times[0].push(begin.elapsed().as_secs_f64() * 1e3);
            let depth_m = metres(&frame);
            let image = image(&frame, &depth_m);
            let sample = DepthSample {
                time_s: frame.time_s,
                image,
                intrinsics: frame.intrinsics,
                target: ToolTarget::Pixel([size[0] as f64 / 2.0, size[1] as f64 / 2.0]),
                left_out: None,
                travel: Some(nalgebra::Vector3::x()),
            };
            let mut result = None;
            for _ in 0..20 {
                let begin = Instant::now();
                result = Some(step.update(&mut state, &sample));
                times[1].push(begin.elapsed().as_secs_f64() * 1e3);
                let begin = Instant::now();
                step.normals(&state, &image, &mut normals);
                times[2].push(begin.elapsed().as_secs_f64() * 1e3);
            }
            let result = result.unwrap();
            let truth = true_normals(&camera, &scene, pose, &frame);
            with_depth += frame.depth_mm.iter().filter(|d| **d > 0).count();
            covered += normals
                .iter()
                .zip(&frame.depth_mm)
                .filter(|(n, d)| **d > 0 && **n != [0.0; 3])
                .count();
            let mut here = errors_deg(&normals, &truth);
            per_view += &format!(" {:.2}", median(&mut here));
            errors.extend(here);
            if k == 0 || k == 5 {
                println!(
                    "  {:?} r {:.3} cells {} k {:?} ahead {} {:?} seg {} noise {:?}",
                    result.validity,
                    result.patch_radius_m,
                    result.patch_cells,
                    result.principal_curvatures_per_m,
                    result.ahead.stations.len(),
                    result.ahead.end,
                    result.segments,
                    result.noise
                );
            }
        }
        let p90 = {
            errors.sort_by(f64::total_cmp);
            errors[errors.len() * 9 / 10]
        };
        let [render, update, fill] = times.map(|mut t: Vec<f64>| {
            (
                median(&mut t),
                t.iter().copied().fold(f64::INFINITY, f64::min),
            )
        });
        println!(
            "| {} | {:.3} | {:.3} | {:.2} | {:.2} | {:.2} ({:.2}) | {:.2} ({:.2}) | {per_view}",
            scene.name,
            median(&mut errors),
            p90,
            100.0 * f64::from(covered as u32) / f64::from(with_depth as u32),
            render.0,
            update.0,
            update.1,
            fill.0,
            fill.1,
        );
    }
}

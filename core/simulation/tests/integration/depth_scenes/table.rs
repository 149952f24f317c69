//! Compares `depth_normal` and PCL on the same frames in one run, one thread each, as a table.

use std::fmt::Write as _;
use std::time::Instant;

use nalgebra::Vector3;
use tangent_estimation::depth_normal::{
    DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, PixelNormal, ToolTarget,
};
use tangent_mechanics::Pose;
use tangent_simulation::depth_camera::{DepthCamera, DepthFrame, DepthNoiseConfig};

use super::pcl::{Pcl, truth_at_points};
use super::{DepthScene, errors_deg, image, median, metres, scenes, true_normals};

/// Settings of the comparison.
pub struct Options {
    pub image_px: [usize; 2],
    pub focal_px: f64,
    pub errors: DepthNoiseConfig,
    pub repeats: u32,
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            image_px: [640, 480],
            focal_px: 385.0,
            errors: DepthNoiseConfig::default(),
            repeats: 9,
            seed: 1,
        }
    }
}

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    pub scene: &'static str,
    pub method: String,
    pub fastest_ms: f64,
    pub median_ms: f64,
    pub error_deg: f64,
    /// Share of pixels with depth that have a normal; for PCL, normals per pixel with depth.
    pub covered: f64,
}

/// The frames of a scene with their true normals.
pub struct Taken {
    pub frames: Vec<DepthFrame>,
    pub truth: Vec<Vec<PixelNormal>>,
}

pub fn take(scene: &DepthScene, seed: u64) -> Taken {
    let mut camera =
        DepthCamera::new(&scene.camera, &Pose::identity(), seed).expect("sound settings");
    let mut taken = Taken {
        frames: Vec::new(),
        truth: Vec::new(),
    };
    for (k, pose) in scene.base_from_flange.iter().enumerate() {
        let frame = camera.picture(0.0, k as u64, pose, &scene.surface);
        taken.truth.push(true_normals(&camera, scene, pose, &frame));
        taken.frames.push(frame);
    }
    taken
}

/// Runs `depth_normal` on a scene: its complete step, and a normal for every pixel.
pub fn ours(scene: &DepthScene, taken: &Taken, config: &DepthNormalConfig, repeats: u32) -> Row {
    let step = DepthNormal::new(config).expect("sound settings");
    let mut state = DepthNormalState::default();
    let (mut times, mut errors) = (Vec::new(), Vec::new());
    let (mut covered, mut with_depth) = (0usize, 0usize);
    for (frame, truth) in taken.frames.iter().zip(&taken.truth) {
        let depth_m = metres(frame);
        let image = image(frame, &depth_m);
        let mut normals = vec![[0.0; 3]; depth_m.len()];
        let sample = DepthSample {
            time_s: frame.time_s,
            image,
            intrinsics: frame.intrinsics,
            target: ToolTarget::Pixel([frame.width as f64 / 2.0, frame.height as f64 / 2.0]),
            left_out: None,
            travel: Some(Vector3::x()),
        };
        for _ in 0..repeats {
            let begin = Instant::now();
            std::hint::black_box(step.update(&mut state, &sample));
            step.normals(&state, &image, &mut normals);
            times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        errors.extend(errors_deg(&normals, truth));
        let seen = normals.iter().zip(&depth_m).filter(|(_, z)| **z > 0.0);
        for (normal, _) in seen {
            with_depth += 1;
            covered += usize::from(*normal != [0.0; 3]);
        }
    }
    Row {
        scene: scene.name,
        method: "depth_normal".to_owned(),
        fastest_ms: times.iter().copied().fold(f64::INFINITY, f64::min),
        median_ms: median(&mut times),
        error_deg: median(&mut errors),
        covered: covered as f64 / with_depth as f64,
    }
}

/// Runs PCL on a scene.
pub fn theirs(
    pcl: &Pcl,
    scene: &DepthScene,
    taken: &Taken,
    leaf_m: f64,
    neighbours: u32,
    repeats: u32,
) -> Result<Row, String> {
    let (mut fastest, mut medians, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    let (mut normals, mut with_depth) = (0usize, 0usize);
    let done = pcl.run(&taken.frames, leaf_m, neighbours, repeats)?;
    for ((frame, truth), result) in taken.frames.iter().zip(&taken.truth).zip(done) {
        fastest.push(result.fastest_ms);
        medians.push(result.median_ms);
        let there = truth_at_points(frame, truth, &result.points);
        let found: Vec<PixelNormal> = result.points.iter().map(|(_, n)| *n).collect();
        errors.extend(errors_deg(&found, &there));
        normals += found.len();
        with_depth += frame.depth_mm.iter().filter(|mm| **mm > 0).count();
    }
    Ok(Row {
        scene: scene.name,
        method: match leaf_m > 0.0 {
            true => format!(
                "PCL, {:.0} mm voxels, {neighbours} neighbours",
                leaf_m * 1e3
            ),
            false => format!("PCL, full cloud, {neighbours} neighbours"),
        },
        fastest_ms: fastest.iter().copied().fold(f64::INFINITY, f64::min),
        median_ms: median(&mut medians),
        error_deg: median(&mut errors),
        covered: normals as f64 / with_depth as f64,
    })
}

/// The whole table, and whether PCL was available.
pub fn side_by_side(options: &Options) -> (String, Vec<Row>) {
    let pcl = Pcl::build();
    let mut rows = Vec::new();
    let mut skipped = String::new();
    if let Err(why) = &pcl {
        skipped = format!("\nPCL: skipped, because {why}\n");
    }
    for scene in scenes(options.image_px, options.focal_px, options.errors) {
        let taken = take(&scene, options.seed);
        rows.push(ours(
            &scene,
            &taken,
            &DepthNormalConfig::default(),
            options.repeats,
        ));
        let Ok(pcl) = &pcl else { continue };
        for neighbours in [10, 20, 40] {
            match theirs(pcl, &scene, &taken, 0.01, neighbours, options.repeats) {
                Ok(row) => rows.push(row),
                Err(why) => skipped = format!("\nPCL failed: {why}\n"),
            }
        }
    }
    let mut text = String::from(
        "| scene | method | fastest ms | median ms | median error deg | normals per pixel with depth |\n|---|---|---|---|---|---|\n",
    );
    for r in &rows {
        let _ = writeln!(
            text,
            "| {} | {} | {:.2} | {:.2} | {:.2} | {:.4} |",
            r.scene, r.method, r.fastest_ms, r.median_ms, r.error_deg, r.covered
        );
    }
    (text + &skipped, rows)
}

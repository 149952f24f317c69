//! A simulated depth camera on the flange, such as a D435i: depth images of the surface, with the
//! errors of stereo and the delay of the driver.
//!
//! Called by the simulator and by the closed loop of `evaluate`. Equal configuration and seed give
//! equal frames, in whatever order the poses come.

mod config;
mod correlated;
mod noise;
mod render;
mod scene;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tangent_estimation::depth_normal::Intrinsics;
use tangent_mechanics::{Base, Flange, Pose, Tool};

pub use config::{DepthCameraConfig, DepthCameraError, DepthNoiseConfig, ToolInViewConfig};
pub use scene::{Scene, Thing};

use crate::surfaces::Surface;
use crate::true_value::True;
use noise::StereoNoise;
use render::Renderer;

/// Largest number of frames in transit at once; beyond it the oldest is dropped.
const FRAMES_MAX: usize = 32;
/// Tolerance of the rendering, in standard deviations of a pixel.
const TOLERANCE_SD: f64 = 0.03;
/// Smallest tolerance of the rendering, for a camera without noise, 1/m: a twentieth of a
/// millimetre at half a metre.
const TOLERANCE_MIN: f64 = 2e-4;

/// One depth image, as `sensor_msgs/Image` in 16UC1 would carry it.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFrame {
    /// Time of exposure, s.
    pub time_s: f64,
    /// Time at which the driver delivers the frame, s.
    pub arrives_s: f64,
    /// Number of the frame, counted from 0.
    pub sequence: u64,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Intrinsics of this image.
    pub intrinsics: Intrinsics,
    /// Depth, row by row, mm; 0 for no reading.
    pub depth_mm: Vec<u16>,
}

/// The camera and its frames in transit.
pub struct DepthCamera {
    config: DepthCameraConfig,
    stated_flange_from_camera: Isometry3<f64>,
    flange_from_camera: True<Isometry3<f64>>,
    seed: u64,
    intrinsics: Intrinsics,
    renderer: Renderer,
    noise: StereoNoise,
    /// Inverse depth of the tool, 1/m, equal in every frame, as both are fixed to the flange.
    tool: Option<Vec<f32>>,
    truth: Vec<f32>,
    frames_taken: u64,
    under_way: VecDeque<DepthFrame>,
}

impl DepthCamera {
    /// Creates a camera; `seed` determines the error of its mounting. `flange_from_tool` places the
    /// tool in front of the lens, if the configuration has one.
    ///
    /// # Errors
    /// A setting is out of its range.
    pub fn new(
        config: &DepthCameraConfig,
        flange_from_tool: &Pose<Flange, Tool>,
        seed: u64,
    ) -> Result<Self, DepthCameraError> {
        config.check()?;
        let [width, height] = config.sent_px();
        let intrinsics = config.intrinsics();
        let stated_flange_from_camera = config.flange_from_camera.isometry();
        let flange_from_camera = mounted(config, seed);
        let tool = config.tool.map(|tool| {
            let camera_from_tool = flange_from_camera.inverse() * flange_from_tool.isometry();
            let mut rod = vec![0.0; width * height];
            for (i, w) in rod.iter_mut().enumerate() {
                let ray = intrinsics.ray((i % width) as f64, (i / width) as f64);
                *w = rod_inverse_depth(&camera_from_tool, &tool, ray) as f32;
            }
            rod
        });
        Ok(Self {
            stated_flange_from_camera,
            flange_from_camera: True::new(flange_from_camera),
            seed,
            intrinsics,
            renderer: Renderer::new(width, height),
            noise: StereoNoise::new(&config.noise, config.range_m, [width, height], seed),
            tool,
            truth: vec![0.0; width * height],
            frames_taken: 0,
            under_way: VecDeque::new(),
            config: config.clone(),
        })
    }

    /// Intrinsics of the images sent.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Stated pose of the camera on the flange.
    pub fn flange_from_camera(&self) -> Pose<Flange, tangent_mechanics::Camera> {
        Pose::from_isometry(self.stated_flange_from_camera)
    }

    /// Scene that the camera sees from a flange pose: the truth behind a frame.
    pub fn scene<'a>(
        &self,
        base_from_flange: &Pose<Base, Flange>,
        surface: &'a Surface,
    ) -> Scene<'a> {
        Scene::new(
            surface,
            base_from_flange.isometry() * self.flange_from_camera.to_compare(),
            self.config.extent_m,
            self.config.table_height_m,
            self.config.range_m[1],
        )
    }

    /// Exposes a frame if one is due at `time_s`; returns whether it did.
    pub fn expose(
        &mut self,
        time_s: f64,
        base_from_flange: &Pose<Base, Flange>,
        surface: &Surface,
    ) -> bool {
        if self.config.rate_hz <= 0.0
            || time_s + 1e-9 < self.frames_taken as f64 / self.config.rate_hz
        {
            return false;
        }
        let sequence = self.frames_taken;
        let frame = self.picture(time_s, sequence, base_from_flange, surface);
        // The next frame is due one period later, however late this one was requested.
        let due = (time_s * self.config.rate_hz + 1e-6).floor() as u64;
        self.frames_taken = sequence.max(due) + 1;
        if self.under_way.len() == FRAMES_MAX {
            self.under_way.pop_front();
        }
        self.under_way.push_back(frame);
        true
    }

    /// Renders the frame with this number, independent of earlier exposures.
    pub fn picture(
        &mut self,
        time_s: f64,
        sequence: u64,
        base_from_flange: &Pose<Base, Flange>,
        surface: &Surface,
    ) -> DepthFrame {
        let mixed = self.seed ^ (sequence + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut rng = Pcg64Mcg::seed_from_u64(mixed ^ 0xdeb7_4ca3_e7a0_0001);
        let scene = self.scene(base_from_flange, surface);
        let sd = StereoNoise::inverse_sd(&self.config.noise);
        let tolerance = (TOLERANCE_SD * sd).max(TOLERANCE_MIN);
        self.renderer
            .render(&scene, &self.intrinsics, tolerance, &mut self.truth);
        if let Some(tool) = &self.tool {
            for (w, rod) in self.truth.iter_mut().zip(tool) {
                *w = w.max(*rod);
            }
        }
        let [width, height] = self.config.sent_px();
        let mut depth_mm = vec![0; width * height];
        self.noise.apply(
            time_s,
            &self.truth,
            &self.intrinsics,
            &mut rng,
            &mut depth_mm,
        );
        let [soonest, latest] = self.config.delay_s;
        let delay = soonest + (latest - soonest) * rng.random::<f64>();
        DepthFrame {
            time_s,
            arrives_s: time_s + delay,
            sequence,
            width,
            height,
            intrinsics: self.intrinsics,
            depth_mm,
        }
    }

    /// True inverse depth of the last frame before noise, 1/m; 0 where nothing is visible.
    pub fn truth(&self) -> &[f32] {
        &self.truth
    }

    /// The next frame, in the order of exposure, if it has arrived by `time_s`.
    pub fn take(&mut self, time_s: f64) -> Option<DepthFrame> {
        let arrived = self.under_way.front()?.arrives_s <= time_s + 1e-9;
        if arrived {
            self.under_way.pop_front()
        } else {
            None
        }
    }
}

/// True pose of the camera on the flange; bit for bit the stated one if it has no error.
fn mounted(config: &DepthCameraConfig, seed: u64) -> Isometry3<f64> {
    let stated = config.flange_from_camera.isometry();
    let (position, turn) = (config.position_error_m, config.orientation_error_rad);
    if position == 0.0 && turn == 0.0 {
        return stated;
    }
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x1f6b_d0a8_93e7_524c);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-1.0..=1.0) * size);
    let (position, turn) = (vector(position), vector(turn));
    Isometry3::from_parts(
        (stated.translation.vector + position).into(),
        UnitQuaternion::from_scaled_axis(turn) * stated.rotation,
    )
}

/// Inverse depth of the rod along the tool's z axis, from its origin backwards, on the ray
/// `[x/z, y/z]`; 0 beside it.
fn rod_inverse_depth(
    camera_from_tool: &Isometry3<f64>,
    tool: &ToolInViewConfig,
    ray: [f64; 2],
) -> f64 {
    let tool_from_camera = camera_from_tool.inverse();
    let origin = tool_from_camera.translation.vector;
    let direction = tool_from_camera.rotation * Vector3::new(ray[0], ray[1], 1.0);
    let (o, d) = (origin.xy(), direction.xy());
    let (a, b) = (d.norm_squared(), o.dot(&d));
    let c = o.norm_squared() - tool.radius_m * tool.radius_m;
    let discriminant = b * b - a * c;
    if a == 0.0 || discriminant < 0.0 {
        return 0.0;
    }
    let root = discriminant.sqrt();
    let (mut enter, mut leave) = ((-b - root) / a, (-b + root) / a);
    // Between the ends, -length and 0 along the axis.
    let (z, rise) = (origin.z, direction.z);
    if rise == 0.0 {
        if z > 0.0 || z < -tool.length_m {
            return 0.0;
        }
    } else {
        let (one, two) = (-z / rise, (-tool.length_m - z) / rise);
        enter = enter.max(one.min(two));
        leave = leave.min(one.max(two));
    }
    if enter <= leave && enter > 1e-3 {
        1.0 / enter
    } else {
        0.0
    }
}

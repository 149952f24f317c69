//! Normals from rendered depth images: the simulated depth camera followed by `depth_normal`, as in
//! the live system.

use std::collections::VecDeque;

use nalgebra::Vector3;
use tangent_control::{BendChange, VisionInput};
use tangent_estimation::depth_normal::{
    DepthImage, DepthNormal, DepthNormalConfig, DepthNormalState, DepthSample, SurfaceAhead,
    ToolTarget, leave_out_rod, metres_from_millimetres,
};
use tangent_mechanics::{Base, Camera, Flange, Pose, Tool};

use super::depth_camera::{DepthCamera, DepthCameraConfig};
use crate::plant_error::PlantError;
use crate::surfaces::Surface;
use crate::true_value::True;

/// Number of poses kept for frames in transit.
const POSES_MAX: usize = 64;
/// Width of the mask around the tool beyond its radius, m: pixels at its edge have wrong depths.
const MASK_MARGIN_M: f64 = 0.004;
/// Speed below which the tool counts as standing still and has no direction of travel, m/s.
const TRAVEL_MIN_M_PER_S: f64 = 0.005;

/// Camera, estimator, and pose of the arm at the exposure of each frame.
pub struct DepthSource {
    camera: DepthCamera,
    estimator: DepthNormal,
    state: DepthNormalState,
    flange_from_camera: Pose<Flange, Camera>,
    /// Stated position of the tool, camera axes, m.
    tool: Vector3<f64>,
    left_out: Vec<u8>,
    depth_m: Vec<f32>,
    /// Time (s), flange pose, and velocity of the tool (base axes, m/s).
    poses: VecDeque<(f64, Pose<Base, Flange>, Vector3<f64>)>,
    frames: u64,
}

impl DepthSource {
    /// Camera that sees the tool where it truly is, and estimator that knows where it is stated to
    /// be.
    ///
    /// # Errors
    /// A setting of the camera or of the estimator is out of its range.
    pub fn new(
        camera: &DepthCameraConfig,
        estimator: &DepthNormalConfig,
        flange_from_tool: &Pose<Flange, Tool>,
        true_flange_from_tool: &True<Pose<Flange, Tool>>,
        seed: u64,
    ) -> Result<Self, PlantError> {
        let (size, rod) = (camera.sent_px(), camera.tool);
        let camera = DepthCamera::new(camera, true_flange_from_tool.to_compare(), seed)?;
        let flange_from_camera = camera.flange_from_camera();
        let camera_from_tool = flange_from_camera.inverse() * *flange_from_tool;
        let tool = camera_from_tool.translation();
        let mut left_out = vec![0; size[0] * size[1]];
        if let Some(rod) = rod {
            let end = tool - camera_from_tool.z_axis() * rod.length_m;
            let radius = rod.radius_m + MASK_MARGIN_M;
            leave_out_rod(
                &camera.intrinsics(),
                size,
                [&tool, &end],
                radius,
                &mut left_out,
            );
        }
        Ok(Self {
            camera,
            estimator: DepthNormal::new(estimator)?,
            state: DepthNormalState::default(),
            flange_from_camera,
            tool,
            left_out,
            depth_m: Vec::new(),
            poses: VecDeque::new(),
            frames: 0,
        })
    }

    /// Exposes a frame if one is due at `time_s`, at the true flange pose. `measured` is what the
    /// arm measures then: the flange pose, and the velocity of the tool's origin (base axes, m/s).
    pub fn expose(
        &mut self,
        time_s: f64,
        base_from_flange: &True<Pose<Base, Flange>>,
        measured: (Pose<Base, Flange>, Vector3<f64>),
        surface: &Surface,
    ) {
        let seen = self
            .camera
            .expose(time_s, base_from_flange.to_compare(), surface);
        if seen {
            let (base_from_flange, velocity) = measured;
            self.frames += 1;
            if self.poses.len() == POSES_MAX {
                self.poses.pop_front();
            }
            self.poses.push_back((time_s, base_from_flange, velocity));
        }
    }

    /// Estimate from the newest frame that has arrived since the last call.
    pub fn take(&mut self, time_s: f64) -> Option<VisionInput> {
        let mut newest = None;
        while let Some(frame) = self.camera.take(time_s) {
            newest = Some(frame);
        }
        let frame = newest?;
        let (_, base_from_flange, velocity) = *self
            .poses
            .iter()
            .find(|(at, ..)| (at - frame.time_s).abs() < 1e-9)?;
        let base_from_camera = base_from_flange * self.flange_from_camera;
        let travels = velocity.norm() > TRAVEL_MIN_M_PER_S;
        metres_from_millimetres(&frame.depth_mm, &mut self.depth_m);
        let image = DepthImage::new(frame.width, frame.height, &self.depth_m)?;
        let seen = self.estimator.update(
            &mut self.state,
            &DepthSample {
                time_s: frame.time_s,
                image,
                intrinsics: frame.intrinsics,
                target: ToolTarget::Point(self.tool),
                left_out: Some(&self.left_out),
                travel: travels.then(|| base_from_camera.unrotate(&velocity)),
            },
        );
        let in_base = seen.in_base(&base_from_camera);
        Some(VisionInput {
            time_s: seen.time_s,
            point: in_base.point,
            normal: in_base.normal,
            covariance: in_base.covariance,
            surface_variation: seen.segment.map(|s| s.variation),
            curvature: in_base.curvature,
            change: bend_change(&seen.ahead.in_base(&base_from_camera)),
            validity: in_base.validity,
        })
    }

    /// Number of frames exposed.
    pub fn frames(&self) -> u64 {
        self.frames
    }
}

/// Change of the surface's curvature ahead, from the map ahead in base axes.
fn bend_change(map: &SurfaceAhead) -> Option<BendChange> {
    let [first, second, ..] = map.stations.as_slice() else {
        return None;
    };
    let stations = map.stations.iter();
    BendChange::of(
        &(second.point - first.point),
        stations.map(|s| (s.distance_m, s.bend_per_m, s.bend_sd_per_m)),
    )
}

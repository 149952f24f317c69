//! `depth_normal` in a thread of its own: depth images in, the surface's normal at the tool out, on `estimate/depth_normal/normal`.
//!
//! Each image is placed where the arm was when it was exposed, however late it comes.

use std::collections::VecDeque;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use tangent_estimation::NormalEstimate;
use tangent_estimation::depth_normal::{
    DEPTH_NORMAL, DepthEncoding, DepthEncodingError, DepthImage, DepthLayout, DepthNormal,
    DepthNormalState, DepthSample, Intrinsics, SegmentShape, SurfaceAhead as Ahead, ToolTarget,
    leave_out_rod,
};
use tangent_mechanics::{Base, Camera, Flange, Pose, Tool};
use tangent_runtime::health::instance_name;
use tangent_runtime::{AliveToken, Bus, Publisher, Stop, Subscription};
use tangent_schemas::convert::cut;
use tangent_schemas::standard::{Header, Image};
use tangent_schemas::tangent::{ArmState, NormalEstimate as Message, SurfaceAhead, SurfaceSegment};
use tangent_schemas::topics;

use crate::message::message;
use crate::{DepthChoice, EstimatorError};

/// Arm states kept for images under way: a quarter of a second at 1 kHz.
const POSES: usize = 256;
/// A pose further than this from an image's stamp does not place it, ns.
const REACH_NS: i64 = 10_000_000;
/// How often the thread looks for a stop while no image comes.
const LOOK: Duration = Duration::from_millis(50);
/// Slower than this the tool stands, m/s.
const TRAVEL_MIN_M_PER_S: f64 = 0.005;

/// What the thread owns.
pub struct Depth {
    estimator: DepthNormal,
    state: DepthNormalState,
    intrinsics: Intrinsics,
    size_px: [usize; 2],
    /// The tool's point, camera axes, m.
    tool: Vector3<f64>,
    left_out: Vec<u8>,
    tool_from_camera: Pose<Tool, Camera>,
    depth_m: Vec<f32>,
    poses: VecDeque<(i64, ArmState)>,
    arm: Subscription<ArmState>,
    images: Subscription<Image>,
    normals: Publisher<Message>,
    segments: Publisher<SurfaceSegment>,
    ahead: Publisher<SurfaceAhead>,
    _alive: AliveToken,
    said: Option<String>,
}

impl Depth {
    /// Opens its topics.
    ///
    /// # Errors
    /// A setting out of its range, or a topic that the bus refuses.
    pub fn new(
        choice: &DepthChoice,
        flange_from_tool: &Pose<Flange, Tool>,
        bus: &Bus,
    ) -> Result<Self, EstimatorError> {
        let camera_from_tool = choice.flange_from_camera.inverse() * *flange_from_tool;
        let tool = camera_from_tool.translation();
        let size_px = choice.size_px.map(|n| n as usize);
        let mut left_out = vec![0; size_px[0] * size_px[1]];
        if let Some(rod) = &choice.settings.tool {
            let end = tool - camera_from_tool.z_axis() * rod.length_m;
            leave_out_rod(
                &choice.intrinsics,
                size_px,
                [&tool, &end],
                rod.radius_m,
                &mut left_out,
            );
        }
        Ok(Self {
            estimator: DepthNormal::new(&choice.settings.fit)?,
            state: DepthNormalState::default(),
            intrinsics: choice.intrinsics,
            size_px,
            tool,
            left_out,
            tool_from_camera: camera_from_tool.inverse(),
            depth_m: Vec::new(),
            poses: VecDeque::with_capacity(POSES),
            arm: bus.subscribe(&topics::ARM_STATE, POSES)?,
            images: bus.subscribe(&topics::CAMERA_DEPTH, 2)?,
            normals: bus.publisher(&topics::estimate_normal(DEPTH_NORMAL))?,
            segments: bus.publisher(&topics::estimate_segment(DEPTH_NORMAL))?,
            ahead: bus.publisher(&topics::estimate_ahead(DEPTH_NORMAL))?,
            _alive: bus
                .declare_alive(&topics::estimator_service(DEPTH_NORMAL), &instance_name())?,
            said: None,
        })
    }

    /// Runs in a thread of its own until `stop`.
    ///
    /// # Errors
    /// No thread to be had.
    pub fn start(mut self, stop: &Stop) -> std::io::Result<JoinHandle<()>> {
        let stop = stop.clone();
        std::thread::Builder::new()
            .name("depth-normal".into())
            .spawn(move || {
                while !stop.is_stopped() {
                    self.turn(LOOK);
                }
            })
    }

    /// One image: the newest that waits, or the next to come.
    pub fn turn(&mut self, patience: Duration) {
        let received = self.images.recv_timeout(patience);
        self.remember();
        let Some(mut newest) = received else {
            return;
        };
        while let Some(newer) = self.images.try_recv() {
            newest = newer;
        }
        match self.read(&newest.message) {
            Ok(()) => self.said = None,
            Err(why) => {
                let words = why.to_string();
                if self.said.as_ref() != Some(&words) {
                    tracing::warn!("depth image refused: {words}");
                    self.said = Some(words);
                }
            }
        }
    }

    fn remember(&mut self) {
        while let Some(state) = self.arm.try_recv() {
            if self.poses.len() == POSES {
                self.poses.pop_front();
            }
            let stamp_ns = state.message.header.stamp.to_ns();
            self.poses.push_back((stamp_ns, state.message));
        }
    }

    fn read(&mut self, image: &Image) -> Result<(), DepthError> {
        let begin = Instant::now();
        let stamp_ns = image.header.stamp.to_ns();
        let arm = self
            .poses
            .iter()
            .min_by_key(|(at, _)| (at - stamp_ns).abs())
            .filter(|(at, _)| (at - stamp_ns).abs() <= REACH_NS)
            .map(|(_, arm)| arm)
            .ok_or(DepthError::Unplaced)?;
        let base_from_tool: Pose<Base, Tool> = (&arm.tool_pose)
            .try_into()
            .map_err(|_| DepthError::Unplaced)?;
        let (width, height) = (image.width as usize, image.height as usize);
        if [width, height] != self.size_px {
            return Err(DepthError::Size {
                found: [width, height],
                stated: self.size_px,
            });
        }
        DepthLayout {
            width,
            height,
            step: image.step as usize,
            big_endian: image.is_bigendian != 0,
            encoding: DepthEncoding::from_name(&image.encoding)?,
        }
        .read(&image.data, &mut self.depth_m)?;
        // Where the tool goes, the map goes; standing still there is no way ahead.
        let velocity = Vector3::from(&arm.tool_twist.linear);
        let travel = (velocity.norm() > TRAVEL_MIN_M_PER_S)
            .then(|| (base_from_tool * self.tool_from_camera).unrotate(&velocity));
        let picture = DepthImage::new(width, height, &self.depth_m).ok_or(DepthError::Unplaced)?;
        let seen = self.estimator.update(
            &mut self.state,
            &DepthSample {
                time_s: 0.0,
                image: picture,
                intrinsics: self.intrinsics,
                target: ToolTarget::Point(self.tool),
                left_out: Some(&self.left_out),
                travel,
            },
        );
        let base_from_camera = base_from_tool * self.tool_from_camera;
        if let Some(segment) = &seen.segment {
            self.segments
                .publish(&segment_message(segment, &base_from_camera, arm));
        }
        let estimate: NormalEstimate = seen.in_base(&base_from_camera);
        let update_s = begin.elapsed().as_secs_f64();
        // Before the normal: who reads it finds the rest of the same image there.
        let map = seen.ahead.in_base(&base_from_camera);
        if !map.stations.is_empty() {
            self.ahead.publish(&ahead_message(&map, arm));
        }
        self.normals
            .publish(&message(DEPTH_NORMAL, &estimate, arm, update_s));
        Ok(())
    }
}

fn segment_message(
    segment: &SegmentShape,
    base_from_camera: &Pose<Base, Camera>,
    arm: &ArmState,
) -> SurfaceSegment {
    SurfaceSegment {
        header: Header::new(arm.header.stamp.to_ns(), "base"),
        cycle: arm.cycle,
        estimator: cut(DEPTH_NORMAL),
        middle: (&base_from_camera.transform_point(&segment.middle)).into(),
        normal: (&base_from_camera.rotate(&segment.normal)).into(),
        surface_variation: segment.variation,
    }
}

fn ahead_message(map: &Ahead, arm: &ArmState) -> SurfaceAhead {
    let stations = || map.stations.iter();
    SurfaceAhead {
        header: Header::new(arm.header.stamp.to_ns(), "base"),
        cycle: arm.cycle,
        estimator: cut(DEPTH_NORMAL),
        distance: stations().map(|s| s.distance_m).collect(),
        points: stations().map(|s| (&s.point).into()).collect(),
        normals: stations().map(|s| (&s.normal).into()).collect(),
        bend: stations().map(|s| s.bend_per_m).collect(),
        bend_sd: stations().map(|s| s.bend_sd_per_m).collect(),
    }
}

/// Why an image says nothing.
#[derive(Debug, thiserror::Error)]
enum DepthError {
    #[error("no arm/state from the time of its exposure: do the clocks of camera and arm agree?")]
    Unplaced,
    #[error("{found:?} pixels, but camera.size_px is {stated:?}")]
    Size {
        found: [usize; 2],
        stated: [usize; 2],
    },
    #[error(transparent)]
    Encoding(#[from] DepthEncodingError),
}

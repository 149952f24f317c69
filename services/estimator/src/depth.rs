//! `depth_normal` in a thread of its own: depth images in, the surface's normal at the tool out, on
//! `estimate/depth_normal/normal`.
//!
//! Each image is placed where the arm was when it was exposed, however late it comes. What is wrong
//! with the images goes to the service, which tells it with its own health; an image that is
//! refused is an estimate that is not valid, with the reason.

use std::collections::VecDeque;
use std::sync::mpsc::Sender;
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
use tangent_runtime::{
    Age, AliveToken, Bus, Gauge, HealthReporter, Histogram, Publisher, Rate, Subscription,
};
use tangent_schemas::Text;
use tangent_schemas::convert::{cut, cut_format};
use tangent_schemas::standard::{Header, Image};
use tangent_schemas::tangent::{ArmState, NormalEstimate as Message, SurfaceAhead, SurfaceSegment};
use tangent_schemas::topics;
use tangent_sensing::Validity;

use crate::message::message;
use crate::{DepthChoice, EstimatorError};

/// Arm states kept for images under way: a quarter of a second at 1 kHz.
const POSES: usize = 256;
/// A pose further than this from an image's stamp does not place it, ns.
const REACH_NS: i64 = 10_000_000;
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
    /// The last estimate of a frame that was used.
    last: Message,
    /// Images that waited behind a newer one.
    overtaken: u64,
    meters: DepthMeters,
    /// What is wrong, whenever that changes. It ends when the thread does.
    news: Sender<Option<Text>>,
    said: Option<Text>,
    _alive: AliveToken,
}

/// What the service's health says of the images.
pub struct DepthMeters {
    used: Rate,
    age: Age,
    refused: Gauge,
    skipped: Gauge,
    update: Histogram,
}

impl DepthMeters {
    /// In the service's health.
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            used: health.rate("camera_depth"),
            age: health.age("camera_depth"),
            refused: health.gauge("depth_images_refused"),
            skipped: health.gauge("depth_images_skipped"),
            update: health.histogram("depth_update"),
        }
    }

    /// Since the newest image.
    pub fn age(&self) -> &Age {
        &self.age
    }
}

impl Depth {
    /// Opens its topics. What is wrong with the images goes to `news`, whenever that changes.
    ///
    /// # Errors
    /// A setting out of its range, or a topic that the bus refuses.
    pub fn new(
        choice: &DepthChoice,
        flange_from_tool: &Pose<Flange, Tool>,
        bus: &Bus,
        meters: DepthMeters,
        news: Sender<Option<Text>>,
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
            last: Message {
                estimator: cut(DEPTH_NORMAL),
                ..Message::default()
            },
            overtaken: 0,
            meters,
            news,
            said: None,
            _alive: bus
                .declare_alive(&topics::estimator_service(DEPTH_NORMAL), &instance_name())?,
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
            self.overtaken += 1;
            newest = newer;
        }
        let skipped = self.overtaken + self.images.lost();
        self.meters.skipped.set(skipped as f64);
        self.meters.age.mark_at(newest.received);
        let begin = Instant::now();
        match self.read(&newest.message, begin) {
            Ok(()) => {
                self.meters.used.tick();
                self.meters.update.record(begin.elapsed());
                self.say(None);
            }
            Err(why) => {
                self.meters.refused.set(self.meters.refused.get() + 1.0);
                let words = cut_format(format_args!("{why}"));
                self.refuse(words);
                self.say(Some(words));
            }
        }
    }

    fn say(&mut self, trouble: Option<Text>) {
        if self.said == trouble {
            return;
        }
        self.said = trouble;
        if let Some(words) = &trouble {
            tracing::warn!("depth image refused: {words}");
        }
        // Without a listener the service is ending.
        let _ = self.news.send(trouble);
    }

    /// An estimate that cannot be used, with the reason. It keeps the stamp and cycle of the last
    /// that could: to a reader that judges by age, a camera whose images are refused is as silent
    /// as one that sends none, and is left as soon.
    fn refuse(&self, reason: Text) {
        self.normals.publish(&Message {
            validity: Validity::SensorError as u8,
            reason: cut(&reason),
            ..self.last.clone()
        });
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

    fn read(&mut self, image: &Image, begin: Instant) -> Result<(), DepthError> {
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
        let estimate = message(DEPTH_NORMAL, &estimate, arm, update_s);
        self.normals.publish(&estimate);
        let map = seen.ahead.in_base(&base_from_camera);
        if !map.stations.is_empty() {
            self.ahead.publish(&ahead_message(&map, arm));
        }
        self.last = estimate;
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

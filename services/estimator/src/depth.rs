//! `depth_normal` in a separate thread: receives depth images, and publishes the surface's normal
//! at the tool on `estimate/depth_normal/normal`.
//!
//! Each image is combined with the arm's pose at its exposure, however late it arrives. Problems
//! with the images are reported to the service, for its health message. For a refused image an
//! invalid estimate is published, with the reason.

use std::collections::VecDeque;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use tangent_estimation::NormalEstimate;
use tangent_estimation::depth_normal::{
    DEPTH_NORMAL, DepthEncodingError, DepthImage, DepthLayout, DepthNormal, DepthNormalState,
    DepthSample, Intrinsics, SegmentShape, SurfaceAhead as Ahead, ToolTarget,
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
use crate::{DepthChoice, EstimatorError, ToolInView};

/// Number of arm states kept for late images: a quarter of a second at 1 kHz.
const POSES: usize = 256;
/// Largest time between an image's stamp and the pose used for it, ns.
const REACH_NS: i64 = 10_000_000;
/// Speed below which the tool counts as at rest, m/s.
const TRAVEL_MIN_M_PER_S: f64 = 0.005;

/// State of the thread.
pub struct Depth {
    estimator: DepthNormal,
    state: DepthNormalState,
    intrinsics: Intrinsics,
    size_px: [usize; 2],
    /// Position of the tool's origin, camera axes, m.
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
    /// The last estimate from an image that was used.
    last: Message,
    /// Number of images skipped for a newer one.
    overtaken: u64,
    meters: DepthMeters,
    /// Sends each change of the problem with the images. Closed when the thread ends.
    news: Sender<Option<Text>>,
    said: Option<Text>,
    _alive: AliveToken,
}

/// Figures on the images in the service's health message.
pub struct DepthMeters {
    used: Rate,
    age: Age,
    refused: Gauge,
    skipped: Gauge,
    update: Histogram,
}

impl DepthMeters {
    /// Adds the figures to the service's health message.
    pub fn new(health: &HealthReporter) -> Self {
        Self {
            used: health.rate("camera_depth"),
            age: health.age("camera_depth"),
            refused: health.gauge("depth_images_refused"),
            skipped: health.gauge("depth_images_skipped"),
            update: health.histogram("depth_update"),
        }
    }

    /// Age of the newest image.
    pub fn age(&self) -> &Age {
        &self.age
    }
}

impl Depth {
    /// Subscribes to its topics. Each change of the problem with the images is sent to `news`.
    ///
    /// # Errors
    /// A setting is out of range, or the bus refuses a topic.
    pub fn new(
        choice: &DepthChoice,
        flange_from_tool: &Pose<Flange, Tool>,
        bus: &Bus,
        meters: DepthMeters,
        news: Sender<Option<Text>>,
    ) -> Result<Self, EstimatorError> {
        let camera_from_tool = choice.flange_from_camera.inverse() * *flange_from_tool;
        let left_out = ToolInView::left_out(
            choice.settings.tool.as_ref(),
            &camera_from_tool,
            &choice.intrinsics,
            choice.size_px,
        );
        Ok(Self {
            estimator: DepthNormal::new(&choice.settings.fit)?,
            state: DepthNormalState::default(),
            intrinsics: choice.intrinsics,
            size_px: choice.size_px.map(|count| count as usize),
            tool: camera_from_tool.translation(),
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

    /// Handles one image: the newest one that waits, or the next to arrive.
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
        // Without a receiver, the service is ending.
        let _ = self.news.send(trouble);
    }

    /// Publishes an invalid estimate, with the reason. It keeps the stamp and cycle of the last
    /// valid one: a reader that goes by age then treats a camera with refused images like a silent
    /// one.
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
        DepthLayout::stated(
            [image.width, image.height],
            image.step,
            image.is_bigendian,
            &image.encoding,
        )?
        .read(&image.data, &mut self.depth_m)?;
        // The map follows the tool's motion; at rest there is no direction ahead.
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

/// Why an image gives no estimate.
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

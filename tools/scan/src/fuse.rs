//! Places depth images with the poses of the arm, and makes one set of points of them.
//!
//! No clock and no bus: messages go in, in the order of their arrival. Each image waits until a
//! state of the arm after its stamp has arrived.

use std::collections::{HashSet, VecDeque};

use nalgebra::Vector3;
use tangent_estimation::depth_normal::Intrinsics;
use tangent_mechanics::{Base, Camera, Pose, Tool};
use tangent_runtime::config::Calibration;
use tangent_schemas::standard::{CameraInfo, Image};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

use crate::frames::{FRAMES_MAX, Frame, Frames, looked_at};
use crate::image::points_of;
use crate::mounting::Mounting;
use crate::poses::{NoPose, Poses};
use crate::scan::Scan;
use crate::tally::{FAST_M_PER_S, Tally};

/// Most points of all images.
const POINTS_MAX: usize = 400_000;
/// Points of an image for the area that is seen.
const AREA_POINTS: usize = 4000;
/// Edge of a square of that area, m.
const SQUARE_M: f64 = 0.01;
/// Images that wait for a state of the arm or for the calibration, at most.
const WAITING_MAX: usize = 32;
/// Largest time of an image's stamp before the newest state at its arrival, ns.
const LATE_NS: i64 = 1_000_000_000;
/// Largest time of an image's stamp after the newest state at its arrival, ns: states pass images
/// on the way, unless the network delays them.
const AHEAD_NS: i64 = 200_000_000;
/// A stamp that is older than the newest by more than this, ns, means that the driver has
/// restarted.
const RESTART_NS: i64 = 10_000_000_000;
/// Time over which the speed is measured, ns.
const SPEED_OVER_NS: i64 = 20_000_000;

/// Makes a scan of messages.
#[derive(Debug)]
pub struct Fuse {
    mounting: Mounting,
    poses: Poses,
    calibration: Option<Known>,
    waiting: VecDeque<Image>,
    newest_ns: Option<i64>,
    frames: Frames,
    /// Axes of the camera in the first image, and the squares that were seen in them.
    first_from: Option<Pose<Base, Camera>>,
    squares: HashSet<[i32; 2]>,
    tally: Tally,
}

/// The calibration of the images that arrive now.
#[derive(Debug)]
struct Known {
    stated: Calibration,
    intrinsics: Intrinsics,
    /// Not zero where the tool is in view.
    left_out: Vec<u8>,
}

impl Fuse {
    /// Starts without any message.
    pub fn new(mounting: Mounting) -> Self {
        Self {
            mounting,
            poses: Poses::default(),
            calibration: None,
            waiting: VecDeque::new(),
            newest_ns: None,
            frames: Frames::default(),
            first_from: None,
            squares: HashSet::new(),
            tally: Tally::default(),
        }
    }

    /// Takes a message of `arm/state`.
    pub fn state(&mut self, state: &ArmState) {
        self.poses.add(state);
        self.settle();
    }

    /// Takes a message of `camera/info`; one without a calibration is counted as refused.
    pub fn info(&mut self, info: &CameraInfo) {
        let Some(stated) = Calibration::of(info) else {
            let reason = format!(
                "camera/info has no calibration: {} x {} pixels, k = {:?}",
                info.width, info.height, info.k
            );
            return self.tally.refuse(reason);
        };
        if (self.calibration.as_ref()).is_some_and(|known| known.stated == stated) {
            return;
        }
        let intrinsics = Intrinsics::new(stated.focal_px, stated.principal_px);
        self.calibration = Some(Known {
            left_out: self.mounting.left_out(&intrinsics, stated.size_px),
            stated,
            intrinsics,
        });
        self.settle();
    }

    /// Takes a message of `camera/depth`.
    pub fn image(&mut self, image: Image) {
        self.tally.received += 1;
        let stamp_ns = image.header.stamp.to_ns();
        let behind_ns = self.newest_ns.map(|newest_ns| newest_ns - stamp_ns);
        if behind_ns.is_some_and(|behind| (0..RESTART_NS).contains(&behind)) {
            self.tally.out_of_order += 1;
            return;
        }
        if let Some(state_ns) = self.poses.newest_ns() {
            let late_ns = state_ns - stamp_ns;
            let [late_s, lead_s] = &mut self.tally.apart_s;
            if late_ns > LATE_NS {
                self.tally.late += 1;
                *late_s = late_s.max(late_ns as f64 * 1e-9);
                return;
            }
            if late_ns < -AHEAD_NS {
                self.tally.ahead += 1;
                *lead_s = lead_s.max(-late_ns as f64 * 1e-9);
                return;
            }
        }
        self.newest_ns = Some(stamp_ns);
        self.waiting.push_back(image);
        self.settle();
        if self.waiting.len() > WAITING_MAX {
            self.waiting.pop_front();
            self.tally.unplaced += 1;
        }
    }

    /// Counts a message that cannot be decoded.
    pub(crate) fn refuse(&mut self, topic: &str, reason: &impl std::fmt::Display) {
        self.tally.refuse(format!("{topic}: {reason}"));
    }

    /// Counts of the images.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Number of images that would be used now.
    pub fn images(&self) -> usize {
        self.frames.all().len()
    }

    /// Area that was seen along the axis of the camera in its first image, cm².
    pub fn area_cm2(&self) -> f64 {
        self.squares.len() as f64 * SQUARE_M * SQUARE_M * 1e4
    }

    /// The first topic of which no usable message has arrived.
    pub fn lacks(&self) -> Option<&'static str> {
        if self.tally.received == 0 {
            Some(topics::CAMERA_DEPTH.key())
        } else if self.calibration.is_none() {
            Some(topics::CAMERA_INFO.key())
        } else if self.poses.newest_ns().is_none() {
            Some(topics::ARM_STATE.key())
        } else {
            None
        }
    }

    /// The points of all images that are kept; `None` without any.
    pub fn finish(mut self) -> Option<Scan> {
        self.tally.unplaced += self.waiting.len();
        let frames = self.frames.all();
        let per_frame = POINTS_MAX / frames.len().clamp(1, FRAMES_MAX);
        let mut points = Vec::new();
        for (number, frame) in frames.iter().enumerate() {
            let left_out = self.left_out(&frame.image, &frame.intrinsics);
            // An image that is kept has been read before.
            let seen = points_of(&frame.image, &frame.intrinsics, left_out, per_frame, number);
            let seen = seen.unwrap_or_default();
            points.extend(
                seen.iter()
                    .map(|p| frame.base_from_camera.transform_point(p)),
            );
        }
        (!points.is_empty()).then(|| Scan {
            images: frames.len(),
            points,
            area_cm2: self.area_cm2(),
            tally: self.tally.clone(),
            lost: Vec::new(),
        })
    }

    /// The tool in the view of an image of the present calibration.
    fn left_out(&self, image: &Image, intrinsics: &Intrinsics) -> &[u8] {
        match &self.calibration {
            Some(known)
                if known.intrinsics == *intrinsics
                    && known.stated.size_px == [image.width, image.height] =>
            {
                &known.left_out
            }
            _ => &[],
        }
    }

    /// Places the images that wait, as far as states and calibration have arrived.
    fn settle(&mut self) {
        while let (Some(_), Some(image)) = (&self.calibration, self.waiting.front()) {
            let stamp_ns = image.header.stamp.to_ns();
            let found = self.poses.at(stamp_ns);
            if found == Err(NoPose::NotYet) {
                return;
            }
            match (self.waiting.pop_front(), found) {
                (Some(image), Ok(pose)) => self.place(image, stamp_ns, &pose),
                _ => self.tally.unplaced += 1,
            }
        }
    }

    fn place(&mut self, image: Image, stamp_ns: i64, base_from_tool: &Pose<Base, Tool>) {
        let Some(known) = &self.calibration else {
            return;
        };
        let size_px = [image.width, image.height];
        if size_px != known.stated.size_px {
            return self.tally.refuse(format!(
                "camera/depth has {size_px:?} pixels, but camera/info states {:?}",
                known.stated.size_px
            ));
        }
        let base_from_camera = *base_from_tool * self.mounting.tool_from_camera;
        if self.speed_m_per_s(stamp_ns, &base_from_camera) > FAST_M_PER_S {
            self.tally.fast += 1;
            return;
        }
        let intrinsics = known.intrinsics;
        let seen = match points_of(&image, &intrinsics, &known.left_out, AREA_POINTS, 0) {
            Ok(seen) => seen,
            Err(error) => return self.tally.refuse(format!("camera/depth: {error}")),
        };
        if seen.is_empty() {
            self.tally.blank += 1;
            return;
        }
        self.add_area(&seen, &base_from_camera);
        self.tally.placed += 1;
        self.frames.add(Frame {
            at_ns: stamp_ns,
            base_from_camera,
            intrinsics,
            image,
        });
    }

    /// Speed of the surface past the camera; zero before there are two states.
    fn speed_m_per_s(&self, stamp_ns: i64, base_from_camera: &Pose<Base, Camera>) -> f64 {
        let Ok(before) = self.poses.at(stamp_ns - SPEED_OVER_NS) else {
            return 0.0;
        };
        let before = looked_at(&(before * self.mounting.tool_from_camera));
        (looked_at(base_from_camera) - before).norm() / (SPEED_OVER_NS as f64 * 1e-9)
    }

    fn add_area(&mut self, seen: &[Vector3<f64>], base_from_camera: &Pose<Base, Camera>) {
        let base_from_first = *self.first_from.get_or_insert(*base_from_camera);
        let first_from_camera = base_from_first.inverse() * *base_from_camera;
        let square = |x: f64| (x / SQUARE_M).floor() as i32;
        self.squares.extend(seen.iter().map(|p| {
            let p = first_from_camera.transform_point(p);
            [square(p.x), square(p.y)]
        }));
    }
}

#[cfg(test)]
mod tests;

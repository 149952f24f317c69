//! The points that a depth camera at the flange has seen, in the base of the robot, from a
//! recording with `camera/depth`, `camera/info` and `arm/state`.
//!
//! Each image is placed with the pose of the tool at its stamp, between the two states around it.
//! Images are taken evenly over the recording, and pixels evenly over an image, so that memory is
//! bounded. `tangent region` calls [`points`].

mod image;
mod poses;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use tangent_estimation::depth_normal::Intrinsics;
use tangent_mechanics::{Camera, Pose, Tool};
use tangent_recorder::{RecorderError, Recording};
use tangent_runtime::CellConfig;
use tangent_schemas::standard::{CameraInfo, Image};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{Message, cdr, topics};

use image::points_of;
use poses::Poses;

/// Most images, and most points of all of them.
const IMAGES_MAX: usize = 40;
const POINTS_MAX: usize = 400_000;

/// Points of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Points in the base, m.
    pub points: Vec<Vector3<f64>>,
    /// Images that were used.
    pub images: usize,
}

/// Why a recording gives no scan. Each error says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ScanError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecorderError),
    /// The cell has no camera.
    #[error(
        "the cell file has no [camera]: name the cell with the camera of the recording with --cell"
    )]
    NoCamera,
    /// Something is missing in the recording.
    #[error(
        "{file}: no {missing}: record with the services `camera` (kind = \"depth\") and `rtde` or `franka`"
    )]
    Missing {
        /// The recording.
        file: PathBuf,
        /// What is missing.
        missing: &'static str,
    },
    /// A message of the recording is not usable.
    #[error("{file}: {topic}: {reason}")]
    Message {
        /// The recording.
        file: PathBuf,
        /// Its topic.
        topic: &'static str,
        /// What is wrong.
        reason: String,
    },
}

/// Reads the points of a recording.
///
/// # Errors
/// See [`ScanError`].
pub fn points(file: &Path, cell: &CellConfig) -> Result<Scan, ScanError> {
    let camera = cell.camera.as_ref().ok_or(ScanError::NoCamera)?;
    let tool_from_camera: Pose<Tool, Camera> =
        cell.tool.flange_from_tool().inverse() * camera.flange_from_camera();
    let recording = Recording::open(file)?;
    let (mut poses, mut stated, mut count) = (Poses::default(), None, 0);
    let refuse = |topic: &'static str, reason: String| ScanError::Message {
        file: file.to_owned(),
        topic,
        reason,
    };
    let named = |topic: &str, name: &str| topic.trim_start_matches('/') == name;
    let wanted = [topics::CAMERA_INFO.key(), topics::ARM_STATE.key()];
    let depth = topics::CAMERA_DEPTH.key();
    for message in recording.try_messages_where(|of| {
        count += usize::from(named(of.topic, depth));
        wanted.iter().any(|name| named(of.topic, name))
    }) {
        let message = message?;
        if message.type_name == ArmState::NAME {
            let state: ArmState = cdr::decode(&message.bytes)
                .map_err(|error| refuse("arm/state", error.to_string()))?;
            poses.add(message.publish_time_ns, &state);
        } else if stated.is_none() && message.type_name == CameraInfo::NAME {
            let info: CameraInfo = cdr::decode(&message.bytes)
                .map_err(|error| refuse("camera/info", error.to_string()))?;
            stated = Some(intrinsics(&info));
        }
    }
    let missing = |missing| ScanError::Missing {
        file: file.to_owned(),
        missing,
    };
    let intrinsics = stated.ok_or_else(|| missing("camera/info"))?;
    if !intrinsics.is_sound() {
        let reason = format!("{intrinsics:?} is no calibration");
        return Err(refuse("camera/info", reason));
    }
    if poses.is_empty() {
        return Err(missing("arm/state"));
    }
    if count == 0 {
        return Err(missing("camera/depth"));
    }
    let (every, per_image) = (
        count.div_ceil(IMAGES_MAX),
        POINTS_MAX / count.min(IMAGES_MAX),
    );
    let (mut number, mut scan) = (
        0,
        Scan {
            points: Vec::new(),
            images: 0,
        },
    );
    for message in recording.try_messages_where(|of| {
        let is_depth = named(of.topic, depth);
        number += usize::from(is_depth);
        is_depth && (number - 1).is_multiple_of(every)
    }) {
        let message = message?;
        let image: Image = cdr::decode(&message.bytes)
            .map_err(|error| refuse("camera/depth", error.to_string()))?;
        // An image before the first or after the last state of the arm has no place.
        let Some(base_from_tool) = poses.at(message.publish_time_ns) else {
            continue;
        };
        let seen = points_of(&image, &intrinsics, per_image)
            .map_err(|error| refuse("camera/depth", error.to_string()))?;
        let base_from_camera = base_from_tool * tool_from_camera;
        scan.points
            .extend(seen.iter().map(|p| base_from_camera.transform_point(p)));
        scan.images += 1;
    }
    if scan.points.is_empty() {
        return Err(missing(
            "camera/depth with a reading while arm/state was recorded",
        ));
    }
    Ok(scan)
}

fn intrinsics(info: &CameraInfo) -> Intrinsics {
    Intrinsics {
        fx_px: info.k[0],
        fy_px: info.k[4],
        cx_px: info.k[2],
        cy_px: info.k[5],
    }
}

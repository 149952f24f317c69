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
use tangent_recorder::{Contents, RecorderError, Recording, Stored};
use tangent_runtime::CellConfig;
use tangent_schemas::standard::{CameraInfo, Image};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{cdr, topics};

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
        "{file}: no {missing}: record with the services `camera` (kind = \"depth\") and `rtde` or \
         `franka`, and with `recorder.exclude = [\"simulator/image\"]` in the cell file, since depth \
         images are not recorded by default"
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
    let refuse = |topic: &'static str, reason: String| ScanError::Message {
        file: file.to_owned(),
        topic,
        reason,
    };
    let (mut poses, mut stated) = (Poses::default(), None);
    let mut refused = None;
    let held = recording.decode_selected(Part::of, Part::decode, |part| match part {
        Ok(Ok(Part::State(at_ns, state))) => poses.add(at_ns, &state),
        Ok(Ok(Part::Info(info))) => stated = stated.or(Some(info)),
        Ok(Err((topic, reason))) => {
            refused.get_or_insert_with(|| refuse(topic, reason));
        }
        Err(error) => {
            refused.get_or_insert(error.into());
        }
    });
    if let Some(error) = refused {
        return Err(error);
    }
    let is_depth = |topic: &str| is_named(topic, topics::CAMERA_DEPTH.key());
    let count: u64 = held
        .iter()
        .filter(|held| is_depth(&held.topic))
        .map(|held| held.count)
        .sum();
    let count = usize::try_from(count).unwrap_or(usize::MAX);
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
        0_usize,
        Scan {
            points: Vec::new(),
            images: 0,
        },
    );
    let mut refused = None;
    let mut add = |at_ns: u64, bytes: &[u8]| {
        let image: Image =
            cdr::decode(bytes).map_err(|error| refuse("camera/depth", error.to_string()))?;
        // An image before the first or after the last state of the arm has no place.
        let Some(base_from_tool) = poses.at(at_ns) else {
            return Ok(());
        };
        let seen = points_of(&image, &intrinsics, per_image)
            .map_err(|error| refuse("camera/depth", error.to_string()))?;
        let base_from_camera = base_from_tool * tool_from_camera;
        scan.points
            .extend(seen.iter().map(|p| base_from_camera.transform_point(p)));
        scan.images += 1;
        Ok::<(), ScanError>(())
    };
    recording.decode_selected(
        |of| is_depth(of.topic).then_some(()),
        |(), stored| (stored.publish_time_ns, stored.bytes.to_vec()),
        |image| {
            let is_taken = number.is_multiple_of(every);
            number += 1;
            let added = match image {
                Ok((at_ns, bytes)) if is_taken => add(at_ns, &bytes),
                Ok(_) => Ok(()),
                Err(error) => Err(error.into()),
            };
            if let Err(error) = added {
                refused.get_or_insert(error);
            }
        },
    );
    if let Some(error) = refused {
        return Err(error);
    }
    if scan.points.is_empty() {
        return Err(missing(
            "camera/depth with a reading while arm/state was recorded",
        ));
    }
    Ok(scan)
}

/// What the images are placed with.
enum Part {
    /// Time of measurement, ns since the Unix epoch, and the arm.
    State(u64, Box<ArmState>),
    Info(Intrinsics),
}

impl Part {
    /// Name of the topic, if one of its messages is such a part.
    fn of(of: &Contents<'_>) -> Option<&'static str> {
        [topics::CAMERA_INFO.key(), topics::ARM_STATE.key()]
            .into_iter()
            .find(|name| is_named(of.topic, name))
    }

    /// # Errors
    /// The topic, and why its message is refused.
    fn decode(name: &&'static str, stored: &Stored<'_>) -> Result<Self, (&'static str, String)> {
        let refuse = |error: cdr::CdrError| (*name, error.to_string());
        if *name == topics::ARM_STATE.key() {
            let state = cdr::decode(stored.bytes).map_err(refuse)?;
            return Ok(Self::State(stored.publish_time_ns, Box::new(state)));
        }
        let info = cdr::decode(stored.bytes).map_err(refuse)?;
        Ok(Self::Info(intrinsics(&info)))
    }
}

fn is_named(topic: &str, name: &str) -> bool {
    topic.trim_start_matches('/') == name
}

fn intrinsics(info: &CameraInfo) -> Intrinsics {
    Intrinsics {
        fx_px: info.k[0],
        fy_px: info.k[4],
        cx_px: info.k[2],
        cy_px: info.k[5],
    }
}

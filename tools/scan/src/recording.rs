//! A scan of a recording.

use std::path::Path;

use tangent_recorder::{Contents, Recording, Stored};
use tangent_runtime::CellConfig;
use tangent_schemas::standard::CameraInfo;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::{cdr, topics};

use crate::error::ScanError;
use crate::fuse::Fuse;
use crate::mounting::Mounting;
use crate::scan::Scan;

/// Most images that are read, evenly over the recording: decoding all of a long one takes minutes.
const READ_MAX: usize = 160;

/// Makes a scan of `camera/depth`, `camera/info` and `arm/state` of a recording, with the camera's
/// mounting and the tool of the cell file.
///
/// # Errors
/// See [`ScanError`].
pub fn of_recording(file: &Path, cell: &CellConfig) -> Result<Scan, ScanError> {
    let mut fuse = Fuse::new(Mounting::from_cell(cell)?);
    let recording = Recording::open(file)?;
    let held = recording.decode_selected(|_| None::<()>, |(), _| (), |_| ());
    let count: u64 = (held.iter())
        .filter(|held| is_named(&held.topic, topics::CAMERA_DEPTH.key()))
        .map(|held| held.count)
        .sum();
    let every = usize::try_from(count).unwrap_or(usize::MAX);
    let every = every.div_ceil(READ_MAX).max(1);
    let (mut number, mut lost) = (0_usize, Vec::new());
    recording.decode_selected(Part::of, Part::decode, |part| match part {
        Ok(Ok(Part::State(state))) => fuse.state(&state),
        Ok(Ok(Part::Info(info))) => fuse.info(&info),
        Ok(Ok(Part::Depth(bytes))) => {
            if number.is_multiple_of(every) {
                match cdr::decode(&bytes) {
                    Ok(image) => fuse.image(image),
                    Err(error) => fuse.refuse(topics::CAMERA_DEPTH.key(), &error),
                }
            }
            number += 1;
        }
        Ok(Err((topic, error))) => fuse.refuse(topic, &error),
        Err(damage) => lost.push(format!("lost in the recording: {damage}")),
    });
    let (lacks, reasons) = (fuse.lacks(), fuse.tally().left_out());
    let mut scan = fuse.finish().ok_or_else(|| match lacks {
        Some(missing) if reasons.is_empty() => ScanError::Missing {
            file: file.to_owned(),
            missing,
        },
        missing => ScanError::Nothing {
            from: file.display().to_string(),
            reasons: (missing.iter().map(|topic| format!("no usable {topic}")))
                .chain(reasons)
                .chain(lost.iter().cloned())
                .collect(),
        },
    })?;
    scan.tally.received = number;
    scan.lost = lost;
    Ok(scan)
}

/// A message that a scan needs.
enum Part {
    State(Box<ArmState>),
    Info(Box<CameraInfo>),
    /// Not decoded yet: most images are left out.
    Depth(Vec<u8>),
}

impl Part {
    /// Name of the topic, if a scan needs its messages.
    fn of(of: &Contents<'_>) -> Option<&'static str> {
        [
            topics::CAMERA_INFO.key(),
            topics::ARM_STATE.key(),
            topics::CAMERA_DEPTH.key(),
        ]
        .into_iter()
        .find(|name| is_named(of.topic, name))
    }

    /// # Errors
    /// The topic, and why its message is refused.
    fn decode(
        name: &&'static str,
        stored: &Stored<'_>,
    ) -> Result<Self, (&'static str, cdr::CdrError)> {
        let refuse = |error| (*name, error);
        if *name == topics::CAMERA_DEPTH.key() {
            return Ok(Self::Depth(stored.bytes.to_vec()));
        }
        if *name == topics::ARM_STATE.key() {
            return cdr::decode(stored.bytes).map(Self::State).map_err(refuse);
        }
        cdr::decode(stored.bytes).map(Self::Info).map_err(refuse)
    }
}

fn is_named(topic: &str, name: &str) -> bool {
    topic.trim_start_matches('/') == name
}

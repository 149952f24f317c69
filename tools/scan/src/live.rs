//! A scan of a running cell: subscribes to the camera and the arm, until it is told to finish.

use std::time::{Duration, Instant};

use tangent_runtime::{Bus, CellConfig, Subscription};
use tangent_schemas::standard::{CameraInfo, Image};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

use crate::error::ScanError;
use crate::fuse::Fuse;
use crate::mounting::Mounting;
use crate::scan::Scan;
use crate::tally::Tally;

/// Messages of each topic that wait at most: two seconds of the fastest arm, and a quarter of a
/// second of images.
const STATES_MAX: usize = 2048;
const IMAGES_MAX: usize = 8;
/// Silence of the camera or the arm after which it is reported.
const SILENCE: Duration = Duration::from_secs(1);

/// Collects the images of a running cell.
pub struct LiveScan {
    cell: String,
    states: Subscription<ArmState>,
    infos: Subscription<CameraInfo>,
    images: Subscription<Image>,
    fuse: Fuse,
    began: Instant,
    arm: Heard,
    camera: Heard,
}

/// When messages of a topic arrived.
#[derive(Clone, Copy, Debug, Default)]
struct Heard {
    newest: Option<Instant>,
    /// Longest time without a message, after the first one.
    silence: Duration,
}

impl Heard {
    fn mark(&mut self, at: Instant) {
        self.silence = self.silence_until(at);
        self.newest = Some(at);
    }

    fn silence_until(&self, now: Instant) -> Duration {
        let open = self.newest.map(|at| now.saturating_duration_since(at));
        self.silence.max(open.unwrap_or_default())
    }

    fn age_s(&self, now: Instant) -> Option<f64> {
        (self.newest).map(|at| now.saturating_duration_since(at).as_secs_f64())
    }
}

/// What a scan has so far.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Images that would be used now.
    pub images: usize,
    /// Area that was seen along the axis of the camera in its first image, cm².
    pub area_cm2: f64,
    /// Age of the newest image, s; `None` before the first.
    pub image_age_s: Option<f64>,
    /// Age of the newest state of the arm, s; `None` before the first.
    pub arm_age_s: Option<f64>,
    /// What became of all images.
    pub tally: Tally,
    /// What is missing now, and what to do about it.
    pub missing: Vec<&'static str>,
}

impl Seen {
    /// One line for a person.
    pub fn words(&self) -> String {
        let age = |name: &str, age_s: Option<f64>| match age_s {
            Some(age_s) => format!("{name} {age_s:.1} s old"),
            None => format!("no {name}"),
        };
        let left_out = self.tally.received - self.tally.placed.min(self.tally.received);
        format!(
            "{} images kept of {}, {left_out} left out or waiting, {:.0} cm² seen; {}, {}",
            self.images,
            self.tally.received,
            self.area_cm2,
            age("image", self.image_age_s),
            age("arm", self.arm_age_s)
        )
    }
}

impl LiveScan {
    /// Subscribes to the topics of the cell.
    ///
    /// # Errors
    /// The cell has no depth camera, or the bus refuses a topic.
    pub fn open(bus: &Bus, cell: &CellConfig) -> Result<Self, ScanError> {
        Ok(Self {
            fuse: Fuse::new(Mounting::from_cell(cell)?),
            cell: cell.cell.name.clone(),
            states: bus.subscribe(&topics::ARM_STATE, STATES_MAX)?,
            infos: bus.subscribe(&topics::CAMERA_INFO, 1)?,
            images: bus.subscribe(&topics::CAMERA_DEPTH, IMAGES_MAX)?,
            began: Instant::now(),
            arm: Heard::default(),
            camera: Heard::default(),
        })
    }

    /// Takes what has arrived; waits for an image for at most `patience`.
    pub fn look(&mut self, patience: Duration) {
        let mut next = self.images.recv_timeout(patience);
        // States first: an image is judged by the newest one at its arrival.
        while let Some(state) = self.states.try_recv() {
            self.arm.mark(state.received);
            self.fuse.state(&state.message);
        }
        while let Some(info) = self.infos.try_recv() {
            self.fuse.info(&info.message);
        }
        while let Some(image) = next {
            self.camera.mark(image.received);
            self.fuse.image(image.message);
            next = self.images.try_recv();
        }
    }

    /// What the scan has at this time.
    pub fn seen(&self, now: Instant) -> Seen {
        Seen {
            images: self.fuse.images(),
            area_cm2: self.fuse.area_cm2(),
            image_age_s: self.camera.age_s(now),
            arm_age_s: self.arm.age_s(now),
            tally: self.fuse.tally().clone(),
            missing: self.missing(now),
        }
    }

    fn missing(&self, now: Instant) -> Vec<&'static str> {
        if now.saturating_duration_since(self.began) < SILENCE {
            return Vec::new();
        }
        let is_silent = |heard: &Heard| heard.newest.is_none_or(|at| now - at > SILENCE);
        let mut missing = Vec::new();
        if is_silent(&self.camera) {
            missing.push(
                "no camera/depth: do the service `camera` (kind = \"depth\") and the camera's driver run? \
                 `tangent status` shows them",
            );
        }
        if is_silent(&self.arm) {
            missing.push(
                "no arm/state: does the bridge of the arm (`rtde` or `franka`) run? `tangent status` shows it",
            );
        }
        if self.fuse.lacks() == Some(topics::CAMERA_INFO.key()) {
            missing.push(
                "no camera/info with a calibration: set size_px, focal_px and principal_px in [camera] of the \
                 cell file, or info_topic",
            );
        }
        missing
    }

    /// Ends the scan, with what was lost while it ran.
    ///
    /// # Errors
    /// No image was placed.
    pub fn finish(mut self) -> Result<Scan, ScanError> {
        self.look(Duration::ZERO);
        let now = Instant::now();
        let mut lost: Vec<String> = [
            (topics::CAMERA_DEPTH.key(), &self.camera),
            (topics::ARM_STATE.key(), &self.arm),
        ]
        .into_iter()
        .filter(|(_, heard)| heard.silence_until(now) > SILENCE)
        .map(|(topic, heard)| {
            let silence_s = heard.silence_until(now).as_secs_f64();
            format!(
                "{topic} was silent for {silence_s:.1} s: what the camera saw meanwhile is missing"
            )
        })
        .collect();
        let (missing, left_out) = (self.missing(now), self.fuse.tally().left_out());
        let mut scan = self.fuse.finish().ok_or_else(|| ScanError::Nothing {
            from: format!("cell {}", self.cell),
            reasons: (missing.into_iter().map(ToOwned::to_owned))
                .chain(left_out)
                .chain(lost.clone())
                .collect(),
        })?;
        scan.lost.append(&mut lost);
        Ok(scan)
    }
}

#[cfg(test)]
mod tests;

//! The camera's estimate of the surface: the newest normal, with the segment and the map of the
//! same image.

use nalgebra::Vector3;
use tangent_control::{BendChange, VisionInput};
use tangent_estimation::depth_normal::DEPTH_NORMAL;
use tangent_runtime::{Bus, BusError, Latest};
use tangent_schemas::tangent::{ArmState, NormalEstimate, SurfaceAhead, SurfaceSegment};
use tangent_schemas::topics;

use super::normals::normal_estimate;

/// Reads the estimates of the depth camera.
pub struct VisionReader {
    frames: Latest<NormalEstimate>,
    segments: Latest<SurfaceSegment>,
    maps: Latest<SurfaceAhead>,
    /// The newest frame, with its time on the loop's clock.
    seen: Option<VisionInput>,
}

impl VisionReader {
    /// Subscribes to the topics of the depth camera's estimator.
    ///
    /// # Errors
    /// A topic cannot be read.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            frames: bus.latest(&topics::estimate_normal(DEPTH_NORMAL))?,
            segments: bus.latest(&topics::estimate_segment(DEPTH_NORMAL))?,
            maps: bus.latest(&topics::estimate_ahead(DEPTH_NORMAL))?,
            seen: None,
        })
    }

    /// The newest frame at the robot's packet `arm`, which came at `time_s`. The frame refers to an
    /// earlier packet, whose cycle it names. The law judges its age.
    pub fn look(&mut self, arm: &ArmState, time_s: f64) -> Option<VisionInput> {
        if let Some(new) = self.frames.take_new() {
            let seen = normal_estimate(&new.message);
            // Segment and map are published just before the normal of the same image. If one was
            // lost, the normal is used without it.
            let cycle = new.message.cycle;
            self.segments.refresh();
            let segment = self.segments.get().map(|segment| &segment.message);
            let surface_variation = segment
                .filter(|segment| segment.cycle == cycle)
                .map(|segment| segment.surface_variation);
            self.maps.refresh();
            let map = self.maps.get().map(|map| &map.message);
            let change = map.filter(|map| map.cycle == cycle).and_then(bend_change);
            // A frame from an earlier run of the bridge, whose count was higher, is not used.
            let behind = arm.cycle.checked_sub(new.message.cycle);
            self.seen = behind.map(|cycles| VisionInput {
                time_s: time_s - cycles as f64 * arm.period_s,
                point: seen.point,
                normal: seen.normal,
                covariance: seen.covariance,
                surface_variation,
                curvature: seen.curvature,
                change,
                validity: seen.validity,
            });
        }
        self.seen
    }
}

/// Change of the curvature ahead, as far as the map shows it.
fn bend_change(map: &SurfaceAhead) -> Option<BendChange> {
    let [first, second, ..] = map.points.as_slice() else {
        return None;
    };
    let way = Vector3::from(second) - Vector3::from(first);
    let stations = map.distance.iter().zip(&map.bend).zip(&map.bend_sd);
    BendChange::of(&way, stations.map(|((d, bend), sd)| (*d, *bend, *sd)))
}

//! Starts `depth_normal`, once its camera's calibration is known: at once where the cell file gives it, else when the camera
//! service says what the driver does.

use std::thread::JoinHandle;
use std::time::Duration;

use tangent_estimation::depth_normal::DepthNormal;
use tangent_mechanics::{Flange, Pose, Tool};
use tangent_runtime::config::Calibration;
use tangent_runtime::{Bus, Stop};
use tangent_schemas::topics;

use crate::depth::Depth;
use crate::{DepthPlan, EstimatorError};

/// How often the thread looks for a stop.
const LOOK: Duration = Duration::from_millis(50);

/// Starts it in a thread of its own, which ends with `stop`.
///
/// # Errors
/// A setting out of its range, a topic that the bus refuses, or no thread to be had.
pub(crate) fn start(
    plan: &DepthPlan,
    flange_from_tool: Pose<Flange, Tool>,
    bus: &Bus,
    stop: &Stop,
) -> Result<JoinHandle<()>, EstimatorError> {
    if let Some(calibration) = &plan.calibration {
        let depth = Depth::new(&plan.with(calibration), &flange_from_tool, bus)?;
        return Ok(depth.start(stop)?);
    }
    // A setting out of its range is refused now, not when the camera comes.
    DepthNormal::new(&plan.settings.fit)?;
    let infos = bus.subscribe(&topics::CAMERA_INFO, 1)?;
    let (plan, bus, stop) = (plan.clone(), bus.clone(), stop.clone());
    let thread = std::thread::Builder::new().name("depth-normal".into());
    Ok(thread.spawn(move || {
        let mut known = None;
        while !stop.is_stopped() && known.is_none() {
            known = infos
                .recv_timeout(LOOK)
                .and_then(|info| Calibration::of(&info.message));
        }
        let Some(calibration) = known else { return };
        tracing::info!("depth_normal: the camera's driver says {calibration:?}");
        match Depth::new(&plan.with(&calibration), &flange_from_tool, &bus) {
            Ok(mut depth) => {
                while !stop.is_stopped() {
                    depth.turn(LOOK);
                }
            }
            Err(error) => tracing::error!("depth_normal: {error}"),
        }
    })?)
}

//! Starts `depth_normal` once its camera's calibration is known: at once if the cell file contains
//! it, otherwise when the camera service publishes the driver's.

use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use tangent_estimation::depth_normal::DepthNormal;
use tangent_mechanics::{Flange, Pose, Tool};
use tangent_runtime::config::Calibration;
use tangent_runtime::{Bus, HealthReporter, Stop};
use tangent_schemas::Text;
use tangent_schemas::convert::cut;
use tangent_schemas::topics;

use crate::depth::{Depth, DepthMeters};
use crate::depth_watch::DepthWatch;
use crate::{DepthPlan, EstimatorError};

/// Interval between two checks for a stop.
const LOOK: Duration = Duration::from_millis(50);

/// Starts it in a separate thread, which ends with `stop`.
///
/// # Errors
/// A setting is out of range, the bus refuses a topic, or no thread can be started.
pub(crate) fn start(
    plan: &DepthPlan,
    flange_from_tool: Pose<Flange, Tool>,
    bus: &Bus,
    stop: &Stop,
    health: &HealthReporter,
) -> Result<DepthWatch, EstimatorError> {
    let (news, heard) = channel();
    let meters = DepthMeters::new(health);
    let age = meters.age().clone();
    let thread = std::thread::Builder::new().name("depth-normal".into());
    let own = stop.clone();
    let thread = if let Some(calibration) = &plan.calibration {
        let choice = plan.with(calibration);
        let mut depth = Depth::new(&choice, &flange_from_tool, bus, meters, news)?;
        thread.spawn(move || read_images(&mut depth, &own))?
    } else {
        // A setting out of range is refused now, not when the camera appears.
        DepthNormal::new(&plan.settings.fit)?;
        let (plan, bus) = (plan.clone(), bus.clone());
        let infos = bus.subscribe(&topics::CAMERA_INFO, 1)?;
        thread.spawn(move || {
            let mut known = None;
            let missing = "no camera/info with the camera's calibration: does its driver run?";
            tell(&news, Some(missing));
            while !own.is_stopped() && known.is_none() {
                known = infos
                    .recv_timeout(LOOK)
                    .and_then(|info| Calibration::of(&info.message));
            }
            let Some(calibration) = known else { return };
            tracing::info!("depth_normal: calibration from the camera's driver: {calibration}");
            tell(&news, None);
            let choice = plan.with(&calibration);
            match Depth::new(&choice, &flange_from_tool, &bus, meters, news) {
                Ok(mut depth) => read_images(&mut depth, &own),
                Err(error) => tracing::error!("depth_normal: {error}"),
            }
        })?
    };
    Ok(DepthWatch::new(heard, age, thread))
}

fn read_images(depth: &mut Depth, stop: &Stop) {
    while !stop.is_stopped() {
        depth.turn(LOOK);
    }
}

fn tell(news: &Sender<Option<Text>>, words: Option<&str>) {
    // A failure to send means that the service has ended.
    let _ = news.send(words.map(cut));
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use tangent_schemas::standard::CameraInfo;

    use super::*;
    use crate::DepthSettings;
    use crate::depth_watch::DepthTrouble;

    #[test]
    fn it_waits_for_the_drivers_calibration_where_the_file_has_none() {
        let bus = Bus::in_process("depth-start");
        let (images, infos) = (
            bus.publisher(&topics::CAMERA_DEPTH).unwrap(),
            bus.publisher(&topics::CAMERA_INFO).unwrap(),
        );
        let plan = DepthPlan {
            settings: DepthSettings::default(),
            calibration: None,
            flange_from_camera: Pose::identity(),
        };
        let stop = Stop::new();
        let health = HealthReporter::start_only(&bus, "estimator").unwrap();
        let mut watch = start(&plan, Pose::identity(), &bus, &stop, &health).unwrap();
        let told = loop {
            if let Some(trouble @ DepthTrouble::Refused(_)) = watch.trouble() {
                break trouble;
            }
            std::thread::park_timeout(Duration::from_millis(5));
        };
        assert!(told.words().contains("camera/info"), "{}", told.words());
        infos.publish(&CameraInfo::default());
        assert!(!images.is_read());
        let started = Instant::now();
        while !images.is_read() {
            infos.publish(&CameraInfo {
                height: 480,
                width: 848,
                k: [423.5, 0.0, 421.5, 0.0, 424.5, 239.5, 0.0, 0.0, 1.0],
                ..CameraInfo::default()
            });
            assert!(started.elapsed() < Duration::from_secs(20));
            std::thread::park_timeout(Duration::from_millis(5));
        }
        // The missing calibration has arrived; images have not.
        assert_eq!(watch.trouble(), Some(DepthTrouble::Blind));
        stop.trigger();
        watch.join().unwrap();
    }
}

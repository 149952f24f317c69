//! Checks the camera: whether its driver's images arrive, and whether they match the cell file.
//! Without a running cell this cannot be checked; the check says so and reports no fault.

use tangent_estimation::depth_normal::DepthEncoding;
use tangent_runtime::clock;
use tangent_runtime::config::{CameraConfig, CameraKind};
use tangent_schemas::standard::Image;
use tangent_schemas::topics::{Delivery, Topic};

use crate::finding::Finding;
use crate::on_the_bus::RunningCell;

/// Largest age of a stamp on arrival, s. An older stamp, or one that is ahead of now by more than a
/// tenth of this, comes from another clock.
const STAMP_AGE_S: f64 = 1.0;

/// Checks the messages on the driver's topics.
pub fn check(camera: &CameraConfig, cell: &RunningCell) -> Vec<Finding> {
    const CHECK: &str = "camera";
    let key = &camera.topic;
    let mut findings = Vec::new();
    if let Some(file) = camera.recording.as_ref().filter(|file| !file.is_file()) {
        findings.push(Finding::problem(
            CHECK,
            format!("[camera] recording = {} does not exist", file.display()),
            "no image is published",
            "correct the key, or leave it out and start the camera's driver",
        ));
    }
    let topic: Topic<Image> = Topic::named(key.clone(), Delivery::Bulk);
    match cell.receive(&topic) {
        Ok(Some(heard)) => findings.extend(judge(camera, &heard.last, heard.rate_hz)),
        Ok(None) => findings.push(Finding::warning(
            CHECK,
            format!("no image on {key} within 2 s"),
            "there are no estimates from images until its driver runs",
            "does the driver run, is its key that of [camera] topic, and is the bridge's namespace the cell's name? For a \
             simulated cell: `tangent run simulator`",
        )),
        Err(why) => findings.push(Finding::warning(
            CHECK,
            format!("not checked: {why}"),
            "whether images arrive is not known",
            "start router and driver, and run this again",
        )),
    }
    findings
}

fn judge(camera: &CameraConfig, image: &Image, rate_hz: Option<f64>) -> Vec<Finding> {
    let size = [image.width, image.height];
    let rate = rate_hz.map_or_else(String::new, |hz| format!(" at {hz:.0} Hz"));
    let found = format!("{} x {} {}{rate}", size[0], size[1], image.encoding);
    let refused = "every image is refused";
    let is_depth = DepthEncoding::from_name(&image.encoding).is_ok();
    // Where the cell file states no value, the driver's own calibration applies.
    let stated = camera.size_px.filter(|stated| *stated != size);
    let mut findings = vec![if let Some([width, height]) = stated {
        Finding::problem(
            "camera",
            format!("{found}, but [camera] size_px = [{width}, {height}]"),
            refused,
            "correct size_px, focal_px and principal_px, or the driver's mode",
        )
    } else if is_depth != (camera.kind == CameraKind::Depth) {
        Finding::problem(
            "camera",
            format!(
                "{found}, but [camera] kind is for {}",
                match camera.kind {
                    CameraKind::Depth => "depth: 16UC1 or 32FC1",
                    CameraKind::Target => "grey values or colours",
                }
            ),
            refused,
            "correct kind or topic",
        )
    } else {
        Finding::ok("camera", found)
    }];
    let age_s = (clock::now_ns() - image.header.stamp.to_ns()) as f64 * 1e-9;
    if !(-0.1 * STAMP_AGE_S..=STAMP_AGE_S).contains(&age_s) {
        findings.push(Finding::problem(
            "camera's clock",
            format!("the last image is {age_s:.1} s old by its stamp"),
            "no arm/state is from the time of its exposure, so it cannot be placed",
            "synchronise the clocks of the camera's host and this one (chrony), and let the driver stamp images with that clock",
        ));
    }
    findings
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::finding::Level;
    use tangent_runtime::{Bus, CellConfig, Stop};
    use tangent_schemas::standard::Header;

    fn karacan() -> CameraConfig {
        let text = include_str!("../../../deploy/cell.karacan.toml");
        let config = CellConfig::parse("cell.karacan.toml", text).unwrap();
        config.camera.unwrap()
    }

    fn image(size: [u32; 2], encoding: &str, age_s: f64) -> Image {
        Image {
            header: Header::new(clock::now_ns() - (age_s * 1e9) as i64, "camera"),
            width: size[0],
            height: size[1],
            encoding: encoding.into(),
            ..Image::default()
        }
    }

    #[test]
    fn images_that_would_be_refused_are_reported_before() {
        let level = |size, encoding, age_s| {
            judge(&karacan(), &image(size, encoding, age_s), Some(30.0))
                .into_iter()
                .map(|f| f.level)
                .max()
        };
        assert_eq!(level([640, 480], "16UC1", 0.05), Some(Level::Ok));
        assert_eq!(level([848, 480], "16UC1", 0.05), Some(Level::Problem));
        assert_eq!(level([640, 480], "rgb8", 0.05), Some(Level::Problem));
        assert_eq!(level([640, 480], "32FC1", 5.0), Some(Level::Problem));
        assert_eq!(level([640, 480], "32FC1", -5.0), Some(Level::Problem));
    }

    #[test]
    fn a_running_driver_is_found_and_a_missing_one_is_no_fault() {
        let bus = Bus::in_process("test");
        let cell = RunningCell::on(bus.clone());
        let silent = &check(&karacan(), &cell)[0];
        assert_eq!(silent.level, Level::Warning, "{silent:?}");
        let topic: Topic<Image> = Topic::named(karacan().topic, Delivery::Bulk);
        let images = bus.publisher(&topic).unwrap();
        let stop = Stop::new();
        let heard = std::thread::scope(|scope| {
            let ends = stop.clone();
            scope.spawn(move || {
                while !ends.wait(Duration::from_millis(5)) {
                    images.publish(&image([640, 480], "16UC1", 0.0));
                }
            });
            let heard = check(&karacan(), &cell).remove(0);
            stop.trigger();
            heard
        });
        assert_eq!(heard.level, Level::Ok, "{heard:?}");
        assert!(heard.found.starts_with("640 x 480 16UC1 at"), "{heard:?}");
    }
}

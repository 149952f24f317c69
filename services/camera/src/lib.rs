//! The camera service: receives images from a driver's topic; publishes the target's corners or the
//! depth images themselves, the calibration, and some images for viewers.
//!
//! The images may come from the simulator, or from a ROS 2 driver behind a bridge. The service runs
//! in a separate thread, in any process. It uses the newest image, and counts the images that were
//! skipped, refused or without a detection.

mod calibration;
mod config;
mod error;
mod picture;
mod player;

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_runtime::clock::now_ns;
use tangent_runtime::config::CameraKind;
use tangent_runtime::{
    Age, Beat, Bus, Counter, Gauge, HealthReporter, Histogram, Latest, Publisher, Rate,
    RealtimeReport, Stop, Subscription, realtime,
};
use tangent_schemas::Text;
use tangent_schemas::convert::cut_format;
use tangent_schemas::standard::{CameraInfo, Header, Image};
use tangent_schemas::tangent::{Feature, FeatureArray};
use tangent_schemas::topics::{self, Delivery, Topic};
use tangent_sensing::TargetDetector;

use calibration::Known;
pub use config::Config;
pub use error::CameraError;
pub use picture::{PictureError, check_depth, grey};
pub use player::Player;

/// Name in topics and health messages.
pub const SERVICE: &str = "camera";
/// Interval between two checks for a stop while no image arrives.
const LOOK: Duration = Duration::from_millis(50);
/// Silence of the driver after which it is reported, s.
const PATIENCE_S: f64 = 0.5;
/// Time between two announcements of the calibration.
const INFO_EVERY: Duration = Duration::from_secs(1);

/// Runs until `stop`. Blocks.
///
/// # Errors
/// The bus refuses a topic, or the detector cannot be created.
pub fn run(config: Config, bus: Bus, stop: Stop) -> Result<(), CameraError> {
    let priority = config.realtime_priority;
    let player = match &config.recording {
        Some((file, topic)) => Some(start_player(
            Player::open(file, topic.as_deref())?,
            &config.topic,
            &bus,
            &stop,
        )?),
        None => None,
    };
    let mut service = Service::new(config, &bus)?;
    service.health.realtime(&match priority {
        Some(priority) => realtime::setup_thread(SERVICE, priority),
        None => RealtimeReport::not_asked(SERVICE),
    });
    service.health.running();
    let beat = Beat::new(SERVICE);
    while !stop.is_stopped() {
        beat.beat();
        service.announce();
        service.turn(LOOK);
    }
    drop(beat);
    if let Some(player) = player
        && player.join().is_err()
    {
        tracing::error!("the thread that plays the recording failed");
    }
    Ok(())
}

/// Plays a recording in place of a driver.
fn start_player(
    player: Player,
    topic: &str,
    bus: &Bus,
    stop: &Stop,
) -> Result<JoinHandle<()>, CameraError> {
    let driver: Topic<Image> = Topic::named(topic.to_owned(), Delivery::Bulk);
    let (publisher, stop) = (bus.publisher(&driver)?, stop.clone());
    Ok(std::thread::Builder::new()
        .name("camera-recording".into())
        .spawn(move || player.play(&publisher, &stop))?)
}

struct Service {
    config: Config,
    images: Subscription<Image>,
    driver_info: Option<Latest<CameraInfo>>,
    known: Known,
    features: Publisher<FeatureArray>,
    info: Publisher<CameraInfo>,
    passed_on: Publisher<Image>,
    depth: Publisher<Image>,
    detector: TargetDetector,
    /// Stamp of the newest image that was used, ns.
    newest_ns: Option<i64>,
    sequence: u64,
    announced: Option<Instant>,
    passed_at: Option<Instant>,
    meters: Meters,
    said: Option<Text>,
    health: HealthReporter,
}

struct Meters {
    images: Rate,
    age: Age,
    exposure_age: Gauge,
    skipped: Gauge,
    refused: Gauge,
    empty: Gauge,
    detect: Histogram,
    lost: Counter,
}

impl Service {
    fn new(config: Config, bus: &Bus) -> Result<Self, CameraError> {
        let health = HealthReporter::start(bus, SERVICE)?;
        let driver: Topic<Image> = Topic::named(config.topic.clone(), Delivery::Bulk);
        Ok(Self {
            images: bus.subscribe(&driver, 4)?,
            driver_info: match &config.info_topic {
                Some(key) => Some(bus.latest(&Topic::named(key.clone(), Delivery::Background))?),
                None => None,
            },
            known: Known::new(config.calibration),
            features: bus.publisher(&topics::CAMERA_FEATURES)?,
            info: bus.publisher(&topics::CAMERA_INFO)?,
            passed_on: bus.publisher(&topics::CAMERA_IMAGE)?,
            depth: bus.publisher(&topics::CAMERA_DEPTH)?,
            detector: TargetDetector::new()?,
            newest_ns: None,
            sequence: 0,
            announced: None,
            passed_at: None,
            meters: Meters {
                images: health.rate("images"),
                age: health.age("images"),
                exposure_age: health.gauge("exposure_age_s"),
                skipped: health.gauge("images_skipped"),
                refused: health.gauge("images_refused"),
                empty: health.gauge("images_without_target"),
                detect: health.histogram("detect"),
                lost: health.lost(),
            },
            said: None,
            health,
            config,
        })
    }

    /// Publishes the calibration again, so that late subscribers have it too.
    fn announce(&mut self) {
        if let Some(driver) = &mut self.driver_info
            && let Some(info) = driver.take_new()
        {
            self.known.receive(&info.message);
        }
        if self.announced.is_some_and(|at| at.elapsed() < INFO_EVERY) {
            return;
        }
        self.announced = Some(Instant::now());
        if let Some(info) = self.known.info(now_ns()) {
            self.info.publish(&info);
        }
    }

    /// Handles one image: the newest one that waits, or the next to arrive.
    fn turn(&mut self, patience: Duration) {
        let Some(mut newest) = self.images.recv_timeout(patience) else {
            let age = self.meters.age.seconds();
            if !(0.0..=PATIENCE_S).contains(&age) {
                let topic = self.config.topic.clone();
                self.say(Some(cut_format(format_args!(
                    "no image on {topic} for more than {PATIENCE_S} s: is the camera's driver running?"
                ))));
            }
            return;
        };
        while let Some(newer) = self.images.try_recv() {
            self.meters.skipped.set(self.meters.skipped.get() + 1.0);
            newest = newer;
        }
        self.meters.images.tick();
        self.meters.age.mark_at(newest.received);
        self.meters.lost.set(self.images.lost());
        match self.take(&newest.message) {
            Ok(()) => {
                let topic = self.config.info_topic.as_deref().unwrap_or_default();
                let trouble = self.known.trouble(topic);
                self.say(trouble.map(|words| cut_format(format_args!("{words}"))));
            }
            Err(error) => {
                self.meters.refused.set(self.meters.refused.get() + 1.0);
                self.say(Some(cut_format(format_args!("image refused: {error}"))));
            }
        }
    }

    fn take(&mut self, image: &Image) -> Result<(), PictureError> {
        let stamp_ns = image.header.stamp.to_ns();
        if let Some(newest_ns) = self.newest_ns
            && stamp_ns <= newest_ns
            && stamp_ns + picture::RESTART_NS > newest_ns
        {
            return Err(PictureError::OutOfOrder {
                behind_s: (newest_ns - stamp_ns) as f64 * 1e-9,
            });
        }
        let size_px = self
            .known
            .calibration()
            .ok_or(PictureError::Uncalibrated)?
            .size_px;
        if self.config.kind == CameraKind::Depth {
            picture::check_depth(image, size_px)?;
            self.newest_ns = Some(stamp_ns);
            self.depth.publish(image);
            self.meters
                .exposure_age
                .set((now_ns() - stamp_ns) as f64 * 1e-9);
            self.pass_on(image, image.header.clone());
            return Ok(());
        }
        let begin = Instant::now();
        let picture = grey(image, size_px)?;
        self.newest_ns = Some(stamp_ns);
        let found = self
            .detector
            .detect(&picture)
            .map_err(|error| PictureError::Detector(error.to_string()))?;
        let took = begin.elapsed();
        let features: Vec<Feature> = found
            .iter()
            .zip(0..)
            .filter_map(|(corner, id)| {
                corner.map(|at| Feature {
                    id,
                    u: at.x,
                    v: at.y,
                })
            })
            .collect();
        if features.is_empty() {
            self.meters.empty.set(self.meters.empty.get() + 1.0);
        }
        let header = Header::new(stamp_ns, "camera");
        self.features.publish(&FeatureArray {
            header: header.clone(),
            sequence: self.sequence,
            features,
            detect_s: took.as_secs_f64(),
        });
        self.sequence += 1;
        self.meters.detect.record(took);
        let age_s = (now_ns() - stamp_ns) as f64 * 1e-9;
        self.meters.exposure_age.set(age_s);
        self.pass_on(image, header);
        Ok(())
    }

    fn pass_on(&mut self, image: &Image, header: Header) {
        let due = self.config.pass_on_hz > 0.0
            && self
                .passed_at
                .is_none_or(|at| at.elapsed().as_secs_f64() >= 1.0 / self.config.pass_on_hz);
        if due {
            self.passed_at = Some(Instant::now());
            self.passed_on.publish(&Image {
                header,
                ..image.clone()
            });
        }
    }

    fn say(&mut self, trouble: Option<Text>) {
        if self.said == trouble && trouble.is_some() {
            return;
        }
        match trouble {
            None if self.said.is_none() => {}
            None => self.health.running(),
            Some(words) => self.health.degraded(format_args!("{words}")),
        }
        self.said = trouble;
    }
}

#[cfg(test)]
mod tests;

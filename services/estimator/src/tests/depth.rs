//! `depth_normal` in the service. The camera is at the tool and looks along it, 0.3 m over the
//! surface.

use super::*;
use tangent_runtime::State;
use tangent_schemas::standard::Image;
use tangent_schemas::tangent::Health;

const SIZE: [u32; 2] = [160, 120];
const PERIOD_NS: i64 = 8_000_000;

fn with_depth() -> Config {
    Config {
        depth: Some(DepthPlan {
            settings: DepthSettings::default(),
            calibration: Some(tangent_runtime::config::Calibration {
                size_px: SIZE,
                focal_px: [100.0, 100.0],
                principal_px: [79.5, 59.5],
            }),
            flange_from_camera: Pose::new(Vector3::new(0.0, 0.0, -0.3), UnitQuaternion::identity()),
        }),
        ..config(&[])
    }
}

/// Depth image of a plane 0.3 m in front of the camera.
fn image(size: [u32; 2], stamp_ns: i64) -> Image {
    Image {
        header: Header::new(stamp_ns, "camera"),
        width: size[0],
        height: size[1],
        encoding: "16UC1".into(),
        step: 2 * size[0],
        data: 300_u16.to_le_bytes().repeat((size[0] * size[1]) as usize),
        ..Image::default()
    }
}

/// A service with publishers of its inputs and subscribers of its outputs.
struct Rig {
    cell: Cell,
    images: tangent_runtime::Publisher<Image>,
    normals: Subscription<NormalEstimate>,
    health: Subscription<Health>,
    _service: Running,
}

impl Rig {
    fn new() -> Self {
        let bus = Bus::in_process("depth");
        let normals = bus
            .subscribe(&topics::estimate_normal(DEPTH_NORMAL), 8)
            .unwrap();
        let health = bus.subscribe(&topics::health(SERVICE), 64).unwrap();
        Self {
            cell: Cell::new(&bus),
            images: bus.publisher(&topics::CAMERA_DEPTH).unwrap(),
            normals,
            health,
            _service: Running::start(&bus, with_depth()),
        }
    }

    /// Publishes an arm state, and an image of its time plus `late_ns`. Returns the estimate.
    fn look(&mut self, size: [u32; 2], late_ns: i64) -> NormalEstimate {
        self.cell.cycle(3.0, Validity::Valid);
        let stamp_ns = self.cell.cycle as i64 * PERIOD_NS;
        self.images.publish(&image(size, stamp_ns + late_ns));
        next(&self.normals)
    }

    /// Publishes images until the health satisfies the condition.
    fn until(&mut self, size: [u32; 2], late_ns: i64, told: impl Fn(&Health) -> bool) -> Health {
        let deadline = Instant::now() + PATIENCE;
        loop {
            self.look(size, late_ns);
            while let Some(heard) = self.health.try_recv() {
                if told(&heard.message) {
                    return heard.message;
                }
            }
            assert!(Instant::now() < deadline, "it never said so");
            thread::sleep(Duration::from_millis(5));
        }
    }
}

fn figure(health: &Health, name: &str) -> f64 {
    let index = health.figure_names.iter().position(|n| n == name);
    health.figures[index.unwrap_or_else(|| panic!("no {name}"))]
}

fn is_degraded(health: &Health, words: &str) -> bool {
    health.state == State::Degraded as u8 && health.fault.contains(words)
}

#[test]
fn an_image_of_a_wrong_size_is_reported_until_the_next_good_one() {
    let mut rig = Rig::new();
    let good = rig.look(SIZE, 0);
    assert_eq!(good.validity, 0, "{}", good.reason);
    assert_eq!(good.cycle, 1);
    rig.until(SIZE, 0, |h| h.state == State::Running as u8);
    let last_good = rig.look(SIZE, 0);
    let refused = rig.look([848, 480], 0);
    assert_eq!(Validity::from(refused.validity), Validity::SensorError);
    assert!(refused.reason.contains("848, 480"), "{}", refused.reason);
    // It has the cycle of the last good image, so a reader that judges by age treats it as silence.
    assert_eq!(refused.header.stamp, last_good.header.stamp);
    assert_eq!(refused.cycle, last_good.cycle);
    assert_eq!(refused.normal, last_good.normal);
    rig.until([848, 480], 0, |h| {
        is_degraded(
            h,
            "depth_normal: [848, 480] pixels, but camera.size_px is [160, 120]",
        )
    });
    let well = rig.until(SIZE, 0, |h| {
        let rate = h.rate_names.iter().position(|n| n == "camera_depth");
        h.state == State::Running as u8 && rate.is_some_and(|i| h.rates_hz[i] > 0.0)
    });
    assert!(figure(&well, "depth_update_n") > 0.0);
    assert!(figure(&well, "depth_images_refused") >= 2.0);
    assert_eq!(figure(&well, "depth_images_skipped"), 0.0);
    let age = well.age_names.iter().position(|n| n == "camera_depth");
    assert!((0.0..0.5).contains(&well.ages_s[age.unwrap()]));
}

#[test]
fn an_image_without_an_arm_state_of_its_time_is_reported() {
    let mut rig = Rig::new();
    // Before the first frame there is no cycle and no stamp, so the estimate counts as infinitely
    // old.
    let unplaced = rig.look(SIZE, 3_000_000_000);
    assert_eq!(Validity::from(unplaced.validity), Validity::SensorError);
    assert!(
        unplaced.reason.contains("do the clocks"),
        "{}",
        unplaced.reason
    );
    assert_eq!((unplaced.cycle, unplaced.header.stamp.to_ns()), (0, 0));
    rig.until(SIZE, 3_000_000_000, |h| {
        is_degraded(h, "depth_normal: no arm/state from the time")
    });
    rig.until(SIZE, 0, |h| h.state == State::Running as u8);
}

#[test]
fn an_encoding_without_depth_is_reported_by_name() {
    let mut rig = Rig::new();
    rig.cell.cycle(3.0, Validity::Valid);
    let mut colours = image(SIZE, PERIOD_NS);
    colours.encoding = "rgb8".into();
    rig.images.publish(&colours);
    let refused = next(&rig.normals);
    assert!(refused.reason.contains("\"rgb8\""), "{}", refused.reason);
}

#[test]
fn a_silent_camera_is_reported() {
    let mut rig = Rig::new();
    rig.until(SIZE, 0, |h| h.state == State::Running as u8);
    let deadline = Instant::now() + PATIENCE;
    loop {
        rig.cell.cycle(3.0, Validity::Valid);
        let heard = rig.health.try_recv();
        if heard.is_some_and(|h| is_degraded(&h.message, "no camera/depth for more than")) {
            return;
        }
        assert!(Instant::now() < deadline);
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_thread_that_dies_is_noticed_while_the_service_runs() {
    let bus = Bus::in_process("depth");
    let health = bus.subscribe(&topics::health(SERVICE), 64).unwrap();
    let mut service = Service::new(&config(&["blend"]), &bus).unwrap();
    let (news, heard) = std::sync::mpsc::channel();
    let dies = thread::spawn(move || {
        let _news = news;
        panic!("as a test asks");
    });
    service.depth = Some(DepthWatch::new(heard, Age::default(), dies));
    let deadline = Instant::now() + PATIENCE;
    loop {
        service.turn(Duration::from_millis(5));
        if let Some(told) = health.try_recv()
            && told.message.state == State::Fault as u8
        {
            assert!(
                told.message
                    .fault
                    .contains("the thread of depth_normal has ended")
            );
            break;
        }
        assert!(Instant::now() < deadline);
    }
    let depth = service.depth.take().unwrap();
    assert!(depth.join().is_err(), "the service ends with an error");
}

#![allow(clippy::unwrap_used)]

use super::*;
use tangent_runtime::config::Calibration;

fn config() -> Config {
    Config {
        topic: "driver/image".to_owned(),
        recording: None,
        kind: CameraKind::Target,
        info_topic: None,
        calibration: Some(Calibration {
            size_px: [200, 160],
            focal_px: [200.0, 200.0],
            principal_px: [100.0, 80.0],
        }),
        pass_on_hz: 1e3,
        realtime_priority: None,
    }
}

/// A plate with its four marks and the dot, drawn straight from above.
fn plate(stamp_ns: i64) -> Image {
    let (width, height) = (200_u32, 160_u32);
    let corners = [[60.0, 40.0], [140.0, 40.0], [140.0, 120.0], [60.0, 120.0]];
    let mut data = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let (x, y) = (f64::from(column), f64::from(row));
            let mark = corners.iter().any(|[cx, cy]| {
                let (dx, dy) = (x - cx, y - cy);
                dx.abs() < 12.0 && dy.abs() < 12.0 && dx * dy > 0.0
            });
            let dot = (x - 80.0).hypot(y - 60.0) < 7.0;
            data.push(if mark || dot { 35 } else { 210 });
        }
    }
    Image {
        header: Header::new(stamp_ns, "camera"),
        height,
        width,
        encoding: "mono8".to_owned(),
        step: width,
        data,
        ..Image::default()
    }
}

struct Bench {
    service: Service,
    driver: Publisher<Image>,
    features: Subscription<FeatureArray>,
    info: Subscription<CameraInfo>,
    passed_on: Subscription<Image>,
}

impl Bench {
    fn new() -> Self {
        let bus = Bus::in_process("camera-test");
        let driver: Topic<Image> = Topic::new("driver/image", Delivery::Stream);
        Self {
            features: bus.subscribe(&topics::CAMERA_FEATURES, 8).unwrap(),
            info: bus.subscribe(&topics::CAMERA_INFO, 8).unwrap(),
            passed_on: bus.subscribe(&topics::CAMERA_IMAGE, 8).unwrap(),
            service: Service::new(config(), &bus).unwrap(),
            driver: bus.publisher(&driver).unwrap(),
        }
    }

    fn show(&mut self, image: &Image) -> Option<FeatureArray> {
        self.driver.publish(image);
        self.service.turn(Duration::from_secs(5));
        self.features.try_recv().map(|found| found.message.clone())
    }

    fn refused(&self) -> f64 {
        self.service.meters.refused.get()
    }
}

#[test]
fn an_image_becomes_features_with_its_own_stamp() {
    let mut bench = Bench::new();
    let stamp = 1_700_000_000_123_456_789;
    let found = bench.show(&plate(stamp)).unwrap();
    assert_eq!(found.header.stamp.to_ns(), stamp);
    assert_eq!(found.header.frame_id.as_str(), "camera");
    let ids: Vec<u32> = found.features.iter().map(|f| f.id).collect();
    assert_eq!(ids, [0, 1, 2, 3]);
    // Counter-clockwise as the camera sees it, whose y axis points down.
    for (feature, expected) in
        found
            .features
            .iter()
            .zip([[60.0, 40.0], [60.0, 120.0], [140.0, 120.0], [140.0, 40.0]])
    {
        let off = (feature.u - expected[0]).hypot(feature.v - expected[1]);
        assert!(off < 1.0, "{feature:?}");
    }
    assert_eq!(
        bench.passed_on.try_recv().unwrap().message.data.len(),
        32_000
    );
}

#[test]
fn an_image_without_a_target_is_published_as_empty() {
    let mut bench = Bench::new();
    let mut blank = plate(1_000_000_000);
    blank.data.fill(128);
    let found = bench.show(&blank).unwrap();
    assert!(found.features.is_empty());
    assert_eq!(bench.service.meters.empty.get(), 1.0);
}

#[test]
fn images_out_of_order_or_of_another_size_are_refused_and_counted() {
    let mut bench = Bench::new();
    assert_eq!(bench.show(&plate(5_000_000_000)).unwrap().sequence, 0);
    assert!(bench.show(&plate(4_980_000_000)).is_none());
    assert!(bench.show(&plate(5_000_000_000)).is_none());
    let mut small = plate(5_020_000_000);
    small.width = 100;
    assert!(bench.show(&small).is_none());
    assert_eq!(bench.refused(), 3.0);
    assert!(bench.service.said.unwrap().contains("camera.size_px"));
    assert_eq!(bench.show(&plate(5_040_000_000)).unwrap().sequence, 1);
    assert!(bench.service.said.is_none());
}

#[test]
fn images_of_a_restarted_driver_are_accepted() {
    let mut bench = Bench::new();
    assert!(bench.show(&plate(100_000_000_000)).is_some());
    assert!(bench.show(&plate(1_000_000_000)).is_some());
}

#[test]
fn the_calibration_is_announced() {
    let mut bench = Bench::new();
    bench.service.announce();
    bench.service.announce();
    let info = bench.info.try_recv().unwrap().message.clone();
    assert_eq!((info.width, info.height), (200, 160));
    assert_eq!(info.k, [200.0, 0.0, 100.0, 0.0, 200.0, 80.0, 0.0, 0.0, 1.0]);
    assert!(bench.info.try_recv().is_none());
}

#[test]
fn silence_of_the_driver_is_reported() {
    let mut bench = Bench::new();
    bench.service.turn(Duration::from_millis(1));
    assert!(bench.service.said.unwrap().contains("driver/image"));
}

#[test]
fn images_wait_for_the_drivers_calibration_where_the_file_has_none() {
    let bus = Bus::in_process("camera-driver");
    let key = "driver/camera_info";
    let driver: Topic<Image> = Topic::new("driver/image", Delivery::Bulk);
    let infos = bus
        .publisher(&Topic::<CameraInfo>::new(key, Delivery::Background))
        .unwrap();
    let images = bus.publisher(&driver).unwrap();
    let depth = bus.subscribe(&topics::CAMERA_DEPTH, 8).unwrap();
    let announced = bus.subscribe(&topics::CAMERA_INFO, 8).unwrap();
    let mut service = Service::new(
        Config {
            kind: CameraKind::Depth,
            info_topic: Some(key.to_owned()),
            calibration: None,
            ..config()
        },
        &bus,
    )
    .unwrap();
    let image = |stamp_ns| Image {
        header: Header::new(stamp_ns, "camera_depth_optical_frame"),
        height: 480,
        width: 848,
        encoding: "mono16".to_owned(),
        step: 2 * 848,
        data: vec![1; 2 * 848 * 480],
        ..Image::default()
    };
    service.announce();
    images.publish(&image(1_000_000_000));
    service.turn(Duration::from_secs(5));
    assert!(service.said.as_ref().unwrap().contains("camera.info_topic"));
    assert!(depth.try_recv().is_none() && announced.try_recv().is_none());

    infos.publish(&CameraInfo {
        height: 480,
        width: 848,
        k: [423.5, 0.0, 421.5, 0.0, 424.5, 239.5, 0.0, 0.0, 1.0],
        ..CameraInfo::default()
    });
    service.announced = None;
    service.announce();
    images.publish(&image(2_000_000_000));
    service.turn(Duration::from_secs(5));
    assert_eq!(service.said, None);
    assert_eq!(depth.try_recv().unwrap().message.width, 848);
    assert_eq!(announced.try_recv().unwrap().message.k[4], 424.5);
}

//! Whole images over a real router: from our own publishers, and from a client without our code,
//! such as a ROS 2 bridge.
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::{Bus, CellConfig, Role, Subscription};
use tangent_schemas::cdr;
use tangent_schemas::standard::{Header, Image};
use tangent_schemas::topics::{Delivery, Topic};
use zenoh::Wait;

const FRAMES: u64 = 60;
/// Number of images of each size that must arrive; a busy machine may lose the others.
const WHOLE_MIN: u64 = 54;
/// Number of attempts, since a machine may be busy for a second or two.
const ATTEMPTS: u32 = 3;
/// Longest wait for an image.
const LATE: Duration = Duration::from_millis(500);
const PERIOD: Duration = Duration::from_micros(33_333);
const DRIVER: Topic<Image> = Topic::new("driver/image", Delivery::Bulk);

/// Sizes of the images of depth cameras: 0.6, 0.8, 1.2 and 1.6 MB.
const KINDS: [(u32, u32, &str, u32); 4] = [
    (640, 480, "16UC1", 2),
    (848, 480, "16UC1", 2),
    (640, 480, "32FC1", 4),
    (848, 480, "32FC1", 4),
];

fn image((width, height, encoding, bytes): (u32, u32, &str, u32)) -> Image {
    let step = width * bytes;
    Image {
        header: Header::new(0, "camera"),
        height,
        width,
        encoding: encoding.to_owned(),
        step,
        data: (0..step * height).map(|i| (i % 251) as u8).collect(),
        ..Image::default()
    }
}

/// Publishes the image `FRAMES` times, at 30 Hz or as fast as a busy machine can. Returns how many
/// arrived complete at all readers.
fn came(readers: &[Subscription<Image>], sent: &Image, show: &mut dyn FnMut(&Image)) -> u64 {
    let mut whole = 0;
    for _ in 0..FRAMES {
        let start = Instant::now();
        show(sent);
        let all = readers.iter().all(|reader| {
            let received = reader.recv_timeout(LATE.saturating_sub(start.elapsed()));
            received.is_some_and(|received| received.message.data == sent.data)
        });
        whole += u64::from(all);
        while let Some(left) = PERIOD.checked_sub(start.elapsed()) {
            std::thread::park_timeout(left);
        }
    }
    whole
}

fn all_sizes_come(readers: &[Subscription<Image>], mut show: impl FnMut(&Image)) {
    for kind in KINDS {
        let sent = image(kind);
        let enough = (0..ATTEMPTS).any(|attempt| {
            let count = came(readers, &sent, &mut show);
            println!("{kind:?}, attempt {attempt}: {count} of {FRAMES}");
            count >= WHOLE_MIN
        });
        assert!(enough, "{kind:?}: fewer than {WHOLE_MIN} came");
    }
}

/// A session with Zenoh's own defaults: no namespace, no attachment, no encoding, `Priority::Data`,
/// dropped under congestion.
fn foreigner(config: &CellConfig) -> zenoh::Session {
    let mut foreign = zenoh::Config::default();
    foreign.insert_json5("mode", "\"client\"").unwrap();
    let endpoints = format!("{:?}", config.zenoh.connect);
    foreign
        .insert_json5("connect/endpoints", &endpoints)
        .unwrap();
    foreign
        .insert_json5("scouting/multicast/enabled", "false")
        .unwrap();
    zenoh::open(foreign).wait().unwrap()
}

#[test]
fn images_of_a_foreign_client_arrive_whole() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let bus = client(&config);
        let images = bus.subscribe(&DRIVER, 64).unwrap();
        let session = foreigner(&config);
        let driver = session
            .declare_publisher(format!("{}/{}", config.cell.name, DRIVER.key()))
            .wait()
            .unwrap();
        until("the reader", || {
            driver.matching_status().wait().unwrap().matching()
        });
        all_sizes_come(&[images], |image| {
            let mut bytes = Vec::new();
            cdr::encode(image, &mut bytes).unwrap();
            driver.put(bytes).wait().unwrap();
        });
    });
}

#[test]
fn our_own_images_arrive_whole_at_two_readers() {
    timed(|| {
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let (near, far, other) = (client(&config), client(&config), client(&config));
        let driver = near.publisher(&DRIVER).unwrap();
        let readers = [&far, &other].map(|bus| bus.subscribe(&DRIVER, 64).unwrap());
        until("the readers", || {
            driver.publish(&Image::default());
            readers.iter().all(|reader| reader.try_recv().is_some())
        });
        for reader in &readers {
            while reader.recv_timeout(Duration::from_millis(100)).is_some() {}
        }
        all_sizes_come(&readers, |image| {
            driver.publish(image);
        });
    });
}

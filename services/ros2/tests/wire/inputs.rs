//! Topics of ROS 2 into the cell, and what is refused.

use tangent_runtime::Subscription;
use tangent_runtime::clock::now_ns;
use tangent_schemas::standard::{Header, Image, PoseWithCovarianceStamped, WrenchStamped};
use tangent_schemas::tangent::Health;
use tangent_schemas::topics::{self, Delivery, Topic};
use tangent_schemas::{Message, cdr};
use zenoh::Wait;

use crate::common::{Cell, PATIENCE, attachment};

const TOPIC: &str = "odom/pose";

fn pose(x: f64) -> PoseWithCovarianceStamped {
    let mut pose = PoseWithCovarianceStamped {
        header: Header::new(now_ns(), "world"),
        ..PoseWithCovarianceStamped::default()
    };
    pose.pose.pose.position.x = x;
    pose.pose.pose.orientation.w = 1.0;
    pose
}

fn bytes<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    bytes
}

struct Odometry<'a> {
    cell: &'a Cell,
    key: String,
    sequence: i64,
}

impl Odometry<'_> {
    fn put(&mut self, payload: &[u8], gid: u8) {
        self.sequence += 1;
        let attachment = attachment(self.sequence, now_ns(), [gid; 16]);
        let put = self.cell.ros.put(&self.key, payload);
        put.attachment(attachment).wait().unwrap();
    }
}

fn figure(health: &Health, name: &str) -> f64 {
    let index = health.figure_names.iter().position(|known| known == name);
    health.figures[index.unwrap_or_else(|| panic!("{name}: {health:?}"))]
}

/// Sends poses until one arrives in the cell.
fn arrives(odometry: &mut Odometry, poses: &Subscription<PoseWithCovarianceStamped>) {
    let begin = std::time::Instant::now();
    loop {
        odometry.put(&bytes(&pose(0.5)), 1);
        if let Some(received) = poses.recv_timeout(std::time::Duration::from_millis(100)) {
            assert_eq!(received.message.pose.pose.position.x, 0.5);
            return;
        }
        assert!(begin.elapsed() < PATIENCE, "no pose arrived");
    }
}

#[test]
fn a_pose_of_the_base_is_let_in_and_nonsense_is_not() {
    let cell = Cell::start("inputs = { base_pose = \"/odom/pose\" }", "");
    let poses = cell.bus.subscribe(&topics::BASE_POSE, 64).unwrap();
    let mut odometry = Odometry {
        cell: &cell,
        key: Cell::key(TOPIC, PoseWithCovarianceStamped::NAME),
        sequence: 0,
    };
    arrives(&mut odometry, &poses);
    let whole = bytes(&pose(1.0));
    let mut not_finite = pose(2.0);
    not_finite.pose.covariance.0[7] = f64::NAN;
    let mut refused = 0.0;
    // Each of these is refused, counted and named; only a whole pose of the first publisher passes.
    for (payload, gid, words) in [
        (whole[..whole.len() - 1].to_vec(), 1, "payload too short"),
        (whole[..3].to_vec(), 1, "payload too short"),
        ([&whole[..], &[0; 8]].concat(), 1, "left over"),
        (bytes(&not_finite), 1, "not finite"),
        (bytes(&pose(3.0)), 2, "a second publisher"),
    ] {
        // Keeps the first publisher from being silent.
        odometry.put(&bytes(&pose(0.25)), 1);
        odometry.put(&payload, gid);
        refused += 1.0;
        let health = cell.until_health(words, |health| health.fault.contains(words));
        assert!(health.fault.contains("/odom/pose"), "{}", health.fault);
        assert_eq!(health.state, 2);
        let least = figure(&health, "base/pose_refused");
        assert!((refused..=refused + 1.0).contains(&least), "{least}");
    }
    let put = cell.ros.put(&odometry.key, whole.clone());
    put.wait().unwrap();
    cell.until_health("nameless", |health| {
        health.fault.contains("no sequence number")
    });
    while let Some(received) = poses.try_recv() {
        let x = received.message.pose.pose.position.x;
        assert!(x == 0.25 || x == 0.5, "{x}");
    }
    arrives(&mut odometry, &poses);
    cell.until_health("running again", |health| health.state == 1);
}

#[test]
fn a_publisher_with_another_type_hash_is_named() {
    let cell = Cell::start("inputs = { base_pose = \"/odom/pose\" }", "");
    let token = cell
        .ros
        .liveliness()
        .declare_token(
            "@ros2_lv/0/abc/0/7/MP/%/%left/odometry/%odom%pose/\
             geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/RIHS01_00/::,10:,:,:,,",
        )
        .wait()
        .unwrap();
    let health = cell.until_health("the node", |health| health.state == 2);
    assert!(health.fault.contains("/left/odometry"), "{}", health.fault);
    token.undeclare().wait().unwrap();
    cell.until_health("running again", |health| health.state == 1);
}

#[test]
fn wrenches_and_images_arrive_on_the_keys_of_their_sections() {
    let cell = Cell::start(
        "inputs = { wrench = \"/ft/wrench\", image = \"/camera/image\" }",
        "[sensor]\ndriver = \"topic\"\nrate_hz = 500.0\nforce_range_n = [100.0, 100.0, 100.0]\n\
         torque_range_nm = [5.0, 5.0, 5.0]\ntopic = { key = \"ros2/wrench\" }\n\
         [camera]\ntopic = \"ros2/image\"\nsize_px = [320, 240]\nfocal_px = 400.0\nprincipal_px = [160.0, 120.0]\n\
         flange_from_camera = { translation_m = [0.07, 0.0, -0.05] }",
    );
    let to = Topic::<WrenchStamped>::new("ros2/wrench", Delivery::RealTime);
    let wrenches = cell.bus.subscribe(&to, 64).unwrap();
    let images = cell
        .bus
        .subscribe(&Topic::<Image>::new("ros2/image", Delivery::Bulk), 64)
        .unwrap();
    let mut wrench = WrenchStamped {
        header: Header::new(now_ns(), "ft"),
        ..WrenchStamped::default()
    };
    wrench.wrench.force.z = -4.5;
    let image = Image {
        header: Header::new(now_ns(), "camera"),
        width: 320,
        height: 240,
        step: 640,
        encoding: "16UC1".to_owned(),
        data: vec![7; 640 * 240],
        ..Image::default()
    };
    let (wrench_key, image_key) = (
        Cell::key("ft/wrench", WrenchStamped::NAME),
        Cell::key("camera/image", Image::NAME),
    );
    let (mut sequence, mut came) = (0, (false, false));
    crate::common::until("both", || {
        sequence += 1;
        for (key, payload) in [(&wrench_key, bytes(&wrench)), (&image_key, bytes(&image))] {
            let from = attachment(sequence, now_ns(), [1; 16]);
            let put = cell.ros.put(key, payload);
            put.attachment(from).wait().unwrap();
        }
        while let Some(received) = wrenches.try_recv() {
            assert_eq!(received.message, wrench);
            came.0 = true;
        }
        while let Some(received) = images.try_recv() {
            assert_eq!(received.message, image);
            came.1 = true;
        }
        came == (true, true)
    });
}

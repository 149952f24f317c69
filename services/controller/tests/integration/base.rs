//! The controller on a mobile platform: it reads `base/pose` in its cycle, and stops safely when
//! the pose cannot be used.

use std::time::{Duration, Instant};

use crate::common::Cell;
use tangent_live::timed;
use tangent_runtime::Publisher;
use tangent_schemas::standard::{Header, PoseWithCovarianceStamped};
use tangent_schemas::topics;

struct Platform {
    pose: Publisher<PoseWithCovarianceStamped>,
    began: Instant,
}

impl Platform {
    fn new(cell: &Cell) -> Self {
        Self {
            pose: cell.bus.publisher(&topics::BASE_POSE).unwrap(),
            began: Instant::now(),
        }
    }

    /// Publishes a pose at rest, after `modify` has changed it.
    fn say(&self, modify: impl FnOnce(&mut PoseWithCovarianceStamped)) {
        let stamp_ns = 1_000_000_000 + self.began.elapsed().as_nanos() as i64;
        let mut message = PoseWithCovarianceStamped {
            header: Header::new(stamp_ns, "world"),
            ..PoseWithCovarianceStamped::default()
        };
        message.pose.pose.orientation.w = 1.0;
        modify(&mut message);
        self.pose.publish(&message);
    }

    /// Publishes poses and packets until `done`.
    fn talk(&self, cell: &mut Cell, done: impl Fn(&mut Cell) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(30);
        let mut said = Instant::now();
        while !done(cell) {
            if said.elapsed() > Duration::from_millis(20) {
                said = Instant::now();
                self.say(|_| {});
            }
            // The tracker uses real time, so the packets do too.
            std::thread::sleep(Duration::from_millis(8));
            cell.packet(true);
            assert!(Instant::now() < deadline, "{}", cell.phase());
        }
    }
}

/// Sends packets at about their real rate until the path has stopped; `meanwhile` runs before each.
fn holds(cell: &mut Cell, meanwhile: impl Fn()) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while cell.phase() != "hold" {
        meanwhile();
        // The tracker measures silence by the host's clock, so the packets follow it too.
        std::thread::sleep(Duration::from_millis(5));
        cell.packet(true);
        assert!(Instant::now() < deadline, "{}", cell.phase());
    }
}

#[test]
fn a_standing_platform_permits_a_task_and_its_silence_ends_it() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        assert!(cell.said().base_age_s < 0.0);
        let platform = Platform::new(&cell);
        platform.say(|_| {});
        cell.packet(true);
        // The platform has only begun to publish: the path waits under force until its pose is
        // steady.
        assert_eq!(cell.phase(), "hold");
        assert!(cell.said().base_age_s >= 0.0);
        platform.talk(&mut cell, |cell| cell.phase() == "slide");
        let force_n = cell.said().force_n;
        assert!((force_n - 3.0).abs() < 0.3, "{force_n}");
        let before = cell.allocations;
        for _ in 0..5 {
            platform.say(|_| {});
            cell.packet(true);
        }
        assert_eq!(cell.allocations, before, "allocated in the loop");
        // Silence: hold after the timeout, retract after another second of the robot's time.
        holds(&mut cell, || ());
        cell.run_until("fault");
        let fault = cell.said().fault;
        assert!(fault.contains("base/pose is no longer received"), "{fault}");
        cell.end();
    });
}

#[test]
fn an_invalid_pose_is_refused_by_name() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        let platform = Platform::new(&cell);
        // Invalid poses before the first valid one have no effect.
        platform.say(|m| m.pose.pose.position.x = f64::NAN);
        cell.packet(true);
        assert_eq!(cell.phase(), "slide");
        platform.talk(&mut cell, |cell| {
            cell.said().base_age_s >= 0.0 && cell.phase() == "slide"
        });
        holds(&mut cell, || {
            platform.say(|m| m.pose.pose.orientation.w = 0.5);
        });
        cell.run_until("fault");
        let fault = cell.said().fault;
        assert!(fault.contains("quaternion"), "{fault}");
        cell.end();
    });
}

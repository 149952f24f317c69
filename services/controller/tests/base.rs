//! The controller on a mobile platform: it listens to `base/pose` in its cycle, and stops in good
//! order when it cannot be relied on.

#![allow(clippy::unwrap_used)]

mod common;

use std::time::{Duration, Instant};

use common::Cell;
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

    /// Standing; `spoil` changes what it says.
    fn say(&self, spoil: impl FnOnce(&mut PoseWithCovarianceStamped)) {
        let stamp_ns = 1_000_000_000 + self.began.elapsed().as_nanos() as i64;
        let mut message = PoseWithCovarianceStamped {
            header: Header::new(stamp_ns, "world"),
            ..PoseWithCovarianceStamped::default()
        };
        message.pose.pose.orientation.w = 1.0;
        spoil(&mut message);
        self.pose.publish(&message);
    }

    /// It talks, packets go on, until `done`.
    fn talk(&self, cell: &mut Cell, done: impl Fn(&mut Cell) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(30);
        let mut said = Instant::now();
        while !done(cell) {
            if said.elapsed() > Duration::from_millis(20) {
                said = Instant::now();
                self.say(|_| {});
            }
            // The tracker judges in life's time, so the packets keep it too.
            std::thread::sleep(Duration::from_millis(8));
            cell.packet(true);
            assert!(Instant::now() < deadline, "{}", cell.phase());
        }
    }
}

/// Packets go on, at about their own pace, until the path stands; `meanwhile` comes before each.
fn holds(cell: &mut Cell, meanwhile: impl Fn()) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while cell.phase() != "hold" {
        meanwhile();
        // The tracker judges silence by the host's clock, so the packets keep to it too.
        std::thread::sleep(Duration::from_millis(5));
        cell.packet(true);
        assert!(Instant::now() < deadline, "{}", cell.phase());
    }
}

#[test]
fn a_platform_that_stands_is_worked_from_and_its_silence_ends_the_task() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        assert!(cell.said().base_age_s < 0.0);
        let platform = Platform::new(&cell);
        platform.say(|_| {});
        cell.packet(true);
        // It has only begun: the path waits until it is steady, under force.
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
        // Silence: hold once the patience is over, retract after a second of the robot's time.
        holds(&mut cell, || ());
        cell.run_until("fault");
        let fault = cell.said().fault;
        assert!(fault.contains("base/pose fell silent"), "{fault}");
        cell.end();
    });
}

#[test]
fn nonsense_is_refused_by_name() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        let platform = Platform::new(&cell);
        // Before anything good was said, nonsense is nothing.
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

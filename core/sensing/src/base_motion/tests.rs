//! Tests with the poses that a platform can send: good ones, and every kind of bad ones.

use nalgebra::{Isometry3, UnitQuaternion};
use proptest::prelude::*;

use super::*;

const PERIOD_S: f64 = 0.02;
/// Offset of the platform's clock, s: hours.
const CLOCK_S: f64 = 12_345.0;

/// A platform that moves straight and turns.
struct Straight {
    start: Isometry3<f64>,
    velocity: Vector3<f64>,
    turn_rate: Vector3<f64>,
}

impl Straight {
    fn new(velocity: [f64; 3], turn_rate: [f64; 3]) -> Self {
        Self {
            start: Isometry3::new(Vector3::new(12.0, -4.0, 0.3), Vector3::new(0.0, 0.0, 0.7)),
            velocity: Vector3::from(velocity),
            turn_rate: Vector3::from(turn_rate),
        }
    }

    /// Pose in the map.
    fn pose(&self, time_s: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            (self.start.translation.vector + self.velocity * time_s).into(),
            UnitQuaternion::new(self.turn_rate * time_s) * self.start.rotation,
        )
    }

    fn message(&self, time_s: f64) -> BasePose {
        message(&self.pose(time_s), time_s)
    }

    fn feed(&self, tracker: &mut BaseTracker, from_s: f64, until_s: f64) {
        for t in times(from_s, until_s) {
            tracker.take(&self.message(t)).unwrap();
        }
    }
}

/// Times of the messages from one time to just before another, without accumulated rounding.
fn times(from_s: f64, until_s: f64) -> impl Iterator<Item = f64> {
    let index = |t: f64| (t / PERIOD_S).round() as u32;
    (index(from_s)..index(until_s)).map(|i| f64::from(i) * PERIOD_S)
}

fn message(pose: &Isometry3<f64>, time_s: f64) -> BasePose {
    BasePose {
        publisher: [7; 16],
        stamp_s: time_s + CLOCK_S,
        arrived_s: time_s,
        position: pose.translation.vector,
        quaternion: pose.rotation.coords.into(),
        covariance: Matrix6::identity() * 1e-6,
    }
}

fn tracker() -> BaseTracker {
    BaseTracker::new(&BaseConfig::default())
}

fn trouble(tracker: &BaseTracker, now_s: f64) -> Option<BaseTrouble> {
    tracker.at(now_s).unwrap().trouble
}

#[test]
fn never_heard_is_a_base_that_stands_unless_one_is_required() {
    assert!(tracker().at(5.0).is_none());
    let required = BaseTracker::new(&BaseConfig {
        required: true,
        ..BaseConfig::default()
    });
    assert_eq!(trouble(&required, 5.0), Some(BaseTrouble::Missing));
}

#[test]
fn pose_and_twist_are_those_of_the_platform_from_where_it_was_first_seen() {
    let platform = Straight::new([0.02, -0.01, 0.0], [0.0, 0.0, 0.05]);
    let mut tracker = tracker();
    platform.feed(&mut tracker, 0.0, 4.0);
    // A cycle between two messages.
    let now = 3.993;
    let base = tracker.at(now).unwrap();
    assert_eq!(base.trouble, None);
    let truth = platform.pose(0.0).inverse() * platform.pose(now);
    let seen = base.world_from_base.isometry();
    assert!((seen.translation.vector - truth.translation.vector).norm() < 1e-5);
    assert!(seen.rotation.angle_to(&truth.rotation) < 1e-5);
    let turned = platform.pose(now).rotation.inverse();
    assert!((base.twist.linear - turned * platform.velocity).norm() < 1e-5);
    assert!((base.twist.angular - turned * platform.turn_rate).norm() < 1e-5);
    assert!(base.age_s < PERIOD_S);
}

#[test]
fn a_stated_latency_is_made_up_for() {
    let platform = Straight::new([0.02, 0.0, 0.0], [0.0; 3]);
    let mut late = BaseTracker::new(&BaseConfig {
        latency_s: 0.05,
        ..BaseConfig::default()
    });
    for t in times(0.0, 4.0) {
        late.take(&platform.message(t)).unwrap();
    }
    let base = late.at(4.0).unwrap();
    let way = base.world_from_base.translation().norm();
    assert!((way - 0.02 * 4.05).abs() < 1e-4, "{way}");
}

#[test]
fn begins_unsettled_and_falls_silent() {
    let platform = Straight::new([0.02, 0.0, 0.0], [0.0; 3]);
    let mut tracker = tracker();
    platform.feed(&mut tracker, 0.0, 0.3);
    assert_eq!(trouble(&tracker, 0.3), Some(BaseTrouble::Unsettled));
    platform.feed(&mut tracker, 0.3, 2.0);
    assert_eq!(trouble(&tracker, 2.1), None);
    assert_eq!(trouble(&tracker, 2.25), Some(BaseTrouble::Silent));
    // A velocity that no pose confirms decays.
    let base = tracker.at(5.0).unwrap();
    assert!(base.twist.linear.norm() < 1e-5 && base.is_finite());
    // Poses resume: the map still holds, and the motion is estimated anew.
    platform.feed(&mut tracker, 5.0, 5.4);
    assert_eq!(trouble(&tracker, 5.4), Some(BaseTrouble::Unsettled));
    platform.feed(&mut tracker, 5.4, 8.0);
    let base = tracker.at(8.0).unwrap();
    assert_eq!(base.trouble, None);
    assert!((base.world_from_base.translation().norm() - 0.16).abs() < 1e-4);
}

/// The map jumps but the platform does not: objects on the floor keep their position in the base.
#[test]
fn a_relocalisation_moves_nothing() {
    let platform = Straight::new([0.02, 0.0, 0.0], [0.0, 0.0, 0.02]);
    let mut tracker = tracker();
    let origin = platform.pose(0.0);
    platform.feed(&mut tracker, 0.0, 3.0);
    let jump = Isometry3::new(Vector3::new(0.4, -0.2, 0.0), Vector3::new(0.0, 0.0, 0.1));
    let truth = |t: f64| {
        let straight = Straight::new([0.02, 0.0, 0.0], [0.0, 0.0, 0.02]);
        origin.inverse() * straight.pose(t)
    };
    for t in times(3.0, 5.0) {
        let before = tracker.at(t).unwrap();
        tracker
            .take(&message(&(jump * platform.pose(t)), t))
            .unwrap();
        let after = tracker.at(t).unwrap();
        let step =
            (after.world_from_base.translation() - before.world_from_base.translation()).norm();
        assert!(step < 1e-4, "{step} m at {t}");
        let settled = t > 3.0 + BaseConfig::default().settle_s - 1e-9;
        assert_eq!(
            after.trouble,
            (!settled).then_some(BaseTrouble::Unsettled),
            "at {t}"
        );
    }
    let seen = tracker.at(5.0).unwrap();
    let off = seen.world_from_base.isometry().translation.vector - truth(5.0).translation.vector;
    assert!(off.norm() < 1e-3, "{off}");
}

#[test]
fn a_step_that_is_no_jump_is_followed() {
    let platform = Straight::new([0.0; 3], [0.0; 3]);
    let mut tracker = tracker();
    platform.feed(&mut tracker, 0.0, 2.0);
    let small = Isometry3::translation(0.001, 0.0, 0.0);
    for t in times(2.0, 4.0) {
        tracker
            .take(&message(&(small * platform.pose(t)), t))
            .unwrap();
    }
    let base = tracker.at(4.0).unwrap();
    assert_eq!(base.trouble, None);
    assert!((base.world_from_base.translation().norm() - 0.001).abs() < 1e-6);
}

#[test]
fn bad_poses_are_refused_by_name_and_count_as_silence() {
    let platform = Straight::new([0.02, 0.0, 0.0], [0.0; 3]);
    type Spoil = fn(&mut BasePose);
    let cases: [(Spoil, BaseTrouble); 9] = [
        (|m| m.position.x = f64::NAN, BaseTrouble::NotFinite),
        (|m| m.position.y = 1e12, BaseTrouble::NotFinite),
        (|m| m.quaternion[2] = f64::INFINITY, BaseTrouble::NotFinite),
        (|m| m.covariance[(0, 1)] = f64::NAN, BaseTrouble::NotFinite),
        (|m| m.quaternion = [0.0; 4], BaseTrouble::NotUnit),
        (
            |m| m.quaternion = [0.0, 0.0, 0.0, 1.01],
            BaseTrouble::NotUnit,
        ),
        (|m| m.stamp_s = CLOCK_S + 1.0, BaseTrouble::OutOfOrder),
        (|m| m.covariance[(1, 1)] = 1.0, BaseTrouble::Uncertain),
        (|m| m.covariance[(5, 5)] = -1.0, BaseTrouble::Uncertain),
    ];
    for (spoil, expected) in cases {
        let mut tracker = tracker();
        platform.feed(&mut tracker, 0.0, 2.0);
        for t in times(2.0, 2.3) {
            let before = tracker.at(t).unwrap();
            let mut bad = platform.message(t);
            spoil(&mut bad);
            assert_eq!(tracker.take(&bad), Err(expected));
            let after = tracker.at(t).unwrap();
            assert_eq!(before.twist, after.twist, "{expected:?} leaves a trace");
        }
        assert_eq!(trouble(&tracker, 2.3), Some(expected));
        assert_eq!(tracker.refusals(), 15);
        platform.feed(&mut tracker, 2.3, 2.5);
        assert_eq!(trouble(&tracker, 2.5), None, "{expected:?} is over");
    }
}

#[test]
fn a_repeated_pose_is_refused() {
    let platform = Straight::new([0.0; 3], [0.0; 3]);
    let mut tracker = tracker();
    platform.feed(&mut tracker, 0.0, 1.0);
    let again = platform.message(0.98);
    let mut again = again;
    again.arrived_s = 1.0;
    assert_eq!(tracker.take(&again), Err(BaseTrouble::OutOfOrder));
}

#[test]
fn a_burst_after_a_cut_is_late_but_for_its_end() {
    let platform = Straight::new([0.02, 0.0, 0.0], [0.0; 3]);
    let mut tracker = tracker();
    platform.feed(&mut tracker, 0.0, 2.0);
    let mut results = Vec::new();
    for i in 0..100 {
        let mut pose = platform.message(2.0 + PERIOD_S * f64::from(i));
        pose.arrived_s = 4.0;
        results.push(tracker.take(&pose));
    }
    assert_eq!(results[0], Err(BaseTrouble::Late));
    assert_eq!(results[80], Err(BaseTrouble::Late));
    assert_eq!(results[99], Ok(()));
    assert_eq!(tracker.refusals(), 90);
}

#[test]
fn a_clock_that_was_set_and_another_publisher_begin_anew_without_a_step() {
    for (offset_s, publisher) in [(3600.0, 7), (-3600.0, 7), (0.0, 8)] {
        let platform = Straight::new([0.02, 0.0, 0.0], [0.0; 3]);
        let mut tracker = tracker();
        platform.feed(&mut tracker, 0.0, 2.0);
        let mut last = tracker.at(2.0).unwrap().world_from_base.translation();
        for t in times(2.0, 6.0) {
            let mut pose = platform.message(t);
            pose.stamp_s += offset_s;
            pose.publisher = [publisher; 16];
            let _ = tracker.take(&pose);
            let base = tracker.at(t).unwrap();
            let step = (base.world_from_base.translation() - last).norm();
            assert!(step < 1e-3, "{offset_s}: {step} m at {t}");
            last = base.world_from_base.translation();
        }
        assert_eq!(trouble(&tracker, 6.0), None);
        let twist = tracker.at(6.0).unwrap().twist;
        assert!((twist.linear.norm() - 0.02).abs() < 1e-4, "{offset_s}");
    }
}

#[test]
fn two_publishers_never_settle() {
    let platform = Straight::new([0.0; 3], [0.0; 3]);
    let mut tracker = tracker();
    for t in times(0.0, 4.0) {
        let mut other = platform.message(t);
        other.publisher = [9; 16];
        other.position.x += 1.0;
        tracker.take(&platform.message(t)).unwrap();
        let _ = tracker.take(&other);
    }
    assert_eq!(trouble(&tracker, 4.0), Some(BaseTrouble::Unsettled));
    assert!(
        tracker
            .at(4.0)
            .unwrap()
            .world_from_base
            .translation()
            .norm()
            < 1e-6
    );
}

#[test]
fn too_fast_to_work_from_is_said() {
    for (velocity, turn_rate) in [([0.1, 0.0, 0.0], [0.0; 3]), ([0.0; 3], [0.0, 0.0, 0.2])] {
        let platform = Straight::new(velocity, turn_rate);
        let mut tracker = tracker();
        platform.feed(&mut tracker, 0.0, 3.0);
        assert_eq!(trouble(&tracker, 3.0), Some(BaseTrouble::TooFast));
    }
}

#[test]
fn ranges_are_checked_by_name() {
    BaseConfig::default().check().unwrap();
    let wrong = BaseConfig {
        patience_s: f64::NAN,
        ..BaseConfig::default()
    };
    let error = wrong.check().unwrap_err().to_string();
    assert!(error.contains("base.patience_s"), "{error}");
}

proptest! {
    /// For any input, the output is finite.
    #[test]
    fn any_row_of_poses_gives_finite_motion(rows in prop::collection::vec(
        (prop::array::uniform3(prop_oneof![-1e3f64..1e3, Just(f64::NAN), Just(1e300)]), prop::array::uniform4(-1.0f64..1.0),
         -0.1f64..3.0, any::<bool>(), 0u8..3), 1..60)) {
        let mut tracker = tracker();
        let mut t = 0.0;
        for (position, quaternion, step, unit, publisher) in rows {
            t += step;
            let q = nalgebra::Vector4::from(quaternion);
            let q = if unit && q.norm() > 1e-3 { q.normalize() } else { q };
            let _ = tracker.take(&BasePose {
                publisher: [publisher; 16],
                stamp_s: t,
                arrived_s: t.max(0.0),
                position: Vector3::from(position),
                quaternion: q.into(),
                covariance: Matrix6::zeros(),
            });
            if let Some(base) = tracker.at(t + 0.01) {
                prop_assert!(base.is_finite());
            }
        }
    }
}

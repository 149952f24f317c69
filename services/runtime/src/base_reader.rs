//! Subscription of a service to `base/pose`: the motion of the arm's base, if it moves.
//!
//! The controller calls it in its cycle, and so does the estimator service. Each reader detects
//! silence, jumps and invalid poses itself, by its own clock. It takes no lock and allocates
//! nothing.

use std::time::Instant;

use nalgebra::Matrix6;
use tangent_schemas::standard::PoseWithCovarianceStamped;
use tangent_schemas::topics;
use tangent_sensing::{BaseConfig, BaseMotion, BasePose, BaseTracker};

use crate::bus::{Bus, BusError, Latest, Received};

/// Follows the pose of a moving base.
pub struct BaseReader {
    newest: Latest<PoseWithCovarianceStamped>,
    tracker: BaseTracker,
    started: Instant,
}

impl BaseReader {
    /// Subscribes to `base/pose`. The configuration must have passed its check.
    ///
    /// # Errors
    /// The bus refused the topic.
    pub fn new(bus: &Bus, config: &BaseConfig) -> Result<Self, BusError> {
        Ok(Self {
            newest: bus.latest(&topics::BASE_POSE)?,
            tracker: BaseTracker::new(config),
            started: Instant::now(),
        })
    }

    /// Motion of the base at `now`; `None` if no pose was ever received and none is required.
    pub fn at(&mut self, now: Instant) -> Option<BaseMotion> {
        if let Some(new) = self.newest.take_new() {
            // The tracker counts a refused pose, and treats it as silence with a reason.
            let _ = self.tracker.take(&base_pose(new, self.started));
        }
        self.tracker.at(since(self.started, now))
    }

    /// While held, no other publisher replaces the present one.
    pub fn hold(&self, held: bool) {
        self.newest.hold(held);
    }

    /// Number of poses refused so far.
    pub fn refusals(&self) -> u64 {
        self.tracker.refusals()
    }
}

fn since(started: Instant, at: Instant) -> f64 {
    at.saturating_duration_since(started).as_secs_f64()
}

fn base_pose(received: &Received<PoseWithCovarianceStamped>, started: Instant) -> BasePose {
    let pose = &received.message.pose;
    let (p, o) = (&pose.pose.position, &pose.pose.orientation);
    BasePose {
        publisher: received.publisher,
        stamp_s: received.message.header.stamp.to_ns() as f64 * 1e-9,
        arrived_s: since(started, received.received),
        position: p.into(),
        quaternion: [o.x, o.y, o.z, o.w],
        covariance: Matrix6::from_row_slice(&pose.covariance.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tangent_schemas::standard::Header;
    use tangent_sensing::BaseTrouble;

    #[test]
    fn a_platform_on_the_bus_is_followed_and_missed() {
        let bus = Bus::in_process("test");
        let mut reader = BaseReader::new(&bus, &BaseConfig::default()).unwrap();
        assert!(reader.at(Instant::now()).is_none());
        let publisher = bus.publisher(&topics::BASE_POSE).unwrap();
        let mut message = PoseWithCovarianceStamped {
            header: Header::new(1_700_000_000_000_000_000, "world"),
            ..PoseWithCovarianceStamped::default()
        };
        // First an invalid pose: its quaternion is all zeros.
        publisher.publish(&message);
        assert!(reader.at(Instant::now()).is_none());
        assert_eq!(reader.refusals(), 1);
        message.pose.pose.orientation.w = 1.0;
        message.pose.covariance.0[0] = 1e-6;
        publisher.publish(&message);
        let heard = Instant::now();
        let base = reader.at(heard).unwrap();
        assert_eq!(base.trouble, Some(BaseTrouble::Unsettled));
        let later = reader.at(heard + Duration::from_secs(1)).unwrap();
        assert_eq!(later.trouble, Some(BaseTrouble::Silent));
        message.header = Header::new(1_700_000_000_020_000_000, "world");
        message.pose.covariance.0[35] = 9.0;
        publisher.publish(&message);
        let wide = reader.at(heard + Duration::from_secs(1)).unwrap();
        assert_eq!(wide.trouble, Some(BaseTrouble::Uncertain));
    }
}

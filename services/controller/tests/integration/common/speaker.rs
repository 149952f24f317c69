//! A simulated estimator of the plane, with selectable faults.

use nalgebra::Vector3;
use tangent_runtime::{Bus, Publisher, RawPublisher};
use tangent_schemas::Message;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{Answer, NormalEstimate};
use tangent_schemas::topics;

/// Behaviour of the estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mood {
    /// Publishes correct estimates.
    Well,
    /// Publishes nothing, as after `kill -9` or a network outage.
    Dead,
    /// Repeats its last message.
    Frozen,
    /// Counts the cycles, with a constant stamp.
    Stuck,
    /// Publishes a normal of NaN.
    NotANumber,
    /// Publishes bytes that are no valid message.
    Garbage,
    /// Another message type.
    WrongType,
    /// Publishes a normal tilted by this angle, degrees.
    Leaning(f64),
    /// Publishes an estimate that is marked as invalid.
    Invalid,
}

/// A simulated estimator.
pub struct Speaker {
    /// As in `estimate/NAME/normal`.
    pub name: String,
    /// Present behaviour.
    pub mood: Mood,
    publisher: Publisher<NormalEstimate>,
    garbage: RawPublisher,
    wrong_type: RawPublisher,
    last: NormalEstimate,
}

impl Speaker {
    /// Publishes on the topic of `name`.
    pub fn new(bus: &Bus, name: &str) -> Self {
        let topic = topics::estimate_normal(name);
        Self {
            name: name.to_owned(),
            mood: Mood::Well,
            publisher: bus.publisher(&topic).unwrap(),
            garbage: bus
                .raw_publisher(topic.key(), NormalEstimate::NAME)
                .unwrap(),
            wrong_type: bus.raw_publisher(topic.key(), Answer::NAME).unwrap(),
            last: NormalEstimate::default(),
        }
    }

    /// Publishes one message about the robot's `cycle`, according to the mood.
    pub fn speak(&mut self, cycle: u64, stamp_ns: i64) {
        let mut message = NormalEstimate {
            header: Header::new(stamp_ns, "base"),
            cycle,
            estimator: cut(&self.name),
            normal: (&Vector3::z()).into(),
            friction: -1.0,
            ..NormalEstimate::default()
        };
        match self.mood {
            Mood::Well => self.last = message.clone(),
            Mood::Dead => return,
            Mood::Frozen => message = self.last.clone(),
            Mood::Stuck => message.header = self.last.header.clone(),
            Mood::NotANumber => message.normal.x = f64::NAN,
            Mood::Garbage => return self.garbage.publish(&[0, 1, 0, 0, 7, 7, 7]),
            Mood::WrongType => return self.wrong_type.publish(&[0, 1, 0, 0, 1]),
            Mood::Leaning(degrees) => {
                let angle = degrees.to_radians();
                message.normal = (&Vector3::new(angle.sin(), 0.0, angle.cos())).into();
            }
            Mood::Invalid => message.validity = 8,
        }
        self.publisher.publish(&message);
    }
}

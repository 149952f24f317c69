//! An estimator of the plane, in whatever mood it is.

use nalgebra::Vector3;
use tangent_runtime::{Bus, Publisher, RawPublisher};
use tangent_schemas::Message;
use tangent_schemas::convert::cut;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{Answer, NormalEstimate};
use tangent_schemas::topics;

/// How it fares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mood {
    /// Says what it should.
    Well,
    /// Says nothing any more, as after `kill -9` or a cut.
    Dead,
    /// Says its last message over and over.
    Frozen,
    /// Counts the cycles, with a stamp that stands still.
    Stuck,
    /// A normal that is no number.
    NotANumber,
    /// Bytes that are no message.
    Garbage,
    /// Another message type.
    WrongType,
    /// A normal that leans so far, degrees.
    Leaning(f64),
    /// Says itself that it has no normal.
    Invalid,
}

/// One estimator.
pub struct Speaker {
    /// As in `estimate/NAME/normal`.
    pub name: String,
    /// Now.
    pub mood: Mood,
    publisher: Publisher<NormalEstimate>,
    garbage: RawPublisher,
    wrong_type: RawPublisher,
    last: NormalEstimate,
}

impl Speaker {
    /// Speaks on the topic of `name`.
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

    /// One message about the robot's `cycle`, or what the mood makes of it.
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

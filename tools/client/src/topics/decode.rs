//! A message of any known type as JSON.

use serde_json::{Value, json};
use tangent_runtime::bus::RawMessage;
use tangent_schemas::{Message, cdr, standard, tangent};

/// Contents of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Decoded {
    /// All fields, by name. A number that JSON cannot represent, such as NaN, is null.
    Fields(Value),
    /// The type is not one of this program, or the bytes are not of the stated type.
    Unreadable(String),
}

/// Decodes a message by the type that its publisher states.
pub fn decode(message: &RawMessage) -> Decoded {
    let (name, bytes) = (message.type_name.as_ref(), &message.payload[..]);
    match fields(name, bytes) {
        Some(Ok(value)) => Decoded::Fields(value),
        Some(Err(error)) => Decoded::Unreadable(format!(
            "{} bytes that are not {name}: {error}",
            bytes.len()
        )),
        None if name.is_empty() => {
            Decoded::Unreadable(format!("{} bytes without a type", bytes.len()))
        }
        None => Decoded::Unreadable(format!(
            "{} bytes of type {name}, which this program does not know",
            bytes.len()
        )),
    }
}

/// Shortens every list with more than `length_max` elements, to its first ones and a note of its
/// length: an image has a million.
pub fn shortened(value: Value, length_max: usize) -> Value {
    match value {
        Value::Array(list) if list.len() > length_max => {
            let length = list.len();
            let kept = list.into_iter().take(length_max);
            let mut kept: Vec<Value> = kept.map(|one| shortened(one, length_max)).collect();
            kept.push(json!(format!("... of {length}")));
            Value::Array(kept)
        }
        Value::Array(list) => list
            .into_iter()
            .map(|one| shortened(one, length_max))
            .collect(),
        Value::Object(fields) => fields
            .into_iter()
            .map(|(name, one)| (name, shortened(one, length_max)))
            .collect(),
        other => other,
    }
}

impl Decoded {
    /// With long lists cut to `length_max` elements.
    pub fn shortened(self, length_max: usize) -> Self {
        match self {
            Self::Fields(value) => Self::Fields(shortened(value, length_max)),
            other => other,
        }
    }
}

macro_rules! by_name {
    ($name:expr, $bytes:expr, $($message:ty),* $(,)?) => {
        match $name {
            $(<$message as Message>::NAME => Some(value_of::<$message>($bytes)),)*
            _ => None,
        }
    };
}

fn value_of<M: Message>(bytes: &[u8]) -> Result<Value, String> {
    let message = cdr::decode::<M>(bytes).map_err(|error| error.to_string())?;
    serde_json::to_value(message).map_err(|error| error.to_string())
}

/// `None` for a type that is not in the list.
fn fields(name: &str, bytes: &[u8]) -> Option<Result<Value, String>> {
    by_name!(
        name,
        bytes,
        standard::PoseStamped,
        standard::PoseWithCovarianceStamped,
        standard::WrenchStamped,
        standard::TransformStamped,
        standard::TFMessage,
        standard::MarkerArray,
        standard::CompressedImage,
        standard::Image,
        standard::CameraInfo,
        standard::JointState,
        standard::StdString,
        tangent::ArmState,
        tangent::ArmCommand,
        tangent::WrenchStatus,
        tangent::NormalEstimate,
        tangent::WrenchBatch,
        tangent::FeatureArray,
        tangent::ObjectEstimate,
        tangent::OperatorCommand,
        tangent::SurfaceSegment,
        tangent::SurfaceAhead,
        tangent::ControlState,
        tangent::CoverageState,
        tangent::ShapingState,
        tangent::Health,
        tangent::ContactTruth,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};
    use tangent_runtime::Bus;
    use tangent_schemas::topics;

    fn published(health: &tangent::Health) -> RawMessage {
        let bus = Bus::in_process("test");
        let raw = bus.subscribe_raw("**", 8).unwrap();
        bus.publisher(&topics::health("rtde"))
            .unwrap()
            .publish(health);
        raw.recv_timeout(Duration::from_secs(20)).unwrap()
    }

    #[test]
    fn a_message_is_shown_by_its_fields() {
        let health = tangent::Health {
            fault: "no packet".to_owned(),
            figures: vec![f64::NAN, 2.0],
            ..tangent::Health::default()
        };
        let Decoded::Fields(value) = decode(&published(&health)) else {
            panic!("not decoded");
        };
        assert_eq!(value["fault"], "no packet");
        assert_eq!(value["figures"], json!([null, 2.0]));
    }

    #[test]
    fn what_cannot_be_read_says_why() {
        let at = Instant::now();
        let message = |type_name: &'static str, payload: &[u8]| RawMessage {
            key: "x".into(),
            type_name: type_name.into(),
            payload: payload.into(),
            sequence: 1,
            source_time_ns: 0,
            publisher: [0; 16],
            received: at,
            received_ns: 0,
        };
        for (type_name, word) in [
            ("my_msgs/msg/Mine", "does not know"),
            ("tangent_msgs/msg/Health", "not tangent_msgs/msg/Health"),
            ("", "without a type"),
        ] {
            let Decoded::Unreadable(why) = decode(&message(type_name, &[1, 2, 3])) else {
                panic!("{type_name} was decoded");
            };
            assert!(why.contains(word) && why.contains("3 bytes"), "{why}");
        }
    }

    #[test]
    fn long_lists_are_cut_and_their_length_is_told() {
        let long = json!({"data": [1, 2, 3, 4], "size": [640, 480]});
        assert_eq!(
            shortened(long, 2),
            json!({"data": [1, 2, "... of 4"], "size": [640, 480]})
        );
    }
}

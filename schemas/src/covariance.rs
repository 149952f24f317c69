//! The 6 × 6 covariance of ROS 2's pose messages, `float64[36]`: serde does not support arrays of
//! this length.

use std::fmt;

use serde::de::{self, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

const LENGTH: usize = 36;

/// Row-major; x, y, z (m), then small rotations about the fixed axes x, y, z (rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance(pub [f64; LENGTH]);

impl Default for Covariance {
    /// All zero: unknown.
    fn default() -> Self {
        Self([0.0; LENGTH])
    }
}

impl Serialize for Covariance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(LENGTH)?;
        for value in &self.0 {
            tuple.serialize_element(value)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for Covariance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values;
        impl<'de> Visitor<'de> for Values {
            type Value = Covariance;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{LENGTH} numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Covariance, A::Error> {
                let mut values = [0.0; LENGTH];
                for (i, value) in values.iter_mut().enumerate() {
                    *value = seq
                        .next_element()?
                        .ok_or_else(|| de::Error::invalid_length(i, &self))?;
                }
                Ok(Covariance(values))
            }
        }
        deserializer.deserialize_tuple(LENGTH, Values)
    }
}

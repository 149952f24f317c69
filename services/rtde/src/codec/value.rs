//! Typed values of RTDE fields.

use std::fmt;

/// Type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DataType {
    /// 1 byte, 0 is false.
    Bool,
    /// 1 byte.
    Uint8,
    /// 4 bytes.
    Uint32,
    /// 8 bytes.
    Uint64,
    /// 4 bytes.
    Int32,
    /// 8 bytes, IEEE 754.
    Double,
    /// 3 doubles.
    Vector3d,
    /// 6 doubles.
    Vector6d,
    /// 6 signed integers.
    Vector6Int32,
    /// 6 unsigned integers.
    Vector6Uint32,
}

impl DataType {
    /// All types.
    pub const ALL: [Self; 10] = [
        Self::Bool,
        Self::Uint8,
        Self::Uint32,
        Self::Uint64,
        Self::Int32,
        Self::Double,
        Self::Vector3d,
        Self::Vector6d,
        Self::Vector6Int32,
        Self::Vector6Uint32,
    ];

    /// Its name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "BOOL",
            Self::Uint8 => "UINT8",
            Self::Uint32 => "UINT32",
            Self::Uint64 => "UINT64",
            Self::Int32 => "INT32",
            Self::Double => "DOUBLE",
            Self::Vector3d => "VECTOR3D",
            Self::Vector6d => "VECTOR6D",
            Self::Vector6Int32 => "VECTOR6INT32",
            Self::Vector6Uint32 => "VECTOR6UINT32",
        }
    }

    /// By its name on the wire.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|t| t.name() == name)
    }

    /// Bytes on the wire.
    pub fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::Uint8 => 1,
            Self::Uint32 | Self::Int32 => 4,
            Self::Uint64 | Self::Double => 8,
            Self::Vector3d | Self::Vector6Int32 | Self::Vector6Uint32 => 24,
            Self::Vector6d => 48,
        }
    }

    /// Value of a field of this type before it is first written.
    pub fn zero(self) -> Value {
        match self {
            Self::Bool => Value::Bool(false),
            Self::Uint8 => Value::Uint8(0),
            Self::Uint32 => Value::Uint32(0),
            Self::Uint64 => Value::Uint64(0),
            Self::Int32 => Value::Int32(0),
            Self::Double => Value::Double(0.0),
            Self::Vector3d => Value::Vector3d([0.0; 3]),
            Self::Vector6d => Value::Vector6d([0.0; 6]),
            Self::Vector6Int32 => Value::Vector6Int32([0; 6]),
            Self::Vector6Uint32 => Value::Vector6Uint32([0; 6]),
        }
    }

    /// Reads one value from the front of `bytes` and returns it with the rest; `None` if there are
    /// too few bytes.
    pub fn decode(self, bytes: &[u8]) -> Option<(Value, &[u8])> {
        let (head, rest) = bytes.split_at_checked(self.bytes())?;
        let value = match self {
            Self::Bool => Value::Bool(head[0] != 0),
            Self::Uint8 => Value::Uint8(head[0]),
            Self::Uint32 => Value::Uint32(word(head, 0)),
            Self::Uint64 => Value::Uint64(double_word(head, 0)),
            Self::Int32 => Value::Int32(word(head, 0) as i32),
            Self::Double => Value::Double(f64::from_bits(double_word(head, 0))),
            Self::Vector3d => Value::Vector3d(std::array::from_fn(|i| {
                f64::from_bits(double_word(head, i))
            })),
            Self::Vector6d => Value::Vector6d(std::array::from_fn(|i| {
                f64::from_bits(double_word(head, i))
            })),
            Self::Vector6Int32 => {
                Value::Vector6Int32(std::array::from_fn(|i| word(head, i) as i32))
            }
            Self::Vector6Uint32 => Value::Vector6Uint32(std::array::from_fn(|i| word(head, i))),
        };
        Some((value, rest))
    }
}

impl fmt::Display for DataType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The `index`-th big-endian `u32` of `bytes`; the caller has checked the length.
fn word(bytes: &[u8], index: usize) -> u32 {
    let b = &bytes[4 * index..4 * index + 4];
    u32::from_be_bytes([b[0], b[1], b[2], b[3]])
}

/// The `index`-th big-endian `u64` of `bytes`; the caller has checked the length.
fn double_word(bytes: &[u8], index: usize) -> u64 {
    (u64::from(word(bytes, 2 * index)) << 32) | u64::from(word(bytes, 2 * index + 1))
}

/// A field's value with its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A truth value, [`DataType::Bool`].
    Bool(bool),
    /// A 8-bit unsigned number, [`DataType::Uint8`].
    Uint8(u8),
    /// A 32-bit unsigned number, [`DataType::Uint32`].
    Uint32(u32),
    /// A 64-bit unsigned number, [`DataType::Uint64`].
    Uint64(u64),
    /// A 32-bit signed number, [`DataType::Int32`].
    Int32(i32),
    /// A 64-bit floating-point number, [`DataType::Double`].
    Double(f64),
    /// A vector of 3 doubles, [`DataType::Vector3d`].
    Vector3d([f64; 3]),
    /// A vector of 6 doubles, [`DataType::Vector6d`].
    Vector6d([f64; 6]),
    /// A vector of 6 32-bit signed numbers, [`DataType::Vector6Int32`].
    Vector6Int32([i32; 6]),
    /// A vector of 6 32-bit unsigned numbers, [`DataType::Vector6Uint32`].
    Vector6Uint32([u32; 6]),
}

impl Value {
    /// Its type.
    pub fn data_type(&self) -> DataType {
        match self {
            Self::Bool(_) => DataType::Bool,
            Self::Uint8(_) => DataType::Uint8,
            Self::Uint32(_) => DataType::Uint32,
            Self::Uint64(_) => DataType::Uint64,
            Self::Int32(_) => DataType::Int32,
            Self::Double(_) => DataType::Double,
            Self::Vector3d(_) => DataType::Vector3d,
            Self::Vector6d(_) => DataType::Vector6d,
            Self::Vector6Int32(_) => DataType::Vector6Int32,
            Self::Vector6Uint32(_) => DataType::Vector6Uint32,
        }
    }

    /// Appends its bytes. Allocates only when `out` has no room left.
    pub fn encode(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bool(x) => out.push(u8::from(*x)),
            Self::Uint8(x) => out.push(*x),
            Self::Uint32(x) => out.extend_from_slice(&x.to_be_bytes()),
            Self::Uint64(x) => out.extend_from_slice(&x.to_be_bytes()),
            Self::Int32(x) => out.extend_from_slice(&x.to_be_bytes()),
            Self::Double(x) => out.extend_from_slice(&x.to_be_bytes()),
            Self::Vector3d(xs) => xs
                .iter()
                .for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6d(xs) => xs
                .iter()
                .for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6Int32(xs) => xs
                .iter()
                .for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
            Self::Vector6Uint32(xs) => xs
                .iter()
                .for_each(|x| out.extend_from_slice(&x.to_be_bytes())),
        }
    }

    /// The double, if it is one.
    pub fn as_double(&self) -> Option<f64> {
        match self {
            Self::Double(x) => Some(*x),
            _ => None,
        }
    }

    /// The signed integer, if it is one.
    pub fn as_int32(&self) -> Option<i32> {
        match self {
            Self::Int32(x) => Some(*x),
            _ => None,
        }
    }

    /// The unsigned integer, if it is one of 32 bits.
    pub fn as_uint32(&self) -> Option<u32> {
        match self {
            Self::Uint32(x) => Some(*x),
            _ => None,
        }
    }

    /// The six doubles, if it holds six.
    pub fn as_vector6d(&self) -> Option<[f64; 6]> {
        match self {
            Self::Vector6d(x) => Some(*x),
            _ => None,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any value of a given type, including infinities and NaN.
    pub(crate) fn value_of(data_type: DataType) -> BoxedStrategy<Value> {
        use proptest::array::{uniform3, uniform6};
        let double = any::<u64>().prop_map(f64::from_bits);
        match data_type {
            DataType::Bool => any::<bool>().prop_map(Value::Bool).boxed(),
            DataType::Uint8 => any::<u8>().prop_map(Value::Uint8).boxed(),
            DataType::Uint32 => any::<u32>().prop_map(Value::Uint32).boxed(),
            DataType::Uint64 => any::<u64>().prop_map(Value::Uint64).boxed(),
            DataType::Int32 => any::<i32>().prop_map(Value::Int32).boxed(),
            DataType::Double => double.prop_map(Value::Double).boxed(),
            DataType::Vector3d => uniform3(double).prop_map(Value::Vector3d).boxed(),
            DataType::Vector6d => uniform6(double).prop_map(Value::Vector6d).boxed(),
            DataType::Vector6Int32 => uniform6(any::<i32>()).prop_map(Value::Vector6Int32).boxed(),
            DataType::Vector6Uint32 => uniform6(any::<u32>())
                .prop_map(Value::Vector6Uint32)
                .boxed(),
        }
    }

    /// Any value of any type.
    pub(crate) fn value() -> impl Strategy<Value = Value> {
        proptest::sample::select(DataType::ALL.to_vec()).prop_flat_map(value_of)
    }

    proptest! {
        #[test]
        fn there_and_back(value in value()) {
            let mut bytes = Vec::new();
            value.encode(&mut bytes);
            prop_assert_eq!(bytes.len(), value.data_type().bytes());
            let (back, rest) = value.data_type().decode(&bytes).unwrap();
            prop_assert!(rest.is_empty());
            // By bytes, since NaN is not equal to itself.
            let mut again = Vec::new();
            back.encode(&mut again);
            prop_assert_eq!(bytes, again);
        }

        #[test]
        fn too_few_bytes_are_refused(value in value()) {
            let mut bytes = Vec::new();
            value.encode(&mut bytes);
            prop_assert!(value.data_type().decode(&bytes[1..]).is_none());
        }
    }

    #[test]
    fn a_known_double() {
        let (value, _) = DataType::Double
            .decode(&[0x3f, 0xf8, 0, 0, 0, 0, 0, 0])
            .unwrap();
        assert_eq!(value, Value::Double(1.5));
        let (value, rest) = DataType::Int32
            .decode(&[0xff, 0xff, 0xff, 0xfe, 7])
            .unwrap();
        assert_eq!((value, rest), (Value::Int32(-2), &[7u8][..]));
    }

    #[test]
    fn names_are_their_own_inverse() {
        for t in DataType::ALL {
            assert_eq!(DataType::from_name(t.name()), Some(t));
            assert_eq!(t.zero().data_type(), t);
        }
        assert_eq!(DataType::from_name("NOT_FOUND"), None);
    }
}

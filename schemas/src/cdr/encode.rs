//! Encodes values as CDR bytes. The publishing thread calls it once per message that has a
//! subscriber outside the process.

use serde::ser::{self, Serialize};

use super::{CdrError, CdrFault, HEADER};

/// Replaces the contents of `bytes` by the CDR form of `value`. Allocates only if `bytes` is too
/// small.
///
/// # Errors
/// A sequence or string has more than 2³²-1 elements, or messages do not support the serde type.
pub fn encode<T: Serialize + ?Sized>(value: &T, bytes: &mut Vec<u8>) -> Result<(), CdrError> {
    bytes.clear();
    bytes.extend_from_slice(&HEADER);
    value.serialize(&mut Encoder { bytes })
}

struct Encoder<'a> {
    bytes: &'a mut Vec<u8>,
}

impl Encoder<'_> {
    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let behind_header = self.bytes.len() - HEADER.len();
        let aligned = behind_header.next_multiple_of(N);
        self.bytes.resize(aligned + HEADER.len(), 0);
        self.bytes.extend_from_slice(&value);
    }

    fn put_length(&mut self, length: usize) -> Result<(), CdrError> {
        let length = u32::try_from(length).map_err(|_| {
            CdrError::new(
                self.bytes.len(),
                CdrFault::Value(format!("{length} elements are more than CDR can count")),
            )
        })?;
        self.put(length.to_le_bytes());
        Ok(())
    }

    fn unsupported<T>(&self, what: &'static str) -> Result<T, CdrError> {
        Err(CdrError::new(self.bytes.len(), CdrFault::Unsupported(what)))
    }
}

macro_rules! numbers {
    ($($name:ident: $type:ty),*) => {$(
        fn $name(self, value: $type) -> Result<(), CdrError> {
            self.put(value.to_le_bytes());
            Ok(())
        }
    )*};
}

impl<'a, 'b> ser::Serializer for &'a mut Encoder<'b> {
    type Ok = ();
    type Error = CdrError;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = ser::Impossible<(), CdrError>;
    type SerializeMap = ser::Impossible<(), CdrError>;
    type SerializeStruct = Self;
    type SerializeStructVariant = ser::Impossible<(), CdrError>;

    numbers!(serialize_i8: i8, serialize_i16: i16, serialize_i32: i32, serialize_i64: i64,
             serialize_u8: u8, serialize_u16: u16, serialize_u32: u32, serialize_u64: u64,
             serialize_f32: f32, serialize_f64: f64);

    fn is_human_readable(&self) -> bool {
        false
    }

    fn serialize_bool(self, value: bool) -> Result<(), CdrError> {
        self.put([u8::from(value)]);
        Ok(())
    }

    fn serialize_str(self, value: &str) -> Result<(), CdrError> {
        self.put_length(value.len() + 1)?;
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
        Ok(())
    }

    fn serialize_bytes(self, value: &[u8]) -> Result<(), CdrError> {
        self.put_length(value.len())?;
        self.bytes.extend_from_slice(value);
        Ok(())
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, CdrError> {
        match length {
            Some(length) => {
                self.put_length(length)?;
                Ok(self)
            }
            None => self.unsupported("a sequence of unknown length"),
        }
    }

    fn serialize_tuple(self, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), CdrError> {
        value.serialize(self)
    }

    fn serialize_char(self, _: char) -> Result<(), CdrError> {
        self.unsupported("a char")
    }

    fn serialize_none(self) -> Result<(), CdrError> {
        self.unsupported("an option")
    }

    fn serialize_some<T: Serialize + ?Sized>(self, _: &T) -> Result<(), CdrError> {
        self.unsupported("an option")
    }

    fn serialize_unit(self) -> Result<(), CdrError> {
        self.unsupported("a unit")
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result<(), CdrError> {
        self.unsupported("a unit")
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
    ) -> Result<(), CdrError> {
        self.unsupported("an enum")
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: &T,
    ) -> Result<(), CdrError> {
        self.unsupported("an enum")
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self::SerializeTupleVariant, CdrError> {
        self.unsupported("an enum")
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self::SerializeMap, CdrError> {
        self.unsupported("a map")
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self::SerializeStructVariant, CdrError> {
        self.unsupported("an enum")
    }
}

impl ser::SerializeSeq for &mut Encoder<'_> {
    type Ok = ();
    type Error = CdrError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeTuple for &mut Encoder<'_> {
    type Ok = ();
    type Error = CdrError;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeTupleStruct for &mut Encoder<'_> {
    type Ok = ();
    type Error = CdrError;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

impl ser::SerializeStruct for &mut Encoder<'_> {
    type Ok = ();
    type Error = CdrError;

    fn serialize_field<T: Serialize + ?Sized>(
        &mut self,
        _: &'static str,
        value: &T,
    ) -> Result<(), CdrError> {
        value.serialize(&mut **self)
    }

    fn end(self) -> Result<(), CdrError> {
        Ok(())
    }
}

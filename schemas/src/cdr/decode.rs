//! Decodes CDR bytes. Input from the network may be malicious, so decoding never panics, and never
//! reserves more memory than the input's own size.

use serde::de::{self, DeserializeSeed, Deserializer, Visitor};

use super::{CdrError, CdrFault, HEADER};

/// Reads one message. Up to three bytes of any value may follow it, to a multiple of four: rclpy and
/// rmw_fastrtps round the size of a serialized message up, and leave the rest of the buffer as it was.
///
/// # Errors
/// The bytes are damaged; the error gives the field and byte offset where this was noticed.
pub fn decode<T: de::DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    let Some((header, _)) = bytes.split_at_checked(HEADER.len()) else {
        return Err(CdrError::new(
            0,
            CdrFault::Short {
                needed: HEADER.len(),
                left: bytes.len(),
            },
        ));
    };
    if header[..2] != HEADER[..2] {
        return Err(CdrError::new(
            0,
            CdrFault::Encapsulation {
                found: [header[0], header[1]],
            },
        ));
    }
    let mut decoder = Decoder {
        bytes,
        offset: HEADER.len(),
    };
    let value = T::deserialize(&mut decoder).map_err(|error| decoder.locate(error))?;
    let rest = &bytes[decoder.offset..];
    if !rest.is_empty() && bytes.len() != decoder.offset.next_multiple_of(4) {
        return Err(CdrError::new(
            decoder.offset,
            CdrFault::Trailing(rest.len()),
        ));
    }
    Ok(value)
}

struct Decoder<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Decoder<'a> {
    fn left(&self) -> usize {
        self.bytes.len() - self.offset
    }

    fn fail<T>(&self, reason: CdrFault) -> Result<T, CdrError> {
        Err(CdrError::new(self.offset, reason))
    }

    /// Adds the position to an error raised by serde itself (a capacity exceeded), which has none.
    fn locate(&self, mut error: CdrError) -> CdrError {
        if error.offset == 0 {
            error.offset = self.offset;
        }
        error
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        let start = (self.offset - HEADER.len()).next_multiple_of(N) + HEADER.len();
        match self.bytes.get(start..start + N) {
            Some(slice) => {
                let mut value = [0; N];
                value.copy_from_slice(slice);
                self.offset = start + N;
                Ok(value)
            }
            None => self.fail(CdrFault::Short {
                needed: start + N - self.offset,
                left: self.left(),
            }),
        }
    }

    /// Reads a count of elements of at least one byte each.
    fn take_length(&mut self) -> Result<usize, CdrError> {
        let before = self.offset;
        let length = u32::from_le_bytes(self.take()?);
        if length as usize > self.left() {
            let left = self.left();
            self.offset = before;
            return self.fail(CdrFault::Length { length, left });
        }
        Ok(length as usize)
    }

    fn take_text(&mut self) -> Result<&'a str, CdrError> {
        let length = self.take_length()?;
        if length == 0 {
            // The standard does not allow this, but some writers use it for an empty string.
            return Ok("");
        }
        let slice = &self.bytes[self.offset..self.offset + length];
        let Some((0, text)) = slice.split_last() else {
            return self.fail(CdrFault::Text("no NUL at its end"));
        };
        match std::str::from_utf8(text) {
            Ok(text) => {
                self.offset += length;
                Ok(text)
            }
            Err(_) => self.fail(CdrFault::Text("not UTF-8")),
        }
    }
}

macro_rules! numbers {
    ($($name:ident => $visit:ident: $type:ty),*) => {$(
        fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
            visitor.$visit(<$type>::from_le_bytes(self.take()?))
        }
    )*};
}

macro_rules! unsupported {
    ($($name:ident ($($arg:ty),*) $what:literal;)*) => {$(
        fn $name<V: Visitor<'de>>(self, $(_: $arg,)* _: V) -> Result<V::Value, CdrError> {
            self.fail(CdrFault::Unsupported($what))
        }
    )*};
}

impl<'de> Deserializer<'de> for &mut Decoder<'de> {
    type Error = CdrError;

    numbers!(deserialize_i8 => visit_i8: i8, deserialize_i16 => visit_i16: i16, deserialize_i32 => visit_i32: i32,
             deserialize_i64 => visit_i64: i64, deserialize_u8 => visit_u8: u8, deserialize_u16 => visit_u16: u16,
             deserialize_u32 => visit_u32: u32, deserialize_u64 => visit_u64: u64, deserialize_f32 => visit_f32: f32,
             deserialize_f64 => visit_f64: f64);

    unsupported! {
        deserialize_any() "a value without a type";
        deserialize_ignored_any() "a value without a type";
        deserialize_identifier() "an identifier";
        deserialize_char() "a char";
        deserialize_option() "an option";
        deserialize_unit() "a unit";
        deserialize_unit_struct(&'static str) "a unit";
        deserialize_map() "a map";
        deserialize_enum(&'static str, &'static [&'static str]) "an enum";
    }

    fn is_human_readable(&self) -> bool {
        false
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        match self.take::<1>()? {
            [0] => visitor.visit_bool(false),
            [1] => visitor.visit_bool(true),
            [other] => {
                self.offset -= 1;
                self.fail(CdrFault::Bool(other))
            }
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        visitor.visit_str(self.take_text()?)
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        visitor.visit_str(self.take_text()?)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        let length = self.take_length()?;
        let slice = &self.bytes[self.offset..self.offset + length];
        self.offset += length;
        visitor.visit_bytes(slice)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        self.deserialize_bytes(visitor)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        let count = self.take_length()?;
        visitor.visit_seq(Elements {
            decoder: self,
            left: count,
        })
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        count: usize,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        visitor.visit_seq(Elements {
            decoder: self,
            left: count,
        })
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        count: usize,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        self.deserialize_tuple(count, visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        visitor.visit_seq(Fields {
            decoder: self,
            fields: fields.iter(),
        })
    }
}

struct Elements<'a, 'de> {
    decoder: &'a mut Decoder<'de>,
    left: usize,
}

impl<'de> de::SeqAccess<'de> for Elements<'_, 'de> {
    type Error = CdrError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, CdrError> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.decoder).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left)
    }
}

struct Fields<'a, 'de> {
    decoder: &'a mut Decoder<'de>,
    fields: std::slice::Iter<'static, &'static str>,
}

impl<'de> de::SeqAccess<'de> for Fields<'_, 'de> {
    type Error = CdrError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, CdrError> {
        let Some(field) = self.fields.next() else {
            return Ok(None);
        };
        match seed.deserialize(&mut *self.decoder) {
            Ok(value) => Ok(Some(value)),
            Err(error) => Err(self.decoder.locate(error).within(field)),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.fields.len())
    }
}

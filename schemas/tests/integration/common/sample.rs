//! A message filled with distinct values, so that a swapped or shifted field is noticed.

use serde::de::value::Error;
use serde::de::{self, DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor};

/// `T` with numbers that count up, and sequences of `length` elements.
pub fn sample<T: DeserializeOwned>(length: usize) -> T {
    T::deserialize(&mut Filler { next: 0, length }).expect("the filler gives every value")
}

struct Filler {
    next: u8,
    length: usize,
}

impl Filler {
    fn count(&mut self) -> u8 {
        self.next = self.next % 100 + 1;
        self.next
    }
}

macro_rules! numbers {
    ($($name:ident $visit:ident |$n:ident| $value:expr;)*) => {$(
        fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            let $n = self.count();
            visitor.$visit($value)
        }
    )*};
}

impl<'de> Deserializer<'de> for &mut Filler {
    type Error = Error;

    numbers! {
        deserialize_bool visit_bool |n| n.is_multiple_of(2);
        deserialize_u8 visit_u8 |n| n;
        deserialize_u16 visit_u16 |n| 0x0100 + u16::from(n);
        deserialize_u32 visit_u32 |n| 0x0102_0300 + u32::from(n);
        deserialize_u64 visit_u64 |n| 0x0102_0304_0506_0700 + u64::from(n);
        deserialize_i8 visit_i8 |n| -(n as i8);
        deserialize_i16 visit_i16 |n| -0x0100 - i16::from(n);
        deserialize_i32 visit_i32 |n| -0x0102_0300 - i32::from(n);
        deserialize_i64 visit_i64 |n| -0x0102_0304_0506_0700 - i64::from(n);
        deserialize_f32 visit_f32 |n| f32::from(n) + 0.25;
        deserialize_f64 visit_f64 |n| f64::from(n) + 0.1;
        deserialize_str visit_string |n| "ä text of changing length".chars().take(usize::from(n % 11)).collect();
        deserialize_string visit_string |n| "ä text of changing length".chars().take(usize::from(n % 11)).collect();
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_seq(Elements {
            left: fields.len(),
            filler: self,
        })
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_seq(Elements {
            left: length,
            filler: self,
        })
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let left = self.length;
        visitor.visit_seq(Elements { left, filler: self })
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_byte_buf((0..self.length).map(|_| self.count()).collect())
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(de::Error::custom("a type that no .msg file can say"))
    }

    serde::forward_to_deserialize_any! {
        char bytes option unit unit_struct newtype_struct tuple_struct map enum identifier ignored_any
    }
}

struct Elements<'a> {
    left: usize,
    filler: &'a mut Filler,
}

impl<'de> SeqAccess<'de> for Elements<'_> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Error> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.filler).map(Some)
    }
}

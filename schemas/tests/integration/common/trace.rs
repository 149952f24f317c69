//! Records which values a type requests from a deserializer: the shape of the type.

use serde::de::value::Error;
use serde::de::{self, DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor};

#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    Primitive(&'static str),
    Struct(Vec<(&'static str, Kind)>),
    Array(usize, Box<Kind>),
    Sequence(Box<Kind>),
}

/// The shape of `T`.
pub fn trace<T: DeserializeOwned>() -> Kind {
    let mut kind = None;
    T::deserialize(Tracer { kind: &mut kind }).expect("the tracer gives every value");
    kind.expect("every type asks for something")
}

struct Tracer<'a> {
    kind: &'a mut Option<Kind>,
}

macro_rules! primitives {
    ($($name:ident $visit:ident $kind:literal $value:expr;)*) => {$(
        fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            *self.kind = Some(Kind::Primitive($kind));
            visitor.$visit($value)
        }
    )*};
}

impl<'de> Deserializer<'de> for Tracer<'_> {
    type Error = Error;

    primitives! {
        deserialize_bool visit_bool "bool" false;
        deserialize_u8 visit_u8 "u8" 0;
        deserialize_u16 visit_u16 "u16" 0;
        deserialize_u32 visit_u32 "u32" 0;
        deserialize_u64 visit_u64 "u64" 0;
        deserialize_i8 visit_i8 "i8" 0;
        deserialize_i16 visit_i16 "i16" 0;
        deserialize_i32 visit_i32 "i32" 0;
        deserialize_i64 visit_i64 "i64" 0;
        deserialize_f32 visit_f32 "f32" 0.0;
        deserialize_f64 visit_f64 "f64" 0.0;
        deserialize_str visit_str "string" "";
        deserialize_string visit_str "string" "";
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let mut kinds = Vec::new();
        let value = visitor.visit_seq(Elements {
            left: fields.len(),
            kinds: &mut kinds,
        })?;
        *self.kind = Some(Kind::Struct(fields.iter().copied().zip(kinds).collect()));
        Ok(value)
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        length: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        let mut kinds = Vec::new();
        let value = visitor.visit_seq(Elements {
            left: length,
            kinds: &mut kinds,
        })?;
        *self.kind = Some(Kind::Array(length, Box::new(kinds[0].clone())));
        Ok(value)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let mut kinds = Vec::new();
        let value = visitor.visit_seq(Elements {
            left: 1,
            kinds: &mut kinds,
        })?;
        *self.kind = Some(Kind::Sequence(Box::new(kinds[0].clone())));
        Ok(value)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        *self.kind = Some(Kind::Sequence(Box::new(Kind::Primitive("u8"))));
        visitor.visit_byte_buf(Vec::new())
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
    kinds: &'a mut Vec<Kind>,
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
        let mut kind = None;
        let value = seed.deserialize(Tracer { kind: &mut kind })?;
        self.kinds.extend(kind);
        Ok(Some(value))
    }
}

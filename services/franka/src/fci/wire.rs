//! Packed little-endian values and structures: one list of fields gives layout, encoding and
//! decoding.

use super::errors::ErrorFlags;

/// A value with a fixed number of bytes.
pub(super) trait Wire: Sized {
    /// Length, bytes.
    const BYTES: usize;
    /// Encodes and appends it.
    fn put(&self, out: &mut Vec<u8>);
    /// Decodes it from the front of `bytes`, and advances past it. The length must have been
    /// checked before.
    fn take(bytes: &mut &[u8]) -> Self;
}

/// The first `N` bytes, padded with zeros.
fn front<const N: usize>(bytes: &mut &[u8]) -> [u8; N] {
    match bytes.split_first_chunk::<N>() {
        Some((head, rest)) => {
            *bytes = rest;
            *head
        }
        None => {
            *bytes = &[];
            [0; N]
        }
    }
}

macro_rules! number {
    ($($type:ty),*) => {$(
        impl Wire for $type {
            const BYTES: usize = size_of::<$type>();
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
            fn take(bytes: &mut &[u8]) -> Self {
                Self::from_le_bytes(front(bytes))
            }
        }
    )*};
}
number!(u8, u16, u32, i32, u64, f64);

impl Wire for bool {
    const BYTES: usize = 1;
    fn put(&self, out: &mut Vec<u8>) {
        out.push(u8::from(*self));
    }
    fn take(bytes: &mut &[u8]) -> Self {
        u8::take(bytes) != 0
    }
}

impl<T: Wire, const N: usize> Wire for [T; N] {
    const BYTES: usize = N * T::BYTES;
    fn put(&self, out: &mut Vec<u8>) {
        for value in self {
            value.put(out);
        }
    }
    fn take(bytes: &mut &[u8]) -> Self {
        std::array::from_fn(|_| T::take(bytes))
    }
}

impl Wire for ErrorFlags {
    const BYTES: usize = <[bool; super::ERROR_COUNT]>::BYTES;
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
    }
    fn take(bytes: &mut &[u8]) -> Self {
        Self(Wire::take(bytes))
    }
}

/// Defines a packed structure, from its fields in the order of the datagram.
macro_rules! wire_struct {
    ($(#[$about:meta])* pub struct $name:ident {
        $($(#[$doc:meta])* pub $field:ident: $type:ty,)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            $($(#[$doc])* pub $field: $type,)*
        }
        impl $crate::fci::wire::Wire for $name {
            const BYTES: usize = 0 $(+ <$type as $crate::fci::wire::Wire>::BYTES)*;
            fn put(&self, out: &mut Vec<u8>) {
                $($crate::fci::wire::Wire::put(&self.$field, out);)*
            }
            fn take(bytes: &mut &[u8]) -> Self {
                Self { $($field: $crate::fci::wire::Wire::take(bytes),)* }
            }
        }
    };
}
pub(super) use wire_struct;

/// Decodes bytes that must contain exactly one value.
pub(super) fn exact<T: Wire>(what: &'static str, mut bytes: &[u8]) -> Result<T, super::CodecError> {
    if bytes.len() != T::BYTES {
        return Err(super::CodecError::Length {
            what,
            got: bytes.len(),
            wanted: T::BYTES,
        });
    }
    Ok(T::take(&mut bytes))
}

/// Defines a numbered enumeration of the protocol, with `number()` and `from_number()`.
macro_rules! numbered {
    ($(#[$about:meta])* pub enum $name:ident: $type:ty {
        $($(#[$doc:meta])* $variant:ident = $value:literal,)*
    }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$doc])* $variant = $value,)*
        }
        impl $name {
            /// The number in the protocol.
            pub fn number(self) -> $type {
                self as $type
            }
            /// The variant of a number; `None` if the protocol does not define it.
            pub fn from_number(number: $type) -> Option<Self> {
                match number {
                    $($value => Some(Self::$variant),)*
                    _ => None,
                }
            }
        }
    };
}
pub(super) use numbered;

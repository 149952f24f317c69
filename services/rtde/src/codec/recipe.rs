//! A recipe: the list of fields that one data package carries.

use super::package::PackageKind;
use super::{DataType, HEADER_BYTES, PACKAGE_BYTES_MAX, Value};

/// Why a recipe or its data package cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecipeError {
    /// The fields do not fit into one package.
    #[error("a recipe of {bytes} bytes does not fit into one package of {PACKAGE_BYTES_MAX}")]
    TooLong {
        /// Length of the package that would be needed, bytes.
        bytes: usize,
    },
    /// The data package has another length than its recipe.
    #[error("data package of {got} bytes, but recipe {id} has {expected}")]
    Length {
        /// Id of the recipe.
        id: u8,
        /// Length of the recipe's fields, bytes.
        expected: usize,
        /// Length received, bytes.
        got: usize,
    },
    /// The data package is for another recipe.
    #[error("data package for recipe {got}, but {expected} was set up")]
    WrongId {
        /// Id of the recipe.
        expected: u8,
        /// Id received.
        got: u8,
    },
    /// The number of values or their types differ from the recipe's fields.
    #[error("value {index} does not fit recipe {id}: {got} instead of {expected}")]
    Mismatch {
        /// Id of the recipe.
        id: u8,
        /// Index of the value, from 0.
        index: usize,
        /// Type of the field, or `nothing`.
        expected: &'static str,
        /// Type of the given value, or `nothing`.
        got: &'static str,
    },
}

/// Types of the fields of a data package, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipe {
    id: u8,
    types: Vec<DataType>,
    bytes: usize,
}

impl Recipe {
    /// `id` as the controller gave it (0 in protocol 1, where output data carry none).
    pub fn new(id: u8, types: Vec<DataType>) -> Result<Self, RecipeError> {
        let bytes: usize = types.iter().map(|t| t.bytes()).sum();
        let package = HEADER_BYTES + 1 + bytes;
        if package > PACKAGE_BYTES_MAX {
            return Err(RecipeError::TooLong { bytes: package });
        }
        Ok(Self { id, types, bytes })
    }

    /// As the controller gave it.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// Types of its fields.
    pub fn types(&self) -> &[DataType] {
        &self.types
    }

    /// Bytes of its fields, without id and header.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Appends a whole data package with its id, as sent by a client, and by a controller in
    /// protocol
    /// 2. Allocates only when `out` has no room left; on an error `out` is as before.
    pub fn encode(&self, values: &[Value], out: &mut Vec<u8>) -> Result<(), RecipeError> {
        self.check(values)?;
        self.header(1, out);
        out.push(self.id);
        values.iter().for_each(|v| v.encode(out));
        Ok(())
    }

    /// Appends a whole data package without an id, as sent by a controller in protocol 1.
    pub fn encode_without_id(
        &self,
        values: &[Value],
        out: &mut Vec<u8>,
    ) -> Result<(), RecipeError> {
        self.check(values)?;
        self.header(0, out);
        values.iter().for_each(|v| v.encode(out));
        Ok(())
    }

    /// Replaces `values` by what `payload` (id, then fields) carries. Allocates only when `values`
    /// has no room.
    pub fn decode(&self, payload: &[u8], values: &mut Vec<Value>) -> Result<(), RecipeError> {
        match payload.split_first() {
            Some((&id, fields)) if id == self.id => self.decode_without_id(fields, values),
            Some((&got, _)) => Err(RecipeError::WrongId {
                expected: self.id,
                got,
            }),
            None => Err(self.length(0)),
        }
    }

    /// Replaces `values` by what `fields` (no id in front) carries.
    pub fn decode_without_id(
        &self,
        fields: &[u8],
        values: &mut Vec<Value>,
    ) -> Result<(), RecipeError> {
        if fields.len() != self.bytes {
            return Err(self.length(fields.len()));
        }
        values.clear();
        let mut rest = fields;
        for t in &self.types {
            // The length was checked above, so this never runs short.
            let Some((value, tail)) = t.decode(rest) else {
                return Err(self.length(fields.len()));
            };
            values.push(value);
            rest = tail;
        }
        Ok(())
    }

    fn header(&self, id_bytes: usize, out: &mut Vec<u8>) {
        let size = HEADER_BYTES + id_bytes + self.bytes;
        out.extend_from_slice(&(size as u16).to_be_bytes());
        out.push(PackageKind::Data.code());
    }

    fn length(&self, got: usize) -> RecipeError {
        RecipeError::Length {
            id: self.id,
            expected: self.bytes,
            got,
        }
    }

    fn check(&self, values: &[Value]) -> Result<(), RecipeError> {
        let n = self.types.len().max(values.len());
        for index in 0..n {
            let expected = self.types.get(index);
            let got = values.get(index).map(Value::data_type);
            if expected.copied() != got {
                return Err(RecipeError::Mismatch {
                    id: self.id,
                    index,
                    expected: expected.map_or("nothing", |t| t.name()),
                    got: got.map_or("nothing", DataType::name),
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::value::tests::value;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn there_and_back(id in any::<u8>(), values in prop::collection::vec(value(), 0..80)) {
            let recipe = Recipe::new(id, values.iter().map(Value::data_type).collect()).unwrap();
            for with_id in [true, false] {
                let (mut bytes, mut back, mut again) = (Vec::new(), Vec::new(), Vec::new());
                if with_id {
                    recipe.encode(&values, &mut bytes).unwrap();
                    recipe.decode(&bytes[HEADER_BYTES..], &mut back).unwrap();
                    recipe.encode(&back, &mut again).unwrap();
                } else {
                    recipe.encode_without_id(&values, &mut bytes).unwrap();
                    recipe.decode_without_id(&bytes[HEADER_BYTES..], &mut back).unwrap();
                    recipe.encode_without_id(&back, &mut again).unwrap();
                }
                prop_assert_eq!(usize::from(u16::from_be_bytes([bytes[0], bytes[1]])), bytes.len());
                prop_assert_eq!(bytes, again);
            }
        }

        #[test]
        fn garbage_is_an_error_or_values_never_a_panic(
            types in prop::collection::vec(proptest::sample::select(DataType::ALL.to_vec()), 0..20),
            payload in prop::collection::vec(any::<u8>(), 0..300),
        ) {
            let recipe = Recipe::new(1, types).unwrap();
            let mut values = Vec::new();
            if recipe.decode(&payload, &mut values).is_ok() {
                prop_assert_eq!(payload.len(), recipe.bytes() + 1);
                prop_assert_eq!(values.len(), recipe.types().len());
            }
        }
    }

    #[test]
    fn values_that_do_not_fit_are_reported_by_name() {
        let recipe = Recipe::new(3, vec![DataType::Int32, DataType::Double]).unwrap();
        let mut out = Vec::new();
        let error = recipe.encode(&[Value::Int32(1)], &mut out).unwrap_err();
        assert_eq!(
            error.to_string(),
            "value 1 does not fit recipe 3: nothing instead of DOUBLE"
        );
        assert!(out.is_empty());
        assert_eq!(
            recipe.decode(&[4, 0], &mut Vec::new()),
            Err(RecipeError::WrongId {
                expected: 3,
                got: 4
            })
        );
        assert!(Recipe::new(1, vec![DataType::Vector6d; 1366]).is_err());
    }
}

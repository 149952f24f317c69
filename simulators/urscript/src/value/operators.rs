//! Operators of expressions: between numbers, between truth values, and element by element in
//! lists.

use crate::error::ScriptError;
use crate::matrix::product;
use crate::syntax::Binary;
use crate::value::Value;

impl Value {
    pub(crate) fn negated(&self) -> Result<Value, ScriptError> {
        match self {
            Self::Integer(n) => Ok(Self::Integer(n.wrapping_neg())),
            Self::Float(x) => Ok(Self::Float(-x)),
            Self::List(list) => Self::list(
                list.items
                    .iter()
                    .map(Value::negated)
                    .collect::<Result<_, _>>()?,
            ),
            other => Err(ScriptError::NoNegative { kind: other.kind() }),
        }
    }

    pub(crate) fn binary(
        operator: Binary,
        left: &Value,
        right: &Value,
    ) -> Result<Value, ScriptError> {
        use Value::{Bool, Float, Integer};
        let unfit = || ScriptError::Operands {
            operator: operator.symbol(),
            left: left.kind(),
            right: right.kind(),
        };
        Ok(match operator {
            Binary::Equal => Bool(left.equals(right)),
            Binary::NotEqual => Bool(!left.equals(right)),
            Binary::Xor => Bool(left.truth()? ^ right.truth()?),
            Binary::And => Bool(left.truth()? && right.truth()?),
            Binary::Or => Bool(left.truth()? || right.truth()?),
            Binary::Less => Bool(left.float()? < right.float()?),
            Binary::LessOrEqual => Bool(left.float()? <= right.float()?),
            Binary::Greater => Bool(left.float()? > right.float()?),
            Binary::GreaterOrEqual => Bool(left.float()? >= right.float()?),
            Binary::Multiply if left.is_matrix() && matches!(right, Self::List(_)) => {
                product(left, right)?
            }
            Binary::Add | Binary::Subtract | Binary::Multiply => match (left, right) {
                (Integer(a), Integer(b)) => Integer(match operator {
                    Binary::Add => a.wrapping_add(*b),
                    Binary::Subtract => a.wrapping_sub(*b),
                    _ => a.wrapping_mul(*b),
                }),
                (Integer(_) | Float(_), Integer(_) | Float(_)) => {
                    let (a, b) = (left.float()?, right.float()?);
                    Float(match operator {
                        Binary::Add => a + b,
                        Binary::Subtract => a - b,
                        _ => a * b,
                    })
                }
                _ => Self::each(operator, left, right).ok_or_else(unfit)??,
            },
            // Dividing two ints gives a float, as on the controller.
            Binary::Divide => match (left, right) {
                (Self::List(_), _) => Self::each(operator, left, right).ok_or_else(unfit)??,
                _ => {
                    let b = right.float()?;
                    if b == 0.0 {
                        return Err(ScriptError::DivisionByZero);
                    }
                    Float(left.float()? / b)
                }
            },
            Binary::Remainder => match (left, right) {
                (Integer(_), Integer(0)) => return Err(ScriptError::DivisionByZero),
                (Integer(a), Integer(b)) => Integer(a.wrapping_rem(*b)),
                _ => Float(left.float()? % right.float()?),
            },
        })
    }

    /// Element by element: list with list, list with number.
    fn each(operator: Binary, left: &Value, right: &Value) -> Option<Result<Value, ScriptError>> {
        let items: Result<Vec<Value>, ScriptError> = match (left, right) {
            (Self::List(a), Self::List(b)) if a.items.len() == b.items.len() => a
                .items
                .iter()
                .zip(b.items.iter())
                .map(|(x, y)| Self::binary(operator, x, y))
                .collect(),
            (Self::List(a), Self::Integer(_) | Self::Float(_)) => a
                .items
                .iter()
                .map(|x| Self::binary(operator, x, right))
                .collect(),
            (Self::Integer(_) | Self::Float(_), Self::List(b)) => b
                .items
                .iter()
                .map(|y| Self::binary(operator, left, y))
                .collect(),
            _ => return None,
        };
        Some(items.and_then(Self::list))
    }

    fn equals(&self, other: &Value) -> bool {
        match (self, other) {
            (Self::Integer(a), Self::Float(b)) | (Self::Float(b), Self::Integer(a)) => {
                f64::from(*a) == *b
            }
            _ => self == other,
        }
    }
}

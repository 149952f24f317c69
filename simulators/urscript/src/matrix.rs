//! Matrices: lists of lists of numbers.

use nalgebra::{DMatrix, DVector};

use crate::error::ScriptError;
use crate::value::Value;

/// The matrix in a list of rows.
///
/// # Errors
/// The value is not a list of lists of one length, or they hold other things than numbers.
pub fn matrix(value: &Value) -> Result<DMatrix<f64>, ScriptError> {
    let rows = value.rows().unwrap_or_default();
    let columns = rows.first().map_or(0, |row| row.len());
    if columns == 0 {
        return Err(ScriptError::Kind {
            needed: "a matrix",
            found: value.kind(),
        });
    }
    let mut numbers = Vec::with_capacity(rows.len() * columns);
    for number in rows.iter().copied().flatten() {
        numbers.push(number.float()?);
    }
    Ok(DMatrix::from_row_slice(rows.len(), columns, &numbers))
}

/// The list of rows of a matrix.
///
/// # Errors
/// The list is longer than lists may be.
pub fn rows(m: &DMatrix<f64>) -> Result<Value, ScriptError> {
    let mut rows = Vec::with_capacity(m.nrows());
    for row in m.row_iter() {
        rows.push(vector(row.iter())?);
    }
    Value::list(rows)
}

/// Matrix times matrix, or matrix times vector.
///
/// # Errors
/// The sizes do not fit, or there are other things than numbers.
pub fn product(left: &Value, right: &Value) -> Result<Value, ScriptError> {
    let a = matrix(left)?;
    let unfit = || ScriptError::Sizes {
        rows: a.nrows(),
        columns: a.ncols(),
    };
    if right.rows().is_some_and(|rows| !rows.is_empty()) {
        let b = matrix(right)?;
        if a.ncols() != b.nrows() {
            return Err(unfit());
        }
        return rows(&(a * b));
    }
    let b = DVector::from_vec(right.numbers()?);
    if a.ncols() != b.nrows() {
        return Err(unfit());
    }
    vector((a * b).iter())
}

fn vector<'a>(numbers: impl Iterator<Item = &'a f64>) -> Result<Value, ScriptError> {
    Value::list(numbers.map(|x| Value::Float(*x)).collect())
}

//! What can be wrong with the numbers a conditioner is made from.

/// A parameter out of its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("`{key}` is {value}, but must be {allowed}")]
pub struct SensingError {
    /// The parameter, as in the cell file.
    pub key: &'static str,
    /// What was given.
    pub value: f64,
    /// What is allowed.
    pub allowed: String,
}

impl SensingError {
    /// Fails unless `good`.
    pub(crate) fn unless(
        good: bool,
        key: &'static str,
        value: f64,
        allowed: impl Into<String>,
    ) -> Result<(), Self> {
        if good {
            Ok(())
        } else {
            Err(Self {
                key,
                value,
                allowed: allowed.into(),
            })
        }
    }
}

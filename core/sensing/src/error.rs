//! Error of a parameter out of its range.

/// A parameter is out of its range.
///
/// ```
/// use tangent_sensing::LowPass;
/// let error = LowPass::new(600.0, 1000.0).unwrap_err();
/// assert_eq!(error.key, "filter_cutoff_hz");
/// assert!(error.to_string().starts_with("`filter_cutoff_hz` is 600, but must be from 0"));
/// ```
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("`{key}` is {value}, but must be {allowed}")]
pub struct SensingError {
    /// Name of the parameter in the cell file.
    pub key: &'static str,
    /// Value found.
    pub value: f64,
    /// Allowed range, in words.
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

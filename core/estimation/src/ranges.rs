//! Ranges of the estimators' settings.

use crate::EstimationError;

/// Checks rows of dotted key, value, smallest and largest value allowed.
///
/// # Errors
/// [`EstimationError::OutOfRange`] names the first setting that is not in its range.
pub(crate) fn check_ranges(rows: &[(&'static str, f64, f64, f64)]) -> Result<(), EstimationError> {
    for &(key, value, lower, upper) in rows {
        // Tests for "inside", so that NaN fails too.
        let inside = value >= lower && value <= upper;
        if !inside {
            return Err(EstimationError::OutOfRange {
                key,
                value,
                lower,
                upper,
            });
        }
    }
    Ok(())
}

//! What every law's parameters have in common.

use crate::error::ControlError;

/// Parameters of a law that a program needs.
pub trait LawConfig: Clone + Send + 'static {
    /// Checks all parameters.
    ///
    /// # Errors
    /// A parameter is out of its range.
    fn check(&self) -> Result<(), ControlError>;

    /// Bounds of the path's acceleration, m/s², and jerk, m/s³.
    fn path_bounds(&self) -> (f64, f64);
}

//! What every law's parameters have in common.

use crate::error::ControlError;

/// Parameters of a law that a program needs.
///
/// ```
/// use tangent_control::{HybridDynamicsConfig, LawConfig, UnifiedForceImpedanceConfig};
///
/// HybridDynamicsConfig::default().check()?;
/// let (acceleration_m_per_s2, _) = UnifiedForceImpedanceConfig::default().path_bounds();
/// assert_eq!(acceleration_m_per_s2, 0.2);
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
pub trait LawConfig: Clone + Send + 'static {
    /// Whether the law learns over repeated passes: `[learning]` of a task.
    const LEARNS: bool = false;
    /// Whether the law lifts the tool off the surface between strokes, and presses with a force of
    /// each stroke.
    const LIFTS: bool = false;

    /// Whether the law moves the arm in joint space: to `[start]` and `[home]` of a task.
    const TRAVELS: bool = false;

    /// Checks all parameters.
    ///
    /// # Errors
    /// A parameter is out of its range.
    fn check(&self) -> Result<(), ControlError>;

    /// Bounds of the path's acceleration, m/s², and jerk, m/s³.
    fn path_bounds(&self) -> (f64, f64);

    /// Fastest change of the pressing force that is followed, N/s.
    fn force_rate_max_n_per_s(&self) -> f64 {
        f64::INFINITY
    }
}

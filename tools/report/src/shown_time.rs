//! Times as the report shows them.

/// `time_s` (s) rounded to hundredths, as it is shown; a small negative time becomes 0, not -0.
pub(crate) fn shown_s(time_s: f64) -> f64 {
    (time_s * 100.0).round() / 100.0 + 0.0
}

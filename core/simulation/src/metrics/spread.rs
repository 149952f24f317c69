//! Statistics of a list of values.

use serde::{Deserialize, Serialize};

/// Summary of a list of non-negative errors.
///
/// ```
/// use tangent_simulation::metrics::Spread;
///
/// let spread = Spread::of(&mut [4.0, 1.0, 3.0, 2.0]).unwrap();
/// assert_eq!((spread.mean, spread.median, spread.max, spread.n), (2.5, 2.5, 4.0, 4));
/// assert_eq!(Spread::of(&mut []), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median; the mean of the two middle values for an even count.
    pub median: f64,
    /// Standard deviation about the mean, divided by `n`.
    pub std: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// 95th percentile: the smallest value that 95 % of the values do not exceed.
    pub p95: f64,
    /// Largest value.
    pub max: f64,
    /// Number of values.
    pub n: usize,
}

impl Spread {
    /// Summary of `values`, which are sorted in place; `None` if there are none.
    pub fn of(values: &mut [f64]) -> Option<Self> {
        let n = values.len();
        if n == 0 {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / n as f64;
        let square = values.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64;
        Some(Self {
            mean,
            median: 0.5 * (values[(n - 1) / 2] + values[n / 2]),
            std: variance.sqrt(),
            rmse: square.sqrt(),
            p95: percentile_95(values),
            max: values[n - 1],
            n,
        })
    }
}

/// 95th percentile by nearest rank of a sorted list that is not empty.
pub(super) fn percentile_95(sorted: &[f64]) -> f64 {
    let rank = (0.95 * sorted.len() as f64).ceil() as usize;
    sorted[rank.clamp(1, sorted.len()) - 1]
}

/// Arithmetic mean; `None` if there are no values.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Root of the mean square; `None` if there are no values.
pub(crate) fn root_mean_square(values: &[f64]) -> Option<f64> {
    (!values.is_empty())
        .then(|| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt())
}

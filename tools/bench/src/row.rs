//! One measured quantity, and the machine on which it was measured.

use serde::Serialize;
use tangent_report::Quantiles;

use crate::load::cores;

/// One measured quantity.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name, with the conditions of the measurement.
    pub name: String,
    /// Number of samples.
    pub n: usize,
    /// Median, µs.
    pub p50_us: f64,
    /// 99 % quantile, µs.
    pub p99_us: f64,
    /// 99.9 % quantile, µs.
    pub p999_us: f64,
    /// Slowest, µs.
    pub max_us: f64,
    /// Number of messages that were never answered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost: Option<usize>,
}

impl Row {
    /// Computes the row from single durations, µs; `None` if there are none.
    pub fn of(name: impl Into<String>, us: Vec<f64>) -> Option<Self> {
        let n = us.len();
        let q = Quantiles::of(us)?;
        Some(Self {
            name: name.into(),
            n,
            p50_us: q.p50,
            p99_us: q.p99,
            p999_us: q.p999,
            max_us: q.max,
            lost: None,
        })
    }
}

/// The machine on which something was measured. Figures of different machines cannot be compared.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Number of cores that this process may use.
    pub cores: usize,
    /// Release of the Linux kernel.
    pub kernel: String,
    /// Contents of `/proc/loadavg`.
    pub load_average: String,
}

impl Machine {
    /// Describes this machine at this moment.
    pub fn this() -> Self {
        let read = |path: &str| {
            std::fs::read_to_string(path)
                .map(|text| text.trim().to_owned())
                .unwrap_or_default()
        };
        Self {
            cores: cores(),
            kernel: read("/proc/sys/kernel/osrelease"),
            load_average: read("/proc/loadavg"),
        }
    }
}

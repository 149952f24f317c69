//! What a task with coverage asks of its rounds.

/// What rounds aim at, and with which force and speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RoundRules {
    /// Least and most dose, N*s/cm²; `None`: passes are counted.
    pub band: Option<[f64; 2]>,
    /// Least number of passes.
    pub passes: u32,
    pub force_n: f64,
    pub speed_m_per_s: f64,
    pub radius_m: f64,
    /// Least width of the tip's disk in the path's plane, from its middle, m.
    pub across_m: f64,
    /// Bounds of the acceleration, m/s², and jerk, m/s³.
    pub bounds: (f64, f64),
}

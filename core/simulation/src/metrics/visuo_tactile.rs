//! Figures specific to `unified_force_impedance`: shaping, the camera's rate and the energy balance
//! of the tanks.

use serde::{Deserialize, Serialize};
use tangent_control::{Phase, UnifiedOutput};

/// One cycle of a visuo-tactile run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisuoTactileSample {
    /// Time of the cycle, s.
    pub time_s: f64,
    /// The task's phase.
    pub phase: Phase,
    /// Passivity monitor C and its margin.
    pub monitor: (f64, f64),
    /// ρ_align.
    pub rho_align: f64,
    /// ρ_frc.
    pub rho_force: f64,
    /// Position on the true surface that the policy requests for the tool, base axes, m.
    pub wanted_m: [f64; 3],
    /// True position of the tool, base axes, m.
    pub tool_m: [f64; 3],
    /// Force of the surface on the tool, tool axes, N.
    pub force_n: [f64; 3],
    /// Shaped reference of the pressing force, N.
    pub force_reference_n: f64,
    /// Motion and force tank, J.
    pub tanks_j: (f64, f64),
    /// Whether the normal in use, from vision or from contact, is valid.
    pub normal_valid: bool,
    /// Internal values of the law; `None` in a recording.
    pub inside: Option<VisuoTactileInside>,
}

/// Internal values that the law does not publish.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisuoTactileInside {
    /// Energy that the tanks have lacked so far, J.
    pub short_j: f64,
    /// Whether a limit of torque or rate cut the command.
    pub limited: bool,
    /// Friction coefficient in use.
    pub friction: f64,
}

impl VisuoTactileSample {
    pub(crate) fn of<const N: usize>(
        time_s: f64,
        output: &UnifiedOutput<N>,
        wanted: &nalgebra::Vector3<f64>,
        force: &nalgebra::Vector3<f64>,
    ) -> Self {
        Self {
            time_s,
            phase: output.phase,
            monitor: (output.monitor, output.monitor_margin),
            rho_align: output.rho_align,
            rho_force: output.rho_force,
            wanted_m: (*wanted).into(),
            tool_m: output.base_from_tool.translation().into(),
            force_n: (*force).into(),
            force_reference_n: output.force_reference_n,
            tanks_j: (output.tanks.motion_j, output.tanks.force_j),
            normal_valid: output.normal_validity.is_valid(),
            inside: Some(VisuoTactileInside {
                short_j: output.tanks.short_j,
                limited: output.limited,
                friction: output.friction,
            }),
        }
    }
}

/// Figures of a visuo-tactile run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VisuoTactileFigures {
    /// Camera frames per second.
    pub vision_rate_hz: f64,
    /// Minimum of ρ_align while sliding.
    pub rho_align_min: Option<f64>,
    /// Mean of ρ_align while sliding.
    pub rho_align_mean: Option<f64>,
    /// Minimum of ρ_frc while sliding.
    pub rho_force_min: Option<f64>,
    /// Mean of ρ_frc while sliding.
    pub rho_force_mean: Option<f64>,
    /// Largest ratio of the monitor to its margin while sliding; above 1 the arm yields.
    pub monitor_share_max: Option<f64>,
    /// Largest force across the tool's axis, N.
    pub lateral_force_max_n: Option<f64>,
    /// Energy that the tanks lacked, J; 0 unless a valve closed too late. `None` for a recording,
    /// as for all figures from [`VisuoTactileInside`].
    pub short_j: Option<f64>,
    /// Duration of the sliding, s. It varies, as the policy's clock waits for a compliant arm.
    pub sliding_s: f64,
    /// Share of the sliding time without a valid normal.
    pub blind_share: Option<f64>,
    /// Number of periods in which a limit of torque or rate cut the command.
    pub limited_cycles: Option<u64>,
    /// Estimated friction coefficient at the end.
    pub friction_found: Option<f64>,
}

impl VisuoTactileFigures {
    /// Figures from the cycles of one task.
    pub fn of(samples: &[VisuoTactileSample], period_s: f64, frames: u64) -> Self {
        let sliding: Vec<&VisuoTactileSample> =
            samples.iter().filter(|s| s.phase == Phase::Slide).collect();
        let n = sliding.len() as f64;
        let least =
            |f: &dyn Fn(&VisuoTactileSample) -> f64| sliding.iter().map(|s| f(s)).reduce(f64::min);
        let most =
            |f: &dyn Fn(&VisuoTactileSample) -> f64| sliding.iter().map(|s| f(s)).reduce(f64::max);
        let mean = |f: &dyn Fn(&VisuoTactileSample) -> f64| {
            (n > 0.0).then(|| sliding.iter().map(|s| f(s)).sum::<f64>() / n)
        };
        let time = samples.last().map_or(0.0, |s| s.time_s);
        let end = samples.last().and_then(|s| s.inside);
        Self {
            vision_rate_hz: if time > 0.0 {
                frames as f64 / time
            } else {
                0.0
            },
            rho_align_min: least(&|s| s.rho_align),
            rho_align_mean: mean(&|s| s.rho_align),
            rho_force_min: least(&|s| s.rho_force),
            rho_force_mean: mean(&|s| s.rho_force),
            monitor_share_max: most(&|s| s.monitor.0 / s.monitor.1),
            lateral_force_max_n: most(&|s| {
                (s.force_n[0] * s.force_n[0] + s.force_n[1] * s.force_n[1]).sqrt()
            }),
            short_j: end.map(|i| i.short_j),
            sliding_s: n * period_s,
            blind_share: mean(&|s| f64::from(u8::from(!s.normal_valid))),
            limited_cycles: end.map(|_| {
                let limited = |s: &&VisuoTactileSample| s.inside.is_some_and(|i| i.limited);
                samples.iter().filter(limited).count() as u64
            }),
            friction_found: end.map(|i| i.friction),
        }
    }
}

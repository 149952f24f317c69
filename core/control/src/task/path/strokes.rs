//! Strokes with lifts between them, as specified in a task file.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::force_profile::{FORCE_N, check_force_profile};
use super::ranges::{LIFT_M, PAUSE_S, SPEED_M_PER_S, check_point, default_lift, default_travel};
use crate::error::{ControlError, check_range};
use crate::task::ExpectedSurface;

/// A stroke that begins this near the end of the one before needs no lift, m.
const JOINED_M: f64 = 1e-4;
/// Most points of all strokes.
const POINTS_MAX: usize = 100_000;

/// Strokes on the surface; the tool lifts off between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strokes {
    /// The strokes, in their order.
    pub strokes: Vec<StrokeSpec>,
    /// Speed of a stroke that states none, m/s.
    pub speed_m_per_s: f64,
    /// Pause at every sharp corner and at the end of every stroke, s.
    #[serde(default)]
    pub pause_s: f64,
    /// Height above the surface between strokes, m.
    #[serde(default = "default_lift")]
    pub lift_m: f64,
    /// Speed above the surface, m/s.
    #[serde(default = "default_travel")]
    pub travel_speed_m_per_s: f64,
    /// Expected shape of the surface; with it, points are places over the plane instead of lengths
    /// along the surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<ExpectedSurface>,
}

/// One stroke.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StrokeSpec {
    /// Points, m; straight lines between them.
    pub points_m: Vec<[f64; 2]>,
    /// Pressing force, N; `None`: the task's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_n: Option<f64>,
    /// Pressing force along the stroke instead of `force_n`: `[way in m, force in N]` each, linear
    /// between them, constant beyond.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub force_profile: Vec<[f64; 2]>,
    /// Speed, m/s; `None`: that of the path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_m_per_s: Option<f64>,
}

impl Strokes {
    /// Checks every number.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        let speed = |key: &str, v| check_range(key, v, SPEED_M_PER_S.0, SPEED_M_PER_S.1);
        if self.strokes.is_empty() {
            return Err(ControlError::range(
                "path.strokes",
                "empty",
                "1 stroke or more",
            ));
        }
        let points: usize = self.strokes.iter().map(|s| s.points_m.len()).sum();
        if points > POINTS_MAX {
            let allowed = format!("at most {POINTS_MAX} points in all strokes");
            return Err(ControlError::range(
                "path.strokes",
                format!("{points} points"),
                &allowed,
            ));
        }
        for (index, stroke) in self.strokes.iter().enumerate() {
            let key = |name: &str| format!("path.strokes[{index}].{name}");
            if stroke.points_m.is_empty() {
                return Err(ControlError::range(
                    key("points_m"),
                    "empty",
                    "1 point or more",
                ));
            }
            for point in &stroke.points_m {
                check_point(&key("points_m"), point)?;
            }
            if let Some(force_n) = stroke.force_n {
                check_range(&key("force_n"), force_n, FORCE_N.0, FORCE_N.1)?;
                if !stroke.force_profile.is_empty() {
                    let allowed = "`force_n` or `force_profile`, not both";
                    return Err(ControlError::range(key("force_n"), force_n, allowed));
                }
            }
            if !stroke.force_profile.is_empty() {
                check_force_profile(&key("force_profile"), &stroke.force_profile)?;
            }
            if let Some(v) = stroke.speed_m_per_s {
                speed(&key("speed_m_per_s"), v)?;
            }
        }
        if let Some(surface) = &self.surface {
            surface.check(self.strokes.iter().flat_map(|stroke| &stroke.points_m))?;
        }
        check_range("path.pause_s", self.pause_s, PAUSE_S.0, PAUSE_S.1)?;
        check_range("path.lift_m", self.lift_m, LIFT_M.0, LIFT_M.1)?;
        speed("path.travel_speed_m_per_s", self.travel_speed_m_per_s)?;
        speed("path.speed_m_per_s", self.speed_m_per_s)
    }

    /// The highest speed of a stroke, m/s.
    pub(crate) fn speed_max_m_per_s(&self) -> f64 {
        let of = |stroke: &StrokeSpec| stroke.speed_m_per_s.unwrap_or(self.speed_m_per_s);
        self.strokes.iter().map(of).fold(0.0, f64::max)
    }

    /// Whether the tool lifts off between two points: they are not the same one.
    pub(super) fn lifts(from: &Vector2<f64>, to: &Vector2<f64>) -> bool {
        (to - from).norm() > JOINED_M
    }
}

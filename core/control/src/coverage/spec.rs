//! `[coverage]` of a task file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};
use crate::task::path::PathSpec;
use crate::task::path::ranges::{SPEED_M_PER_S, default_lift, default_travel};
use crate::task::region::{Pattern, Region};

/// Most rounds.
pub(super) const ROUNDS_MAX: u32 = 20;
/// Widest margin of a region as a share of the tip's radius: further in, the dose at the edge is
/// too small.
const MARGIN_SHARE_MAX: f64 = 0.6;

/// What the region must get, and how often the tool goes over it for that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoverageSpec {
    /// Radius of the tip's contact, m: the force counts as spread evenly over this disk. `None`:
    /// that of the tool's tip, see [`Task::complete`](crate::Task::complete).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_m: Option<f64>,
    /// Corners of the outline of what is judged, m, for a path of strokes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outline_m: Vec<[f64; 2]>,
    /// Corners of each hole, m, for a path of strokes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub holes_m: Vec<Vec<[f64; 2]>>,
    /// Distance of the tool's middle from every edge in further rounds, m, for a path of strokes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin_m: Option<f64>,
    /// Least and most dose of pressure, N*s/cm²; `None`: passes are counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dose_n_s_per_cm2: Option<[f64; 2]>,
    /// Least number of passes over each place; `None`: the dose is judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passes: Option<u32>,
    /// Least share of the region that is within the band.
    #[serde(default = "default_share")]
    pub share_min: f64,
    /// Most rounds, the first included.
    #[serde(default = "default_rounds")]
    pub rounds_max: u32,
}

fn default_share() -> f64 {
    0.99
}

fn default_rounds() -> u32 {
    3
}

impl CoverageSpec {
    /// Checks every number, and that the path is a region.
    pub(crate) fn check(&self, path: &PathSpec, learns: bool) -> Result<(), ControlError> {
        if let Some(radius_m) = self.radius_m {
            check_range("coverage.radius_m", radius_m, 0.001, 0.1)?;
        }
        check_range("coverage.share_min", self.share_min, 0.5, 1.0)?;
        let rounds = f64::from(self.rounds_max);
        check_range("coverage.rounds_max", rounds, 1.0, f64::from(ROUNDS_MAX))?;
        match (self.dose_n_s_per_cm2, self.passes) {
            (Some([least, most]), None) => {
                check_range("coverage.dose_n_s_per_cm2[0]", least, 0.001, 1e5)?;
                check_range("coverage.dose_n_s_per_cm2[1]", most, 1.2 * least, 1e6)?;
            }
            (None, Some(passes)) => {
                check_range("coverage.passes", f64::from(passes), 1.0, 1000.0)?;
            }
            (dose, _) => {
                let value = if dose.is_some() { "both" } else { "neither" };
                return Err(ControlError::range(
                    "coverage",
                    format!("{value} `dose_n_s_per_cm2` and `passes`"),
                    "one of them",
                ));
            }
        }
        let (region, key) = self.region(path)?;
        if let Some(margin_max_m) = self.radius_m.map(|r| MARGIN_SHARE_MAX * r)
            && region.margin_m > margin_max_m
        {
            return Err(ControlError::range(
                format!("{key}.margin_m"),
                region.margin_m,
                &format!(
                    "at most {margin_max_m:.4} with this `coverage.radius_m`: the edge is not reached"
                ),
            ));
        }
        if key == "coverage" {
            check_range("coverage.margin_m", region.margin_m, 0.0, 0.5)?;
            region.check_shape(key)?;
        }
        if learns {
            return Err(ControlError::range(
                "coverage",
                "together with `learning`",
                "one of them: what is learnt belongs to one path",
            ));
        }
        Ok(())
    }

    /// What is judged, and the table of its keys: the region of the path, or for strokes the
    /// outline of `[coverage]`.
    pub(super) fn region(&self, path: &PathSpec) -> Result<(Region, &'static str), ControlError> {
        let own =
            !(self.outline_m.is_empty() && self.holes_m.is_empty()) || self.margin_m.is_some();
        match path {
            PathSpec::Region(region) if !own => Ok((region.clone(), "path")),
            PathSpec::Region(_) => Err(ControlError::range(
                "coverage.outline_m",
                "set",
                "no `outline_m`, `holes_m` and `margin_m` beside those of `path.kind = \"region\"`",
            )),
            PathSpec::Strokes(strokes) if own => Ok((
                Region {
                    outline_m: self.outline_m.clone(),
                    holes_m: self.holes_m.clone(),
                    pattern: Pattern::Raster,
                    spacing_m: 0.01,
                    angle_rad: 0.0,
                    margin_m: self.margin_m.unwrap_or(0.0),
                    speed_m_per_s: strokes.speed_max_m_per_s().max(SPEED_M_PER_S.0),
                    pause_s: 0.0,
                    lift_m: default_lift(),
                    travel_speed_m_per_s: default_travel(),
                },
                "coverage",
            )),
            _ => Err(ControlError::range(
                "coverage",
                "for a path without an outline",
                "`path.kind = \"region\"`, or `path.kind = \"strokes\"` with `coverage.outline_m`",
            )),
        }
    }
}

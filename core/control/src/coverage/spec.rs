//! `[coverage]` of a task file.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};
use crate::task::path::PathSpec;

/// Most rounds.
pub(super) const ROUNDS_MAX: u32 = 20;
/// Widest margin of a region as a share of the tip's radius: further in, the dose at the edge is
/// too small.
const MARGIN_SHARE_MAX: f64 = 0.6;

/// What the region must get, and how often the tool goes over it for that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoverageSpec {
    /// Radius of the tip's contact, m: the force counts as spread evenly over this disk.
    pub radius_m: f64,
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
        check_range("coverage.radius_m", self.radius_m, 0.001, 0.1)?;
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
        let PathSpec::Region(region) = path else {
            return Err(ControlError::range(
                "coverage",
                "for a path that is no region",
                "only `path.kind = \"region\"`",
            ));
        };
        let margin_max_m = MARGIN_SHARE_MAX * self.radius_m;
        if region.margin_m > margin_max_m {
            return Err(ControlError::range(
                "path.margin_m",
                region.margin_m,
                &format!(
                    "at most {margin_max_m:.4} with this `coverage.radius_m`: the edge is not reached"
                ),
            ));
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
}

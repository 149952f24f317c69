//! `[tool.tip]`: the shape of the part of the tool that touches.

use serde::{Deserialize, Serialize};
use tangent_mechanics::Tip;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Smallest radius of a tip whose shape is known, m.
const RADIUS_MIN_M: f64 = 1e-4;

/// Shape of a tip, without its size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TipKind {
    /// A flat disk.
    Flat,
    /// A rim, such as the mouth of a cup.
    Ring,
    /// A ball.
    Round,
    /// A foam or a swab that gives.
    Soft,
    /// Nothing is known.
    #[default]
    Unknown,
}

/// `[tool.tip]`
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipConfig {
    /// Shape.
    pub kind: TipKind,
    /// Radius of the disk, rim, ball or area of contact, m; none for an unknown shape.
    #[serde(default)]
    pub radius_m: Option<f64>,
}

impl TipConfig {
    /// The tip as the estimators are told of it. A shape without a radius counts as unknown; the
    /// check of a cell file refuses it.
    pub fn tip(&self) -> Tip {
        let Some(radius_m) = self.radius_m else {
            return Tip::Unknown;
        };
        match self.kind {
            TipKind::Flat => Tip::Flat { radius_m },
            TipKind::Ring => Tip::Ring { radius_m },
            TipKind::Round => Tip::Round { radius_m },
            TipKind::Soft => Tip::Soft { radius_m },
            TipKind::Unknown => Tip::Unknown,
        }
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let key = "tool.tip.radius_m";
        match (self.kind, self.radius_m) {
            (TipKind::Unknown, None) => Ok(()),
            (TipKind::Unknown, Some(radius_m)) => Err(checker.refuse(
                key,
                radius_m,
                "no radius with tool.tip.kind = \"unknown\": remove it, or state the kind: flat, ring, round or soft",
            )),
            (_, None) => Err(checker.refuse(
                key,
                "nothing",
                "with tool.tip.kind other than \"unknown\", state the radius of the disk, rim, ball or area of contact \
                 in metres, or set the kind to \"unknown\"",
            )),
            (_, Some(radius_m)) => {
                checker.range(key, radius_m, RADIUS_MIN_M..=Tip::RADIUS_MAX_M, "m")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CellConfig;

    fn cell(tip: &str) -> Result<CellConfig, ConfigError> {
        CellConfig::default_cell().changed("the test's cell", |table| {
            let tip: toml::Table = tip.parse().unwrap();
            let tool = table["tool"].as_table_mut().unwrap();
            tool.insert("tip".to_owned(), tip.into());
        })
    }

    #[test]
    fn each_kind_is_read() {
        let radius_m = 0.012;
        for (kind, tip) in [
            ("flat", Tip::Flat { radius_m }),
            ("ring", Tip::Ring { radius_m }),
            ("round", Tip::Round { radius_m }),
            ("soft", Tip::Soft { radius_m }),
        ] {
            let cell = cell(&format!("kind = '{kind}'\nradius_m = 0.012")).unwrap();
            assert_eq!(cell.tool.tip.tip(), tip);
            assert_eq!(tip.name(), kind);
        }
        assert_eq!(
            cell("kind = 'unknown'").unwrap().tool.tip.tip(),
            Tip::Unknown
        );
        let silent = CellConfig::default_cell().changed("the test's cell", |table| {
            table["tool"].as_table_mut().unwrap().remove("tip");
        });
        assert_eq!(silent.unwrap().tool.tip.tip(), Tip::Unknown);
    }

    #[test]
    fn a_refused_tip_names_key_value_and_what_is_allowed() {
        for (tip, words) in [
            (
                "kind = 'flat'",
                &["tool.tip.radius_m", "nothing", "metres"][..],
            ),
            (
                "kind = 'flat'\nradius_m = 8.0",
                &["tool.tip.radius_m", "8", "from 0.0001 to 0.5 m"],
            ),
            (
                "kind = 'round'\nradius_m = -0.01",
                &["tool.tip.radius_m", "-0.01"],
            ),
            (
                "kind = 'unknown'\nradius_m = 0.01",
                &["tool.tip.radius_m", "0.01", "remove it"],
            ),
            (
                "kind = 'flatt'\nradius_m = 0.01",
                &["tool.tip.kind", "flatt", "did you mean `flat`?", "ring"],
            ),
            (
                "shape = 'flat'\nradius_m = 0.01",
                &["tool.tip.shape", "kind"],
            ),
        ] {
            let said = cell(tip).unwrap_err().to_string();
            for word in words {
                assert!(said.contains(word), "{tip}: no {word:?} in: {said}");
            }
        }
    }
}

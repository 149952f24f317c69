//! Shape of a tool's tip: where it touches a surface, and what the torque says of its tilt.
//!
//! Stated to the estimators as `contact.tip`. A simulated tool has a tip of its own, which may
//! differ from the stated one.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Shape of the part of the tool that touches. The tool's origin is its foremost point, z out of
/// the tool.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_mechanics::Tip;
///
/// // A ball of 10 mm, tilted by 0.1 rad about y, touches beside its foremost point.
/// let tip = Tip::Round { radius_m: 0.01 };
/// let normal_in_tool = Vector3::new(0.1_f64.sin(), 0.0, -(0.1_f64.cos()));
/// let point = tip.contact_in_tool(&normal_in_tool);
/// assert!((point.x + 0.01 * 0.1_f64.sin()).abs() < 1e-12);
/// // A tip of unknown shape touches at the tool's origin, as far as anybody knows.
/// assert_eq!(Tip::Unknown.contact_in_tool(&normal_in_tool), Vector3::zeros());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub enum Tip {
    /// A flat disk: the centre of pressure moves towards the edge that is pressed harder.
    Flat {
        /// Radius of the disk, m.
        radius_m: f64,
    },
    /// A ball: the point of contact moves over it by `radius sin(tilt)`, whatever the force.
    Round {
        /// Radius of the ball, m.
        radius_m: f64,
    },
    /// A rim, such as the mouth of a cup: touches at its edge only.
    Ring {
        /// Radius of the rim, m.
        radius_m: f64,
    },
    /// A foam or a swab that gives: the centre of pressure lies anywhere within the radius.
    Soft {
        /// Radius of the area of contact, m.
        radius_m: f64,
    },
    /// Nothing is known, so nothing is concluded from the torque.
    #[default]
    Unknown,
}

impl Tip {
    /// Largest radius allowed, m.
    pub const RADIUS_MAX_M: f64 = 0.5;

    /// Radius, m; `None` for an unknown shape.
    pub fn radius_m(&self) -> Option<f64> {
        match *self {
            Self::Flat { radius_m }
            | Self::Round { radius_m }
            | Self::Ring { radius_m }
            | Self::Soft { radius_m } => Some(radius_m),
            Self::Unknown => None,
        }
    }

    /// Whether the radius, if there is one, is finite, not negative and at most
    /// [`Tip::RADIUS_MAX_M`].
    pub fn is_plausible(&self) -> bool {
        self.radius_m()
            .is_none_or(|radius_m| (0.0..=Self::RADIUS_MAX_M).contains(&radius_m))
    }

    /// Name of the shape, as in a cell file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Flat { .. } => "flat",
            Self::Round { .. } => "round",
            Self::Ring { .. } => "ring",
            Self::Soft { .. } => "soft",
            Self::Unknown => "unknown",
        }
    }

    /// Expected point of contact on a locally flat surface, tool axes, m. `normal_in_tool` is of
    /// unit length and points out of the material, so that it is `-z` for a tool square to the
    /// surface. Only a ball's point depends on it. That of the other shapes moves with the
    /// pressure, which the torque shows.
    pub fn contact_in_tool(&self, normal_in_tool: &Vector3<f64>) -> Vector3<f64> {
        match *self {
            Self::Round { radius_m } => -(normal_in_tool + Vector3::z()) * radius_m,
            Self::Flat { .. } | Self::Ring { .. } | Self::Soft { .. } | Self::Unknown => {
                Vector3::zeros()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_a_cell_file_says() {
        for (text, tip) in [
            (
                "shape = 'flat'\nradius_m = 0.01",
                Tip::Flat { radius_m: 0.01 },
            ),
            (
                "shape = 'round'\nradius_m = 0.005",
                Tip::Round { radius_m: 0.005 },
            ),
            (
                "shape = 'ring'\nradius_m = 0.02",
                Tip::Ring { radius_m: 0.02 },
            ),
            (
                "shape = 'soft'\nradius_m = 0.015",
                Tip::Soft { radius_m: 0.015 },
            ),
            ("shape = 'unknown'", Tip::Unknown),
        ] {
            let read: Tip = toml::from_str(text).unwrap();
            assert_eq!(read, tip);
            assert!(text.contains(read.name()));
        }
        assert!(toml::from_str::<Tip>("shape = 'pointed'").is_err());
        assert!(toml::from_str::<Tip>("shape = 'round'").is_err());
    }

    #[test]
    fn implausible_radii_are_told_apart() {
        assert!(Tip::Unknown.is_plausible() && Tip::Round { radius_m: 0.0 }.is_plausible());
        for radius_m in [-1e-3, f64::NAN, f64::INFINITY, 0.6] {
            assert!(!Tip::Flat { radius_m }.is_plausible(), "{radius_m}");
        }
    }

    #[test]
    fn a_ball_that_is_square_touches_at_its_foremost_point_and_one_on_its_side_at_its_equator() {
        let tip = Tip::Round { radius_m: 0.01 };
        assert_eq!(tip.contact_in_tool(&-Vector3::z()), Vector3::zeros());
        let side = tip.contact_in_tool(&Vector3::x());
        assert!((side - Vector3::new(-0.01, 0.0, -0.01)).norm() < 1e-15);
    }
}

//! Why a task is refused before anything moves, with the numbers.

use nalgebra::Vector3;
use serde::Serialize;

use crate::limits::Limits;

/// Beginning of every pre-flight refusal: trying again does not help.
pub const REFUSED: &str = "refused before anything moves: ";

/// A place of the path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Distance along the path from its start, m.
    pub way_m: f64,
    /// Coordinates in the path's plane, m.
    pub on_path_m: [f64; 2],
    /// Position in base axes, m.
    pub in_base_m: [f64; 3],
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ([x, y], base) = (self.on_path_m, Metres(self.in_base_m));
        write!(
            f,
            "{:.3} m along the path, at ({x:.3}, {y:.3}) m of its plane, {base} m in base axes",
            self.way_m
        )
    }
}

/// A side of the workspace box that is exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Edge {
    /// Axis of the base: `x`, `y` or `z`.
    pub axis: char,
    /// Coordinate of the tool's origin along that axis, m.
    pub value_m: f64,
    /// Limit of the box, m.
    pub limit_m: f64,
    /// Key of the limit in a cell file.
    pub key: &'static str,
}

impl Edge {
    /// The side of the workspace that `position` (base axes, m) exceeds most; `None` if it is
    /// inside.
    pub fn crossed(limits: &Limits, position: &Vector3<f64>) -> Option<Self> {
        let side = |i: usize, limit_m: f64, key| Self {
            axis: ['x', 'y', 'z'][i],
            value_m: position[i],
            limit_m,
            key,
        };
        (0..3)
            .flat_map(|i| {
                [
                    side(i, limits.workspace_min_m[i], "limits.workspace_min_m"),
                    side(i, limits.workspace_max_m[i], "limits.workspace_max_m"),
                ]
            })
            .filter(|edge| edge.beyond_m() > 0.0)
            .max_by(|a, b| a.beyond_m().total_cmp(&b.beyond_m()))
    }

    fn beyond_m(&self) -> f64 {
        let beyond = self.value_m - self.limit_m;
        if self.key == "limits.workspace_min_m" {
            -beyond
        } else {
            beyond
        }
    }
}

impl std::fmt::Display for Edge {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            axis,
            value_m,
            limit_m,
            key,
        } = self;
        write!(
            f,
            "{axis} = {value_m:.3} m is beyond {key} = {limit_m:.3} m"
        )
    }
}

/// One reason why a task is not started.
#[derive(Clone, Debug, PartialEq, Serialize, thiserror::Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Refusal {
    /// The requested force reaches or exceeds the force at which the arm retracts.
    #[error(
        "`{key}` is {reference_n} N, and the arm retracts at `limits.force_max_n` = {limit_n} N: press less, \
         or raise the cell's limit"
    )]
    Force {
        /// Key in the task.
        key: &'static str,
        /// Requested force, N.
        reference_n: f64,
        /// Force limit of the cell, N.
        limit_n: f64,
    },
    /// A speed of the task exceeds the law's limit.
    #[error(
        "`{key}` is {speed_m_per_s} m/s, and the law may move the tool at {limit_m_per_s:.4} m/s, its share of the cell's \
         limit on tool speed: ask for less, or raise the limit"
    )]
    Speed {
        /// Key in the task.
        key: &'static str,
        /// Requested speed, m/s.
        speed_m_per_s: f64,
        /// Speed limit of the cell, m/s.
        limit_m_per_s: f64,
    },
    /// The tool stands outside the workspace.
    #[error(
        "the tool stands outside the workspace, at {} m in base axes: {edge}; move the arm inside by hand, or correct the limit",
        Metres(*in_base_m)
    )]
    StartOutside {
        /// Tool's origin, base axes, m.
        in_base_m: [f64; 3],
        /// Side of the workspace that is exceeded.
        edge: Edge,
    },
    /// The approach does not go in the direction in which the tool points.
    #[error(
        "`approach.direction` is {:.0} degrees off the tool's z axis, and the tool touches with that axis first: turn the \
         tool, or correct the direction",
        angle_rad.to_degrees()
    )]
    ApproachBackwards {
        /// Angle between the approach and the tool's z axis, rad.
        angle_rad: f64,
    },
    /// The start pose or home is not one of this arm.
    #[error(
        "`{table}.joints_rad` has {joints} numbers, and the arm has {arm} joints: teach it on this arm"
    )]
    StartJoints {
        /// `start` or `home`.
        table: &'static str,
        /// Numbers given.
        joints: usize,
        /// Joints of the arm.
        arm: usize,
    },
    /// The start pose or home is beyond a joint's end stop.
    #[error(
        "`{table}.joints_rad`: joint {joint} is {angle_rad:.3} rad, and {lower_rad:.3} to {upper_rad:.3} rad is allowed"
    )]
    StartEndStop {
        /// `start` or `home`.
        table: &'static str,
        /// Number of the joint, from 1 at the base.
        joint: usize,
        /// Joint position given, rad.
        angle_rad: f64,
        /// Lower end stop with the safety margin, rad.
        lower_rad: f64,
        /// Upper end stop with the safety margin, rad.
        upper_rad: f64,
    },
    /// The way in joint space leaves the workspace.
    #[error(
        "the way to `{table}.joints_rad` leaves the workspace after {:.0} % of it, at {} m in base axes: {edge}; guide the \
         arm nearer to it by hand, or correct the limit",
        share * 100.0, Metres(*in_base_m)
    )]
    WayOutside {
        /// `start` or `home`.
        table: &'static str,
        /// First such place, as a share of the way, 0 to 1.
        share: f64,
        /// Tool's origin there, base axes, m.
        in_base_m: [f64; 3],
        /// Side of the workspace that is exceeded.
        edge: Edge,
    },
    /// The arm does not stand in the start pose, and its law does not move it there.
    #[error(
        "the arm stands {away_rad:.3} rad away from `start.joints_rad` (joint {joint}), and `start.tolerance_rad` is \
         {tolerance_rad} rad: this law does not move the arm in joint space; guide it there by hand"
    )]
    StartAway {
        /// Number of the joint that is furthest away, from 1 at the base.
        joint: usize,
        /// Its distance, rad.
        away_rad: f64,
        /// Allowed distance, rad.
        tolerance_rad: f64,
    },
    /// The path leaves the workspace.
    #[error(
        "the path leaves the workspace {at}: {edge}; shorten the path, start elsewhere, or correct the limit"
    )]
    Outside {
        /// First such place.
        at: Place,
        /// Side of the workspace that is exceeded.
        edge: Edge,
    },
    /// The arm cannot reach a place of the path.
    #[error(
        "the path is out of the arm's reach {at}: the tool stays {left_m:.3} m away in this posture; shorten the path, or \
         start nearer to the base"
    )]
    OutOfReach {
        /// First such place.
        at: Place,
        /// Remaining distance, m.
        left_m: f64,
    },
    /// A joint reaches its end stop on the path.
    #[error(
        "joint {joint} reaches its end stop {at}: {angle_rad:.3} rad, and {limit_rad:.3} rad is allowed; start from another posture"
    )]
    EndStop {
        /// First such place.
        at: Place,
        /// Number of the joint, from 1 at the base.
        joint: usize,
        /// Joint position required, rad.
        angle_rad: f64,
        /// End stop including the safety margin, rad.
        limit_rad: f64,
    },
    /// The arm comes to a singularity on the path.
    #[error(
        "the arm is nearly singular {at}: smallest singular value {smallest:.4}, at least {floor:.4} is needed; start \
         from another posture, or nearer to the base"
    )]
    Singular {
        /// First such place.
        at: Place,
        /// Smallest singular value of the Jacobian at the tool.
        smallest: f64,
        /// Minimum allowed singular value.
        floor: f64,
    },
}

impl Refusal {
    /// Place on the path; `None` for refusals that do not depend on the path.
    pub fn place(&self) -> Option<&Place> {
        match self {
            Self::Outside { at, .. }
            | Self::OutOfReach { at, .. }
            | Self::EndStop { at, .. }
            | Self::Singular { at, .. } => Some(at),
            Self::Force { .. }
            | Self::Speed { .. }
            | Self::StartOutside { .. }
            | Self::StartJoints { .. }
            | Self::StartEndStop { .. }
            | Self::WayOutside { .. }
            | Self::StartAway { .. }
            | Self::ApproachBackwards { .. } => None,
        }
    }
}

/// All refusals in one message; `None` if there are none.
pub fn words(refusals: &[Refusal]) -> Option<String> {
    if refusals.is_empty() {
        return None;
    }
    let each: Vec<String> = refusals.iter().map(ToString::to_string).collect();
    // A task that was feasible before a fault may no longer be so from the place where the fault
    // left the tool.
    let begins = if refusals.iter().any(|refusal| refusal.place().is_some()) {
        "; a path begins where the tool stands when the task starts"
    } else {
        ""
    };
    Some(format!("{REFUSED}{}{begins}", each.join("; also: ")))
}

/// Three coordinates, m.
struct Metres([f64; 3]);

impl std::fmt::Display for Metres {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "({x:.3}, {y:.3}, {z:.3})")
    }
}

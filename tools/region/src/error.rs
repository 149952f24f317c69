//! Errors of making a task of a mesh or a scan.

use tangent_control::ControlError;
use tangent_mechanics::{InverseKinematicsError, ModelError};

/// Why no task can be made. Each error says what to do.
#[derive(Debug, thiserror::Error)]
pub enum RegionError {
    /// The file cannot be read.
    #[error("{file}: {reason}")]
    File {
        /// Name of the file.
        file: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// The size of the mesh is not that of a part.
    #[error(
        "the mesh is {size_m:.3} m long, and allowed is 0.002 to 20 m: state the unit with --scale \
         (0.001 for millimetres, 0.0254 for inches)"
    )]
    Size {
        /// Longest side of the box around the mesh, m.
        size_m: f64,
    },
    /// Nothing is selected.
    #[error("no part of the surface is selected: {0}")]
    Nothing(String),
    /// The selected surface lies above itself, seen along the approach.
    #[error(
        "seen along the approach, the region lies above itself near ({:.4}, {:.4}, {:.4}) m in the base, \
         {apart_m:.4} m apart: select one side of the part with --seed and --angle-deg or with --facing, or choose \
         another --approach",
        .at_m[0], .at_m[1], .at_m[2]
    )]
    Overlap {
        /// Place in the base, m.
        at_m: [f64; 3],
        /// Distance along the approach, m.
        apart_m: f64,
    },
    /// The selected surface is too steep.
    #[error(
        "the region is {angle_deg:.0} degrees steep against the approach near ({:.4}, {:.4}, {:.4}) m in the base, and \
         allowed are {max_deg:.0}: choose another --approach, or select less with --angle-deg or --outline",
        .at_m[0], .at_m[1], .at_m[2]
    )]
    Steep {
        /// Place in the base, m.
        at_m: [f64; 3],
        /// Angle between the surface's normal and the approach, degrees.
        angle_deg: f64,
        /// Largest angle, degrees.
        max_deg: f64,
    },
    /// A number is out of its range.
    #[error("{option} is {value}: allowed is {allowed}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Value given.
        value: String,
        /// What is allowed.
        allowed: String,
    },
    /// Nothing is left for the tool's middle.
    #[error(
        "no place of the region is {margin_m:.4} m from its edges: choose a smaller --margin-m, or a larger region"
    )]
    Margin {
        /// Distance from the edges, m.
        margin_m: f64,
    },
    /// Three taught points do not fit the mesh.
    #[error("the points of --match do not give a pose: {0}")]
    Match(String),
    /// The arm cannot stand above the place where the task begins.
    #[error(
        "no start pose {clearance_m} m above ({:.4}, {:.4}, {:.4}) m in the base ({source}): check --frame, choose \
         another --touch or --clearance-m, or leave the start pose out with --no-start",
        .at_m[0], .at_m[1], .at_m[2]
    )]
    NoStart {
        /// Height above the place, m.
        clearance_m: f64,
        /// The place in the base, m.
        at_m: [f64; 3],
        /// Why.
        source: InverseKinematicsError,
    },
    /// The arm's model is not usable.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The task is not valid.
    #[error("the task that was made is refused: {0}")]
    Task(#[from] ControlError),
}

impl RegionError {
    pub(crate) fn option(
        option: &'static str,
        value: impl ToString,
        allowed: impl Into<String>,
    ) -> Self {
        Self::Option {
            option,
            value: value.to_string(),
            allowed: allowed.into(),
        }
    }
}

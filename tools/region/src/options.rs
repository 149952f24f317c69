//! What is asked for, and how fine a grid it needs.

use nalgebra::Vector2;
use tangent_control::Pattern;
use tangent_mechanics::{Flange, ModelData, Pose, Tool};

use crate::error::RegionError;
use crate::fill::NODES_PER_SPACING;
use crate::height_map::NODES_MAX;
use crate::patch::Selection;

/// How far around the region the mesh is looked at, m.
pub(crate) const AROUND_M: f64 = 0.04;

/// What a task of a region is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionOptions<'a> {
    /// Name of the task.
    pub name: &'a str,
    /// Where the region comes from, for a comment in the file.
    pub source: &'a str,
    /// Part of the mesh.
    pub selection: Selection,
    /// Direction of the approach in the base; `None`: against the mean normal of the region.
    pub approach: Option<[f64; 3]>,
    /// Direction in the base along which rows run, projected into the plane.
    pub rows_along: [f64; 3],
    /// Outline in the base, projected along the approach, m; `None`: all that is selected.
    pub outline_m: Option<Vec<[f64; 3]>>,
    /// Outlines of holes in the base, projected along the approach, m.
    pub holes_m: Vec<Vec<[f64; 3]>>,
    /// Pattern of the strokes.
    pub pattern: Pattern,
    /// Whether a raster has one more stroke along every edge, before its rows.
    pub edge_pass: bool,
    /// Radius of the tip's contact, m.
    pub radius_m: f64,
    /// Largest distance between strokes along the surface, m; `None`: the radius.
    pub spacing_m: Option<f64>,
    /// Distance of the strokes from every edge along the surface, m; `None`: the radius, or 0.4 of
    /// it with a dose.
    pub margin_m: Option<f64>,
    /// Where the tool touches down, in the base, m; `None`: beside the first stroke, or at its
    /// start.
    pub touch_m: Option<[f64; 3]>,
    /// Pressing force, N.
    pub force_n: f64,
    /// Speed along the surface, m/s.
    pub speed_m_per_s: f64,
    /// Least and most dose, N*s/cm²: the task gets `[coverage]`.
    pub dose_n_s_per_cm2: Option<[f64; 2]>,
    /// Height of the start pose above the place where the tool touches down, m.
    pub clearance_m: f64,
    /// The arm and its tool, for a start pose.
    pub arm: Option<(&'a ModelData, &'a Pose<Flange, Tool>)>,
}

/// Distance between the nodes of a grid for a region of this size, m.
pub(crate) fn cell_m(size: Vector2<f64>, spacing_m: f64) -> Result<f64, RegionError> {
    let size = size + Vector2::repeat(2.0 * AROUND_M);
    let finest = (spacing_m / (2.0 * NODES_PER_SPACING)).min(0.001);
    let cell_m = finest.max((size.x * size.y / NODES_MAX as f64).sqrt());
    if cell_m * NODES_PER_SPACING > spacing_m {
        return Err(RegionError::option(
            "--spacing-m",
            format!(
                "{spacing_m} with a region of {:.2} m by {:.2} m",
                size.x, size.y
            ),
            format!(
                "{:.4} m or more for this size: choose a wider spacing, or a part with --outline",
                cell_m * NODES_PER_SPACING
            ),
        ));
    }
    Ok(cell_m)
}

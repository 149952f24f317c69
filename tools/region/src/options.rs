//! What is asked for, and how fine a grid it needs.

use nalgebra::Vector2;
use tangent_control::Pattern;
use tangent_mechanics::{Flange, ModelData, Pose, Tool};

use crate::error::RegionError;
use crate::fill::NODES_PER_SPACING;
use crate::height_map::NODES_MAX;
use crate::patch::Selection;

/// Mean distance of the points that a cell needs, cells.
const POINTS_PER_CELL: f64 = 1.5;
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
    /// Pressing force of the strokes along the edges, N; `None`: that of all strokes. Those are the
    /// edge pass of a raster, and the outermost rings of a contour.
    pub edge_force_n: Option<f64>,
    /// Speed of the strokes along the edges, m/s; `None`: that of all strokes.
    pub edge_speed_m_per_s: Option<f64>,
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

/// Distance between the nodes of a grid over a region of this size whose points are `apart_m` from
/// each other, m; 0 for a mesh, which has a height everywhere.
///
/// # Errors
/// Strokes at this spacing need a finer grid than the size or the points allow.
pub(crate) fn cell_m(size: Vector2<f64>, spacing_m: f64, apart_m: f64) -> Result<f64, RegionError> {
    let around = size + Vector2::repeat(2.0 * AROUND_M);
    let finest_m = (spacing_m / (2.0 * NODES_PER_SPACING)).min(0.001);
    let for_size_m = (around.x * around.y / NODES_MAX as f64).sqrt();
    let for_points_m = POINTS_PER_CELL * apart_m;
    let cell_m = finest_m.max(for_size_m).max(for_points_m);
    let least_m = cell_m * NODES_PER_SPACING;
    if least_m <= spacing_m {
        return Ok(cell_m);
    }
    let why = if for_points_m > for_size_m {
        format!(
            "for points that are {apart_m:.4} m apart: choose a wider spacing, or scan the part from \
             nearer or from more places"
        )
    } else {
        format!(
            "for a region of {:.2} m by {:.2} m: choose a wider spacing, or a part with --outline",
            size.x, size.y
        )
    };
    Err(RegionError::option(
        "--spacing-m",
        spacing_m,
        format!("{least_m:.4} m or more {why}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spacing_is_refused_for_the_size_or_for_the_points_with_the_least_one() {
        let said = |size: f64, spacing_m: f64, apart_m: f64| {
            cell_m(Vector2::repeat(size), spacing_m, apart_m).map_err(|error| error.to_string())
        };
        assert_eq!(said(0.1, 0.01, 0.0).unwrap(), 0.001);
        assert_eq!(said(0.1, 0.01, 0.001).unwrap(), 0.0015);
        for (size, apart_m, words) in [
            (
                0.1,
                0.004,
                ["--spacing-m is 0.01", "0.0300 m or more", "0.0040 m apart"],
            ),
            (
                20.0,
                0.0,
                ["--spacing-m is 0.01", "m or more", "20.00 m by 20.00 m"],
            ),
        ] {
            let error = said(size, 0.01, apart_m).unwrap_err();
            for word in words {
                assert!(error.contains(word), "{word}: {error}");
            }
        }
    }
}

//! Where the tool touches down.

use nalgebra::Vector2;

use crate::error::RegionError;
use crate::height_map::HeightMap;

/// Distance from the first stroke, m: the tool explores the surface where it touches down, and the
/// force of that is not in the region.
const BESIDE_M: f64 = 0.025;
/// Least distance from the region, m.
const CLEAR_M: f64 = 0.018;
/// Radius within which there must be a surface, m.
const AROUND_M: f64 = 0.008;
/// Directions that are tried.
const DIRECTIONS: u32 = 24;
/// Least cosine between the surface there and the approach.
const COSINE_MIN: f64 = 0.7;

/// The place over the plane, m: as given, or beside `first`, the start of the first stroke, where
/// there is a surface outside the region, or else `first`.
pub(crate) fn touch(
    map: &HeightMap,
    first: Vector2<f64>,
    given_m: Option<[f64; 3]>,
) -> Result<Vector2<f64>, RegionError> {
    if let Some(given) = given_m {
        let at = map.plane.place(&given.into()).xy();
        if map.height_m(&at).is_none() {
            return Err(RegionError::option(
                "--touch",
                format!("{given:?}"),
                "a place over or within 40 mm of the region, in the base, m",
            ));
        }
        return Ok(at);
    }
    let beside = (0..DIRECTIONS).map(|k| {
        let angle = std::f64::consts::TAU * f64::from(k) / f64::from(DIRECTIONS);
        first + Vector2::new(angle.cos(), angle.sin()) * BESIDE_M
    });
    let good = |at: &Vector2<f64>| {
        let normal = map.normal(at, AROUND_M);
        let clear = (0..map.inside.len())
            .filter(|node| map.inside[*node])
            .all(|node| (map.place(node) - at).norm() > CLEAR_M);
        clear && normal.is_some_and(|n| n.z > COSINE_MIN)
    };
    Ok(beside.into_iter().find(good).unwrap_or(first))
}

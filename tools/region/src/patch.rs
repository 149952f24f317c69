//! The part of a mesh that becomes a region.

use std::collections::HashMap;

use nalgebra::{Unit, Vector3};

use tangent_control::fill::nearest_on;

use crate::error::RegionError;
use crate::mesh::Mesh;

/// What is selected of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Selection {
    /// Everything that faces the approach.
    All,
    /// From the triangle nearest to a place on, over all edges at which the surface turns by no
    /// more than an angle.
    Seed {
        /// The place in the base, m.
        at_m: [f64; 3],
        /// Largest angle between the normals of neighbouring triangles, rad.
        angle_rad: f64,
    },
    /// Triangles whose normal is within an angle of a direction in the base.
    Facing {
        /// The direction, out of the material.
        direction: [f64; 3],
        /// Largest angle, rad.
        angle_rad: f64,
    },
}

/// Indices of the triangles that are selected, in ascending order.
///
/// # Errors
/// Nothing is selected.
pub fn select(mesh: &Mesh, selection: &Selection) -> Result<Vec<usize>, RegionError> {
    let all = 0..mesh.triangles.len();
    let found: Vec<usize> = match selection {
        Selection::All => all.collect(),
        Selection::Facing {
            direction,
            angle_rad,
        } => {
            let direction = unit(direction, "--facing")?;
            all.filter(|i| mesh.normal(*i).dot(&direction) >= angle_rad.cos())
                .collect()
        }
        Selection::Seed { at_m, angle_rad } => grown(mesh, &Vector3::from(*at_m), *angle_rad),
    };
    if found.is_empty() {
        return Err(RegionError::Nothing(
            "no triangle faces there: check --frame, --scale and the directions of the triangles, \
             whose corners run counterclockwise seen from outside"
                .to_owned(),
        ));
    }
    Ok(found)
}

/// A unit vector from an option.
pub(crate) fn unit(
    direction: &[f64; 3],
    option: &'static str,
) -> Result<Vector3<f64>, RegionError> {
    Unit::try_new(Vector3::from(*direction), 1e-9)
        .filter(|d| d.iter().all(|x| x.is_finite()))
        .map(Unit::into_inner)
        .ok_or_else(|| {
            RegionError::option(
                option,
                format!("{direction:?}"),
                "a vector that is not zero",
            )
        })
}

/// Sum of the area vectors, m².
pub(crate) fn area_vector(mesh: &Mesh, patch: &[usize]) -> Vector3<f64> {
    patch.iter().map(|i| mesh.area_vector(*i)).sum()
}

fn grown(mesh: &Mesh, at: &Vector3<f64>, angle_rad: f64) -> Vec<usize> {
    let away = |index: &usize| distance_m(&mesh.corners(*index), at);
    let Some(seed) = (0..mesh.triangles.len()).min_by(|a, b| away(a).total_cmp(&away(b))) else {
        return Vec::new();
    };
    let mut beside: HashMap<(u32, u32), Vec<usize>> = HashMap::new();
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        for edge in edges(triangle) {
            beside.entry(edge).or_default().push(index);
        }
    }
    let mut taken = vec![false; mesh.triangles.len()];
    taken[seed] = true;
    let mut open = vec![seed];
    while let Some(index) = open.pop() {
        let normal = mesh.normal(index);
        for edge in edges(&mesh.triangles[index]) {
            for &next in beside.get(&edge).into_iter().flatten() {
                if !taken[next] && mesh.normal(next).dot(&normal) >= angle_rad.cos() {
                    taken[next] = true;
                    open.push(next);
                }
            }
        }
    }
    (0..taken.len()).filter(|i| taken[*i]).collect()
}

/// Edges of a triangle, without their direction.
pub(crate) fn edges(triangle: &[u32; 3]) -> [(u32, u32); 3] {
    let [a, b, c] = *triangle;
    [(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b)))
}

/// Distance of a place from a triangle, m: Ericson, Real-Time Collision Detection, 5.1.5, by the
/// nearest of its inside and its edges.
fn distance_m([a, b, c]: &[Vector3<f64>; 3], at: &Vector3<f64>) -> f64 {
    let normal = (b - a).cross(&(c - a)).normalize();
    let inside = [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(from, to)| (*to - *from).cross(&(at - *from)).dot(&normal) >= 0.0);
    if inside {
        return (at - a).dot(&normal).abs();
    }
    [(a, b), (b, c), (c, a)]
        .iter()
        .map(|(from, to)| (nearest_on(from, to, at) - at).norm())
        .fold(f64::INFINITY, f64::min)
}

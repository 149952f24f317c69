//! A task from a region of a mesh, or of the points of a scan.
//!
//! [`read`] reads an STL, PLY or OBJ file, [`Mesh::placed`] brings it into the base of the robot,
//! and [`draft()`] selects a part of it, fills it with strokes whose distances are measured along
//! the surface, and writes the task: the strokes over a plane, and the heights as a guess for
//! lifts, landings and coverage. `tangent region` calls them.

mod draft;
mod edge_distance;
mod error;
mod fill;
mod frame;
mod height_map;
mod isoline;
mod mesh;
mod options;
mod patch;
mod plane;
mod rows;
mod scan;
mod start_pose;
mod surface;
mod text;
mod touch;

pub use draft::{Draft, draft};
pub use error::RegionError;
pub use frame::{Match, from_matches, pose};
pub use height_map::HeightMap;
pub use mesh::{Mesh, MeshFrame, read};
pub use options::RegionOptions;
pub use patch::{Selection, select};
pub use plane::TaskPlane;

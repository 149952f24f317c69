//! Surfaces to press on: signed distance, closest point, outward normal and curvature, in base
//! axes.
//!
//! Each shape has its own file and its own frame; [`Surface`] places one in the arm's base. The
//! plant uses surfaces for contact; tests and figures use them for the true normal.

mod any_shape;
mod cone;
mod config;
mod cylinder;
mod ellipsoid;
mod graph;
mod height_field;
mod plane;
mod profile;
mod ray;
mod shape;
mod sheet;
mod sphere;
mod surface;
mod torus;
mod wave;

pub use cone::Cone;
pub use config::{ShapeConfig, SurfaceConfig, SurfaceError};
pub use cylinder::Cylinder;
pub use ellipsoid::Ellipsoid;
pub use height_field::{HeightField, HeightFieldError};
pub use plane::Plane;
pub use profile::Profile;
pub use ray::Ray;
pub use shape::{FACES_MAX, FacesAround, Shape};
pub use sheet::Sheet;
pub use sphere::Sphere;
pub use surface::{Surface, SurfacePoint};
pub use torus::Torus;
pub use wave::Wave;

#[cfg(test)]
mod tests;

//! Surfaces to press on: signed distance, closest point, outward normal and curvature, in base
//! axes.
//!
//! Each shape has its own file and its own frame; [`Surface`] places one in the arm's base. The
//! plant uses surfaces for contact; tests and figures use them for the true normal.

mod cone;
mod cylinder;
mod ellipsoid;
mod graph;
mod height_field;
mod plane;
mod profile;
mod ray;
mod sheet;
mod sphere;
mod torus;
mod wave;

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

pub use cone::Cone;
pub use cylinder::Cylinder;
pub use ellipsoid::Ellipsoid;
pub use height_field::{HeightField, HeightFieldError};
pub use plane::Plane;
pub use profile::Profile;
pub use ray::Ray;
pub use sheet::Sheet;
pub use sphere::Sphere;
pub use torus::Torus;
pub use wave::Wave;

use crate::pose_config::PoseConfig;

/// The surface and its pose.
///
/// ```
/// use tangent_simulation::{ShapeConfig, SurfaceConfig};
///
/// let text = "shape = 'cylinder'\nradius_m = 0.25\nposition_m = [0.45, 0.0, 0.0]";
/// let pipe: SurfaceConfig = toml::from_str(text)?;
/// assert_eq!(pipe.shape, ShapeConfig::Cylinder { radius_m: 0.25 });
/// assert_eq!(pipe.roll_pitch_yaw_rad, [0.0; 3]);
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceConfig {
    /// `base_from_surface`: origin, m.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// `base_from_surface`: rotations about the fixed x, then y, then z axis, rad.
    #[serde(default)]
    pub roll_pitch_yaw_rad: [f64; 3],
    /// Shape and dimensions.
    #[serde(flatten)]
    pub shape: ShapeConfig,
}

impl SurfaceConfig {
    /// `base_from_surface`.
    pub fn pose(&self) -> PoseConfig {
        PoseConfig {
            position_m: self.position_m,
            roll_pitch_yaw_rad: self.roll_pitch_yaw_rad,
        }
    }
}

/// Local geometry of the surface at the point closest to a query point, in the axes of the query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Signed distance, m: negative inside the material.
    pub distance: f64,
    /// Closest point of the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal at that point, out of the material.
    pub normal: Vector3<f64>,
    /// Shape operator at that point, 1/m: moving by `dp` on the surface turns the normal by
    /// `curvature * dp`. Symmetric, zero along the normal, positive eigenvalues for a convex body.
    pub curvature: Matrix3<f64>,
}

/// Faces of a shape that a ball can touch at the same time.
pub const FACES_MAX: usize = 3;

/// Signed distance (m) and unit normal of each face around a point; `None` where a face has no
/// point closest to it. A face keeps its place in the list.
pub type FacesAround = [Option<(f64, Vector3<f64>)>; FACES_MAX];

/// Geometry that every shape provides, in its own frame, m.
pub trait Shape {
    /// Signed distance and the unit normal at the closest point.
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>);

    /// Shape operator at the closest point, 1/m.
    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64>;

    /// The first `t` within `range` at which the ray is inside the material; the start of `range`
    /// if the ray is already inside there. The default is sphere tracing; shapes may override it
    /// with a faster method.
    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        ray::march(ray, range, |p| self.distance_and_normal(p).0)
    }
}

/// Shape and dimensions; the tagged form of the `[plant.surface]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case", deny_unknown_fields)]
pub enum ShapeConfig {
    /// Half space below `z = 0`. With braces, so that unknown keys are refused.
    Plane {},
    /// Infinite cylinder around the local z axis.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
    },
    /// Cone around the local z axis with its base at `z = 0` and its tip at `z = height_m`.
    Cone {
        /// Height of the tip over the base, m.
        height_m: f64,
        /// Radius at `z = 0`, m.
        base_radius_m: f64,
    },
    /// Sphere around the origin.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// Ellipsoid around the origin.
    Ellipsoid {
        /// Semi-axes along x, y and z, m.
        semi_axes_m: [f64; 3],
    },
    /// A plate with its top at `z = 0` that ends at `x = 0`.
    Edge {
        /// Radius of the edge, m.
        edge_radius_m: f64,
    },
    /// `z = 0` before `x = 0`, `z = height_m` beyond.
    Step {
        /// Height, m; negative steps down.
        height_m: f64,
        /// Radius of the edge, m.
        edge_radius_m: f64,
    },
    /// A plane `z = 0` with a straight groove around `x = 0`: a seam, or a gap.
    Groove {
        /// Width, m.
        width_m: f64,
        /// Depth, m.
        depth_m: f64,
        /// Radius of the edges, m.
        edge_radius_m: f64,
    },
    /// Torus around the local z axis.
    Torus {
        /// Distance from the axis to the middle of the tube, m.
        major_radius_m: f64,
        /// Radius of the tube, m.
        minor_radius_m: f64,
    },
    /// `z = a_x sin(2 pi x / l_x) + a_y sin(2 pi y / l_y)`.
    Sheet {
        /// `[a_x, a_y]`, m.
        amplitude_m: [f64; 2],
        /// `[l_x, l_y]`, m.
        wavelength_m: [f64; 2],
    },
    /// `z = a sin(2 pi y / l + phase) + offset` over a rectangle around the origin, with vertical
    /// sides.
    Wave {
        /// `a`, m.
        amplitude_m: f64,
        /// `l`, m.
        wavelength_m: f64,
        /// Phase, rad.
        phase_rad: f64,
        /// Offset, m.
        offset_m: f64,
        /// Size along x and y, m.
        size_m: [f64; 2],
    },
    /// A table of heights, interpolated by a cubic spline.
    HeightField {
        /// The table as CSV text: first row `,x0,x1,…`, then `y0,z00,z01,…` (m). Either this or
        /// `csv_file`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        csv: Option<String>,
        /// Name of a file with that text, read when the scenario is loaded.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        csv_file: Option<String>,
    },
}

/// Error in the shape or dimensions of a surface.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// A dimension is not a positive, finite length.
    #[error("surface {shape}: `{key}` is {value}, but must be a positive length in metres{advice}")]
    Dimension {
        /// Name of the shape.
        shape: &'static str,
        /// Key of the dimension.
        key: &'static str,
        /// Value given.
        value: f64,
        /// Additional advice; may be empty.
        advice: &'static str,
    },
    /// The table of heights is malformed.
    #[error("surface height_field: {0}")]
    HeightField(#[from] HeightFieldError),
    /// The table of heights was not loaded.
    #[error(
        "surface height_field: give the table as `csv`, or load the file named in `csv_file` first"
    )]
    HeightFieldMissing,
}

#[derive(Clone, Debug)]
enum AnyShape {
    Plane(Plane),
    Cylinder(Cylinder),
    Cone(Cone),
    Sphere(Sphere),
    Ellipsoid(Ellipsoid),
    Profile(Profile),
    Torus(Torus),
    Sheet(Sheet),
    Wave(Wave),
    HeightField(HeightField),
}

impl AnyShape {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match self {
            Self::Plane(s) => s.distance_and_normal(point),
            Self::Cylinder(s) => s.distance_and_normal(point),
            Self::Cone(s) => s.distance_and_normal(point),
            Self::Sphere(s) => s.distance_and_normal(point),
            Self::Ellipsoid(s) => s.distance_and_normal(point),
            Self::Profile(s) => s.distance_and_normal(point),
            Self::Torus(s) => s.distance_and_normal(point),
            Self::Sheet(s) => s.distance_and_normal(point),
            Self::Wave(s) => s.distance_and_normal(point),
            Self::HeightField(s) => s.distance_and_normal(point),
        }
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        match self {
            Self::Plane(s) => s.curvature(point),
            Self::Cylinder(s) => s.curvature(point),
            Self::Cone(s) => s.curvature(point),
            Self::Sphere(s) => s.curvature(point),
            Self::Ellipsoid(s) => s.curvature(point),
            Self::Profile(s) => s.curvature(point),
            Self::Torus(s) => s.curvature(point),
            Self::Sheet(s) => s.curvature(point),
            Self::Wave(s) => s.curvature(point),
            Self::HeightField(s) => s.curvature(point),
        }
    }
}

impl AnyShape {
    fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
        match self {
            Self::Plane(s) => s.enter(ray, range),
            Self::Cylinder(s) => s.enter(ray, range),
            Self::Cone(s) => s.enter(ray, range),
            Self::Sphere(s) => s.enter(ray, range),
            Self::Ellipsoid(s) => s.enter(ray, range),
            Self::Profile(s) => s.enter(ray, range),
            Self::Torus(s) => s.enter(ray, range),
            Self::Sheet(s) => s.enter(ray, range),
            Self::Wave(s) => s.enter(ray, range),
            Self::HeightField(s) => s.enter(ray, range),
        }
    }
}

/// A shape placed in the arm's base.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_simulation::{PoseConfig, ShapeConfig, Surface};
///
/// let pose = PoseConfig { position_m: [0.4, 0.0, 0.0], ..PoseConfig::default() };
/// let ball = Surface::new(&ShapeConfig::Sphere { radius_m: 0.1 }, &pose)?;
///
/// // 20 mm above the top.
/// let found = ball.query(&Vector3::new(0.4, 0.0, 0.12));
/// assert!((found.distance - 0.02).abs() < 1e-12);
/// assert!((found.normal - Vector3::z()).norm() < 1e-12);
/// // The normal turns by 10 rad per metre along the surface, and not at all along itself.
/// assert!((found.curvature * Vector3::x() - Vector3::new(10.0, 0.0, 0.0)).norm() < 1e-9);
/// assert!((found.curvature * Vector3::z()).norm() < 1e-9);
/// # Ok::<(), tangent_simulation::surfaces::SurfaceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Surface {
    shape: AnyShape,
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
}

fn positive(shape: &'static str, key: &'static str, value: f64) -> Result<f64, SurfaceError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(SurfaceError::Dimension {
            shape,
            key,
            value,
            advice: "",
        })
    }
}

impl Surface {
    /// `pose` is `base_from_surface`.
    ///
    /// # Errors
    /// A dimension is not positive and finite, or the table of heights is malformed.
    pub fn new(shape: &ShapeConfig, pose: &PoseConfig) -> Result<Self, SurfaceError> {
        let shape = match shape {
            ShapeConfig::Plane {} => AnyShape::Plane(Plane),
            ShapeConfig::Cylinder { radius_m } => {
                AnyShape::Cylinder(Cylinder::new(positive("cylinder", "radius_m", *radius_m)?))
            }
            ShapeConfig::Cone {
                height_m,
                base_radius_m,
            } => AnyShape::Cone(Cone::new(
                positive("cone", "height_m", *height_m)?,
                positive("cone", "base_radius_m", *base_radius_m)?,
            )),
            ShapeConfig::Sphere { radius_m } => {
                AnyShape::Sphere(Sphere::new(positive("sphere", "radius_m", *radius_m)?))
            }
            ShapeConfig::Ellipsoid { semi_axes_m } => {
                for (axis, key) in ["semi_axes_m[0]", "semi_axes_m[1]", "semi_axes_m[2]"]
                    .into_iter()
                    .enumerate()
                {
                    positive("ellipsoid", key, semi_axes_m[axis])?;
                }
                AnyShape::Ellipsoid(Ellipsoid::new(*semi_axes_m))
            }
            ShapeConfig::Edge { edge_radius_m } => AnyShape::Profile(Profile::edge(positive(
                "edge",
                "edge_radius_m",
                *edge_radius_m,
            )?)),
            ShapeConfig::Step {
                height_m,
                edge_radius_m,
            } => {
                positive("step", "height_m (without its sign)", height_m.abs())?;
                positive("step", "edge_radius_m", *edge_radius_m)?;
                AnyShape::Profile(Profile::step(*height_m, *edge_radius_m))
            }
            ShapeConfig::Groove {
                width_m,
                depth_m,
                edge_radius_m,
            } => {
                positive("groove", "width_m", *width_m)?;
                positive("groove", "depth_m", *depth_m)?;
                positive("groove", "edge_radius_m", *edge_radius_m)?;
                AnyShape::Profile(Profile::groove(*width_m, *depth_m, *edge_radius_m))
            }
            ShapeConfig::Torus {
                major_radius_m,
                minor_radius_m,
            } => {
                let major = positive("torus", "major_radius_m", *major_radius_m)?;
                let minor = positive("torus", "minor_radius_m", *minor_radius_m)?;
                if minor >= major {
                    return Err(SurfaceError::Dimension {
                        shape: "torus",
                        key: "minor_radius_m",
                        value: minor,
                        advice: " smaller than `major_radius_m`",
                    });
                }
                AnyShape::Torus(Torus::new(major, minor))
            }
            ShapeConfig::Sheet {
                amplitude_m,
                wavelength_m,
            } => {
                positive("sheet", "wavelength_m[0]", wavelength_m[0])?;
                positive("sheet", "wavelength_m[1]", wavelength_m[1])?;
                AnyShape::Sheet(Sheet::new(*amplitude_m, *wavelength_m))
            }
            ShapeConfig::Wave {
                amplitude_m,
                wavelength_m,
                phase_rad,
                offset_m,
                size_m,
            } => {
                positive("wave", "amplitude_m", *amplitude_m)?;
                positive("wave", "wavelength_m", *wavelength_m)?;
                positive("wave", "size_m[0]", size_m[0])?;
                positive("wave", "size_m[1]", size_m[1])?;
                AnyShape::Wave(Wave::new(
                    *amplitude_m,
                    *wavelength_m,
                    *phase_rad,
                    *offset_m,
                    *size_m,
                ))
            }
            ShapeConfig::HeightField { csv, .. } => {
                let text = csv.as_deref().ok_or(SurfaceError::HeightFieldMissing)?;
                AnyShape::HeightField(HeightField::from_csv(text)?)
            }
        };
        let isometry = pose.isometry();
        Ok(Self {
            shape,
            rotation: isometry.rotation.to_rotation_matrix(),
            translation: isometry.translation.vector,
        })
    }

    /// Sets the surface's pose, `base_from_surface`.
    pub fn place(&mut self, pose: &nalgebra::Isometry3<f64>) {
        self.rotation = pose.rotation.to_rotation_matrix();
        self.translation = pose.translation.vector;
    }

    fn local(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.matrix().tr_mul(&(point - self.translation))
    }

    /// Transforms a ray from base axes to the surface's axes.
    pub fn ray_in_surface(&self, ray: &Ray) -> Ray {
        Ray {
            origin: self.local(&ray.origin),
            direction: self.rotation.matrix().tr_mul(&ray.direction),
        }
    }

    /// The first `t` within `range` at which a ray given in the surface's axes
    /// ([`Surface::ray_in_surface`]) is inside the material.
    pub fn enter(&self, ray_in_surface: &Ray, range: [f64; 2]) -> Option<f64> {
        self.shape.enter(ray_in_surface, range)
    }

    /// Signed distance (m) and unit normal at the closest point, base axes. It costs less than
    /// [`Surface::query`].
    pub fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (distance, normal) = self.shape.distance_and_normal(&self.local(point));
        (distance, self.rotation * normal)
    }

    /// Signed distance (m) and unit normal of each face around a point, base axes: more than one
    /// where an inner corner or a groove lets a ball touch two.
    pub fn faces_around(&self, point: &Vector3<f64>) -> FacesAround {
        let AnyShape::Profile(profile) = &self.shape else {
            return [Some(self.distance_and_normal(point)), None, None];
        };
        profile
            .faces_around(&self.local(point))
            .map(|face| face.map(|(distance, normal)| (distance, self.rotation * normal)))
    }

    /// Normal of the face that a tool is to follow at `point` (base axes, m): that of the plate
    /// where an edge, a step or a groove interrupts it, otherwise that of the closest point.
    pub fn face_normal(&self, point: &Vector3<f64>) -> Vector3<f64> {
        match self.shape {
            AnyShape::Profile(_) => self.rotation * Vector3::z(),
            _ => self.distance_and_normal(point).1,
        }
    }

    /// Whether [`Surface::face_normal`] is everywhere the normal of the closest point.
    fn is_smooth(&self) -> bool {
        !matches!(self.shape, AnyShape::Profile(_))
    }

    /// Geometry of the face that a tool is to follow at `point` (base axes, m): as
    /// [`Surface::query`], with the normal of [`Surface::face_normal`].
    pub(crate) fn query_face(&self, point: &Vector3<f64>) -> SurfacePoint {
        let under = self.query(point);
        if self.is_smooth() {
            return under;
        }
        SurfacePoint {
            normal: self.face_normal(point),
            curvature: Matrix3::zeros(),
            ..under
        }
    }

    /// Geometry at the surface point closest to `point` (base axes, m).
    pub fn query(&self, point: &Vector3<f64>) -> SurfacePoint {
        let local = self.local(point);
        let (distance, normal) = self.shape.distance_and_normal(&local);
        let curvature = self.shape.curvature(&local);
        let normal = self.rotation * normal;
        SurfacePoint {
            distance,
            point: point - normal * distance,
            normal,
            curvature: self.rotation.matrix() * curvature * self.rotation.matrix().transpose(),
        }
    }
}

#[cfg(test)]
mod tests;

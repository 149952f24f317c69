//! Any of the shapes, made from its configuration.

use nalgebra::{Matrix3, Vector3};

use super::cone::Cone;
use super::config::{ShapeConfig, SurfaceError};
use super::cylinder::Cylinder;
use super::ellipsoid::Ellipsoid;
use super::height_field::HeightField;
use super::plane::Plane;
use super::profile::Profile;
use super::ray::Ray;
use super::shape::Shape;
use super::sheet::Sheet;
use super::sphere::Sphere;
use super::torus::Torus;
use super::wave::Wave;

/// One of the shapes.
#[derive(Clone, Debug)]
pub(super) enum AnyShape {
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
    /// The shape with these dimensions.
    ///
    /// # Errors
    /// A dimension is not positive and finite, or the table of heights is malformed.
    pub fn new(shape: &ShapeConfig) -> Result<Self, SurfaceError> {
        Ok(match shape {
            ShapeConfig::Plane {} => Self::Plane(Plane),
            ShapeConfig::Cylinder { radius_m } => {
                Self::Cylinder(Cylinder::new(positive("cylinder", "radius_m", *radius_m)?))
            }
            ShapeConfig::Cone {
                height_m,
                base_radius_m,
            } => Self::Cone(Cone::new(
                positive("cone", "height_m", *height_m)?,
                positive("cone", "base_radius_m", *base_radius_m)?,
            )),
            ShapeConfig::Sphere { radius_m } => {
                Self::Sphere(Sphere::new(positive("sphere", "radius_m", *radius_m)?))
            }
            ShapeConfig::Ellipsoid { semi_axes_m } => {
                for (axis, key) in ["semi_axes_m[0]", "semi_axes_m[1]", "semi_axes_m[2]"]
                    .into_iter()
                    .enumerate()
                {
                    positive("ellipsoid", key, semi_axes_m[axis])?;
                }
                Self::Ellipsoid(Ellipsoid::new(*semi_axes_m))
            }
            ShapeConfig::Edge { edge_radius_m } => Self::Profile(Profile::edge(positive(
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
                Self::Profile(Profile::step(*height_m, *edge_radius_m))
            }
            ShapeConfig::Groove {
                width_m,
                depth_m,
                edge_radius_m,
            } => {
                positive("groove", "width_m", *width_m)?;
                positive("groove", "depth_m", *depth_m)?;
                positive("groove", "edge_radius_m", *edge_radius_m)?;
                Self::Profile(Profile::groove(*width_m, *depth_m, *edge_radius_m))
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
                Self::Torus(Torus::new(major, minor))
            }
            ShapeConfig::Sheet {
                amplitude_m,
                wavelength_m,
            } => {
                positive("sheet", "wavelength_m[0]", wavelength_m[0])?;
                positive("sheet", "wavelength_m[1]", wavelength_m[1])?;
                Self::Sheet(Sheet::new(*amplitude_m, *wavelength_m))
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
                Self::Wave(Wave::new(
                    *amplitude_m,
                    *wavelength_m,
                    *phase_rad,
                    *offset_m,
                    *size_m,
                ))
            }
            ShapeConfig::HeightField { csv, .. } => {
                let text = csv.as_deref().ok_or(SurfaceError::HeightFieldMissing)?;
                Self::HeightField(HeightField::from_csv(text)?)
            }
        })
    }

    pub fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
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

    pub fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
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

    pub fn enter(&self, ray: &Ray, range: [f64; 2]) -> Option<f64> {
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

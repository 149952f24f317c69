//! A shape placed in the arm's base.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::any_shape::AnyShape;
use super::config::{ShapeConfig, SurfaceError};
use super::ray::Ray;
use super::shape::FacesAround;
use crate::pose_config::PoseConfig;

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

impl Surface {
    /// `pose` is `base_from_surface`.
    ///
    /// # Errors
    /// A dimension is not positive and finite, or the table of heights is malformed.
    pub fn new(shape: &ShapeConfig, pose: &PoseConfig) -> Result<Self, SurfaceError> {
        let shape = AnyShape::new(shape)?;
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

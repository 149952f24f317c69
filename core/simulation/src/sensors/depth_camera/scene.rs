//! Scene in front of the depth camera: the surface, its bounds and the table around it. The tool is
//! added to the image later.

use nalgebra::{Isometry3, Vector3};

use crate::surfaces::{Ray, Surface};

/// Depth at which rays start, m.
const NEAR_M: f64 = 0.02;

/// The scene seen from one camera pose, for rays in camera axes.
pub struct Scene<'a> {
    surface: &'a Surface,
    extent_m: Option<[[f64; 3]; 2]>,
    far_m: f64,
    base_from_camera: Isometry3<f64>,
    table_height_m: Option<f64>,
}

/// Object that a ray hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thing {
    /// Nothing within reach.
    Nothing,
    /// The surface itself.
    Surface,
    /// A bounding plane of the surface.
    Cut,
    /// The table.
    Table,
}

impl<'a> Scene<'a> {
    /// As [`super::DepthCameraConfig`] has it; rays end at `far_m`.
    pub fn new(
        surface: &'a Surface,
        base_from_camera: Isometry3<f64>,
        extent_m: Option<[[f64; 3]; 2]>,
        table_height_m: Option<f64>,
        far_m: f64,
    ) -> Self {
        Self {
            surface,
            extent_m,
            far_m,
            base_from_camera,
            table_height_m,
        }
    }

    /// Object that the ray through `[x/z, y/z]` hits, and its depth along the optical axis, m.
    pub fn cast(&self, through: [f64; 2]) -> (Thing, f64) {
        let ray = Ray {
            origin: self.base_from_camera.translation.vector,
            direction: self.base_from_camera.rotation * Vector3::new(through[0], through[1], 1.0),
        };
        let mut found = (Thing::Nothing, self.far_m);
        if let Some((thing, depth)) = self.surface(&ray) {
            found = (thing, depth);
        }
        if let Some(height) = self.table_height_m {
            let depth = (height - ray.origin.z) / ray.direction.z;
            if depth > NEAR_M && depth < found.1 {
                found = (Thing::Table, depth);
            }
        }
        found
    }

    fn surface(&self, ray: &Ray) -> Option<(Thing, f64)> {
        let local = self.surface.ray_in_surface(ray);
        let range = match &self.extent_m {
            None => [NEAR_M, self.far_m],
            Some(extent) => within(&local, extent, [NEAR_M, self.far_m])?,
        };
        let depth = self.surface.enter(&local, range)?;
        let cut = depth == range[0] && range[0] > NEAR_M;
        Some((if cut { Thing::Cut } else { Thing::Surface }, depth))
    }

    /// Unit normal at the point hit, camera axes, out of the material: of the surface, or of the
    /// table if the ray hit the table.
    pub fn normal(&self, through: [f64; 2], met: (Thing, f64)) -> Option<Vector3<f64>> {
        let in_base = match met.0 {
            Thing::Nothing | Thing::Cut => return None,
            Thing::Table => Vector3::z(),
            Thing::Surface => {
                let point = Vector3::new(through[0], through[1], 1.0) * met.1;
                let at = self.base_from_camera * nalgebra::Point3::from(point);
                self.surface.distance_and_normal(&at.coords).1
            }
        };
        Some(self.base_from_camera.rotation.inverse() * in_base)
    }
}

/// The part of a ray inside a box.
fn within(ray: &Ray, [lower, upper]: &[[f64; 3]; 2], [from, to]: [f64; 2]) -> Option<[f64; 2]> {
    let (mut enter, mut leave) = (from, to);
    for axis in 0..3 {
        let (o, d) = (ray.origin[axis], ray.direction[axis]);
        if d == 0.0 {
            if o < lower[axis] || o > upper[axis] {
                return None;
            }
            continue;
        }
        let (one, two) = ((lower[axis] - o) / d, (upper[axis] - o) / d);
        enter = enter.max(one.min(two));
        leave = leave.min(one.max(two));
    }
    (enter <= leave).then_some([enter, leave])
}

//! Map ahead of the tool: the surface along a direction of travel, from the same frame, up to a
//! horizon.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use tangent_mechanics::{Base, Camera, Pose};

use super::image::Intrinsics;
use super::patch::{Ground, Patch, Place};

/// Largest number of stations of a map.
pub const STATIONS_MAX: usize = 64;

/// One station of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceStation {
    /// Distance from the tool along the surface, m.
    pub distance_m: f64,
    /// Point on the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material.
    pub normal: Vector3<f64>,
    /// Covariance of the normal, rad².
    pub covariance: Matrix3<f64>,
    /// Curvature along the direction of travel, 1/m, positive where the surface falls away: angle
    /// by which the normal turns forward per metre, rad.
    pub bend_per_m: f64,
    /// Standard deviation of the curvature, 1/m.
    pub bend_sd_per_m: f64,
}

/// Why a map ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AheadEnd {
    /// There is no direction of travel, or no surface at the tool.
    #[default]
    NotAsked,
    /// The map has reached the horizon, or its largest number of stations.
    Horizon,
    /// The next station is outside the image.
    OutOfImage,
    /// The surface ends, or is not visible further on.
    NotSeen,
}

/// The map: in camera axes as computed, in base axes after [`SurfaceAhead::in_base`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceAhead {
    /// Stations, from the tool on.
    pub stations: ArrayVec<SurfaceStation, STATIONS_MAX>,
    /// Why the map ends after the last station.
    pub end: AheadEnd,
}

impl SurfaceAhead {
    /// Map in base axes; `base_from_camera` is the pose at the time of exposure.
    pub fn in_base(&self, base_from_camera: &Pose<Base, Camera>) -> Self {
        let to: &Isometry3<f64> = base_from_camera.isometry();
        let turn = to.rotation.to_rotation_matrix();
        let mut map = self.clone();
        for station in &mut map.stations {
            station.point = (to * Point3::from(station.point)).coords;
            station.normal = turn * station.normal;
            station.covariance = turn.matrix() * station.covariance * turn.matrix().transpose();
        }
        map
    }

    /// Interpolated station at a distance along the surface, m; `None` beyond the ends.
    pub fn at(&self, distance_m: f64) -> Option<SurfaceStation> {
        let after = self
            .stations
            .iter()
            .position(|s| s.distance_m >= distance_m)?;
        let b = self.stations[after];
        if after == 0 {
            return (b.distance_m == distance_m).then_some(b);
        }
        let a = self.stations[after - 1];
        let share = (distance_m - a.distance_m) / (b.distance_m - a.distance_m);
        let mix = |x: f64, y: f64| x + (y - x) * share;
        Some(SurfaceStation {
            distance_m,
            point: a.point.lerp(&b.point, share),
            normal: a.normal.lerp(&b.normal, share).normalize(),
            covariance: a.covariance * (1.0 - share) + b.covariance * share,
            bend_per_m: mix(a.bend_per_m, b.bend_per_m),
            bend_sd_per_m: mix(a.bend_sd_per_m, b.bend_sd_per_m),
        })
    }
}

/// Computes the map, starting with the patch at the tool, along `travel` (camera axes).
pub(super) fn look_ahead(
    ground: &Ground<'_>,
    intrinsics: &Intrinsics,
    size_px: [usize; 2],
    tool: &Patch,
    body: u16,
    travel: &Vector3<f64>,
) -> SurfaceAhead {
    let mut map = SurfaceAhead::default();
    let step = ground.config.ahead_step_m;
    let mut patch = *tool;
    let mut distance = 0.0;
    loop {
        let Some((station, onward)) = station(&patch, distance, travel) else {
            map.end = AheadEnd::NotSeen;
            return map;
        };
        map.stations.push(station);
        if distance + step > ground.config.ahead_m + 1e-9 || map.stations.is_full() {
            map.end = AheadEnd::Horizon;
            return map;
        }
        // Along a circle with the curvature of the surface at this station.
        let fall = station.normal * (0.5 * station.bend_per_m * step * step);
        let guess = Place {
            point: station.point + onward * step - fall,
            normal: (station.normal + onward * (station.bend_per_m * step)).normalize(),
            shape: patch.place.shape,
        };
        // If the patch extends beyond the image, that is why it fails.
        let [inside, clear] =
            [0.0, tool.radius_m].map(|r| in_image(intrinsics, size_px, &guess.point, r));
        let next = if inside {
            ground.patch(&guess, body, tool.radius_m).ok()
        } else {
            None
        };
        // A surface far from the predicted point is a different one.
        let next = next.filter(|next| (next.place.point - guess.point).norm() < 0.5 * step);
        let Some(next) = next else {
            map.end = if clear {
                AheadEnd::NotSeen
            } else {
                AheadEnd::OutOfImage
            };
            return map;
        };
        patch = next;
        distance += step;
    }
}

/// Whether a ball around a point lies within the image.
fn in_image(
    intrinsics: &Intrinsics,
    size_px: [usize; 2],
    point: &Vector3<f64>,
    radius_m: f64,
) -> bool {
    let focal = [intrinsics.fx_px, intrinsics.fy_px];
    intrinsics.project(point).is_some_and(|px| {
        (0..2).all(|i| {
            let reach = focal[i] * radius_m / point.z;
            px[i] >= reach && px[i] <= size_px[i] as f64 - 1.0 - reach
        })
    })
}

/// Station at the middle of a patch, and the direction of travel within the surface.
fn station(
    patch: &Patch,
    distance_m: f64,
    travel: &Vector3<f64>,
) -> Option<(SurfaceStation, Vector3<f64>)> {
    let along = patch.frame.project(travel).try_normalize(1e-6)?;
    // Weights of xx, xy and yy of the shape in the curvature along this direction.
    let by = Vector3::new(
        along.x * along.x,
        2.0 * along.x * along.y,
        along.y * along.y,
    );
    Some((
        SurfaceStation {
            distance_m,
            point: patch.place.point,
            normal: patch.place.normal,
            covariance: patch.frame.lift_matrix(&patch.covariance),
            bend_per_m: along.dot(&(patch.shape * along)),
            bend_sd_per_m: by.dot(&(patch.shape_covariance * by)).max(0.0).sqrt(),
        },
        patch.frame.lift(&along),
    ))
}

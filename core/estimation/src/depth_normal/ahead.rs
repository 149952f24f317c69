//! The map ahead of the tool: where the surface goes along a direction of travel, from the same frame, up to a horizon.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use tangent_mechanics::{Base, Camera, Pose};

use super::image::Intrinsics;
use super::patch::{Ground, Patch};

/// Stations of a map, at most.
pub const STATIONS_MAX: usize = 64;

/// One station of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceStation {
    /// Along the surface from the tool, m.
    pub distance_m: f64,
    /// On the surface, m.
    pub point: Vector3<f64>,
    /// Unit normal, out of the material.
    pub normal: Vector3<f64>,
    /// Of the normal, rad².
    pub covariance: Matrix3<f64>,
    /// Bend along the direction of travel, 1/m, positive where the surface falls away: the normal turns forward by this per metre.
    pub bend_per_m: f64,
    /// Standard deviation of the bend, 1/m.
    pub bend_sd_per_m: f64,
}

/// Why a map ends where it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AheadEnd {
    /// No direction of travel, or no surface at the tool.
    #[default]
    NotAsked,
    /// As far as was asked.
    Horizon,
    /// The image ends.
    OutOfImage,
    /// The surface ends, or is not seen further on.
    NotSeen,
}

/// The map, in the axes of whoever holds it: the camera's from the step, the base's after [`SurfaceAhead::in_base`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceAhead {
    /// From the tool on.
    pub stations: ArrayVec<SurfaceStation, STATIONS_MAX>,
    /// Why there are no more.
    pub end: AheadEnd,
}

impl SurfaceAhead {
    /// The same in base axes; `base_from_camera` of the time of exposure.
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

    /// Between the stations, at a distance along the surface, m; none beyond the ends.
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

/// From the patch at the tool along `travel` (camera axes).
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
        // Along the circle that bends as the surface does here.
        let guess = station.point + onward * step
            - station.normal * (0.5 * station.bend_per_m * step * step);
        let Some([u, v]) = intrinsics.project(&guess) else {
            map.end = AheadEnd::OutOfImage;
            return map;
        };
        let inside =
            u >= 0.0 && v >= 0.0 && u <= size_px[0] as f64 - 1.0 && v <= size_px[1] as f64 - 1.0;
        if !inside {
            map.end = AheadEnd::OutOfImage;
            return map;
        }
        let next = ground.patch(intrinsics.sight(u, v), guess.z, body, tool.radius_m);
        match next {
            // A surface that is not where it was going to be is another one.
            Ok(next) if (1.0 / next.at.w - guess.z).abs() < step => patch = next,
            _ => {
                map.end = AheadEnd::NotSeen;
                return map;
            }
        }
        distance += step;
    }
}

/// What a patch says at its middle, and the direction of travel within the surface.
fn station(
    patch: &Patch,
    distance_m: f64,
    travel: &Vector3<f64>,
) -> Option<(SurfaceStation, Vector3<f64>)> {
    let (point, normal) = (patch.at.point()?, patch.at.normal()?);
    let onward = (travel - normal * normal.dot(travel)).try_normalize(1e-6)?;
    let bend_per_m = onward.dot(&(patch.at.curvature()? * onward));
    Some((
        SurfaceStation {
            distance_m,
            point,
            normal,
            covariance: patch.at.normal_covariance(&patch.covariance),
            bend_per_m,
            bend_sd_per_m: patch.bend_sd(&onward),
        },
        onward,
    ))
}

impl Patch {
    /// Standard deviation of the bend along a tangent, 1/m, from that of the second derivatives.
    fn bend_sd(&self, along: &Vector3<f64>) -> f64 {
        let [a, b] = self.at.sight;
        let (x, y) = (along.x - a * along.z, along.y - b * along.z);
        let by = Vector3::new(x * x, 2.0 * x * y, y * y)
            * (self.at.w / self.at.gradient().norm().max(1e-12));
        by.dot(&(self.bend_covariance * by)).max(0.0).sqrt()
    }
}

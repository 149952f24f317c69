//! Contacts in closed form: a tool that slides in a raster over a plane, a pipe or a cone, with
//! exact normals.
#![allow(dead_code)]

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator};
use tangent_mechanics::{Pose, Twist, Wrench};
use tangent_sensing::Validity;

#[derive(Clone, Copy, Debug)]
pub enum Surface {
    Plane,
    /// Cylinder along x; radius, m.
    Cylinder(f64),
    /// Upright cone; half angle, rad, and distance from the apex to the start of the path, m.
    Cone(f64, f64),
}

impl Surface {
    /// Point and normal at two path lengths from the start, m.
    fn at(self, u: f64, w: f64) -> (Vector3<f64>, Vector3<f64>) {
        match self {
            Self::Plane => (Vector3::new(u, w, 0.0), Vector3::z()),
            Self::Cylinder(radius) => {
                let (sin, cos) = (w / radius).sin_cos();
                let n = Vector3::new(0.0, sin, cos);
                (Vector3::new(u, 0.0, 0.0) + n * radius, n)
            }
            Self::Cone(half, slant) => {
                let l = slant + u;
                let (sin, cos) = half.sin_cos();
                let (s, c) = (w / (slant * sin)).sin_cos();
                let p = Vector3::new(l * sin * c, l * sin * s, -l * cos);
                (p, Vector3::new(cos * c, cos * s, sin))
            }
        }
    }
}

/// Errors of the sensors.
#[derive(Clone, Copy, Debug)]
pub struct Flaws {
    pub noise_n: f64,
    pub drift_n: f64,
    pub drift_nm: f64,
    pub payload_n: f64,
}

impl Flaws {
    pub const NONE: Self = Self {
        noise_n: 0.0,
        drift_n: 0.0,
        drift_nm: 0.0,
        payload_n: 0.0,
    };
    pub const GAMMA: Self = Self {
        noise_n: 0.03,
        drift_n: 0.3,
        drift_nm: 0.01,
        payload_n: 0.2,
    };
}

#[derive(Clone, Copy, Debug)]
pub struct Trial {
    pub surface: Surface,
    pub flaws: Flaws,
    pub friction: f64,
    /// Tilt of the tool at touchdown, rad.
    pub tilt_rad: f64,
    pub duration_s: f64,
    /// Rotation of the whole world.
    pub world: UnitQuaternion<f64>,
    pub seed: u64,
}

impl Trial {
    pub fn new(surface: Surface, flaws: Flaws, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed ^ 0x5eed);
        Self {
            surface,
            flaws,
            friction: rng.random_range(0.1..0.6),
            tilt_rad: 0.1,
            duration_s: 30.0,
            world: UnitQuaternion::identity(),
            seed,
        }
    }

    /// Samples, each with the true normal and whether the tool touches.
    pub fn samples(&self) -> Vec<(ContactSample, Vector3<f64>, bool)> {
        const DT: f64 = 0.008;
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let mut unit = || Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)).normalize();
        let (drift, drift_torque): (Vector3<f64>, Vector3<f64>) = (unit(), unit());
        let tilt_axis = unit();
        let gravity = Vector3::new(0.0, 0.0, -1.0);
        let (p0, n0) = self.surface.at(0.0, 0.0);
        let tilt_axis = (tilt_axis - n0 * n0.dot(&tilt_axis)).normalize();
        let mut facing = Rotation3::from_scaled_axis(tilt_axis * self.tilt_rad) * n0;
        let approach = facing;
        let mut slide = Vector3::zeros();
        let mut out = Vec::new();
        let mut last: Option<(Vector3<f64>, Rotation3<f64>)> = None;
        let mut tare_rotation = Matrix3::identity();
        let (mut u, mut w) = (0.0, 0.0);
        for k in 0..(self.duration_s / DT) as usize {
            let t = k as f64 * DT;
            let (du, dw) = raster(t - 1.5);
            u += du * DT;
            w += dw * DT;
            let (point, normal) = if t < 1.5 {
                (p0, n0)
            } else {
                self.surface.at(u, w)
            };
            // Half a second of approach, then the force rises within 0.3 s.
            let load = 3.0 * ((t - 0.5) / 0.3).clamp(0.0, 1.0);
            let position = point - normal * (2e-4 * load) + approach * (0.005 * (0.5 - t)).max(0.0);
            if t > 0.8 {
                facing = (facing + (normal - facing) * (DT / 0.4)).normalize();
            }
            let z = -facing;
            let x = (Vector3::x() - z * z.x).normalize();
            let rotation =
                Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
            let (velocity, angular) =
                last.map_or((Vector3::zeros(), Vector3::zeros()), |(p, r)| {
                    (
                        (position - p) / DT,
                        UnitQuaternion::from_rotation_matrix(&(rotation * r.inverse()))
                            .scaled_axis()
                            / DT,
                    )
                });
            last = Some((position, rotation));
            let tangential = velocity - normal * normal.dot(&velocity);
            let mut force = if tangential.norm() > 1e-3 && t > 1.5 {
                slide = tangential.normalize();
                (normal - slide * self.friction) * load
            } else if slide.norm() > 0.0 {
                (normal - slide * (0.7 * self.friction)) * load
            } else {
                // Sticking: friction balances the tangential approach force, inside the cone.
                let along = approach - normal * normal.dot(&approach);
                (normal + along * (self.friction / along.norm().max(self.friction))) * load
            };
            if k == 0 {
                tare_rotation = rotation.into_inner();
            }
            let warm = 1.0 - (-t / 10.0).exp();
            let bias = drift * (self.flaws.drift_n * warm)
                + (rotation.inverse() * gravity - tare_rotation.tr_mul(&gravity))
                    * self.flaws.payload_n;
            force = rotation.inverse() * force + bias;
            force += Vector3::from_fn(|_, _| {
                let noise: f64 = StandardNormal.sample(&mut rng);
                noise * self.flaws.noise_n
            });
            let torque = drift_torque * (self.flaws.drift_nm * warm);
            let turned = self.world * UnitQuaternion::from_rotation_matrix(&rotation);
            let twist = Twist::new(self.world * velocity, self.world * angular);
            out.push((
                ContactSample {
                    time_s: t,
                    dt_s: DT,
                    base_from_tool: Pose::new(self.world * position, turned),
                    twist,
                    twist_commanded: twist,
                    wrench: Wrench::new(force, torque),
                    wrench_delay_s: 0.0,
                    wrench_validity: Validity::Valid,
                    wrench_bias_age_s: Some(t),
                    base: None,
                },
                self.world * normal,
                load > 0.0,
            ));
        }
        out
    }

    pub fn run(&self, estimator: &mut dyn NormalEstimator) -> Figures {
        let mut figures = Figures::default();
        for (sample, normal, touching) in self.samples() {
            let estimate = estimator.update(&sample);
            if touching && estimate.validity != Validity::NoContact {
                figures.add(&estimate, &normal);
            }
        }
        figures
    }
}

/// Velocity along and across the path at a time since its start: 10 s per axis, with pauses,
/// gradual starts and stops.
fn raster(t: f64) -> (f64, f64) {
    if t < 0.0 {
        return (0.0, 0.0);
    }
    let leg = (t / 5.5) as usize;
    let inside = t - leg as f64 * 5.5;
    let speed = 0.02 * (inside.min(5.0 - inside) / 0.2).clamp(0.0, 1.0);
    match leg % 4 {
        0 => (speed, 0.0),
        2 => (-speed, 0.0),
        _ => (0.0, 0.6 * speed),
    }
}

#[derive(Clone, Debug, Default)]
pub struct Figures {
    pub errors_deg: Vec<f64>,
    pub nees: Vec<f64>,
}

impl Figures {
    fn add(&mut self, estimate: &NormalEstimate, normal: &Vector3<f64>) {
        let n = &estimate.normal;
        let angle = n.cross(normal).norm().atan2(n.dot(normal));
        self.errors_deg.push(angle.to_degrees());
        let error = normal - n * n.dot(normal);
        // The covariance is singular along the normal, so that direction is filled.
        let full = estimate.covariance + n * n.transpose();
        if let Some(inverse) = full.try_inverse() {
            self.nees.push(error.dot(&(inverse * error)) / 2.0);
        }
    }

    pub fn merge(&mut self, other: Self) {
        self.errors_deg.extend(other.errors_deg);
        self.nees.extend(other.nees);
    }

    pub fn mean_deg(&self) -> f64 {
        self.errors_deg.iter().sum::<f64>() / self.errors_deg.len() as f64
    }

    pub fn rmse_deg(&self) -> f64 {
        (self.errors_deg.iter().map(|e| e * e).sum::<f64>() / self.errors_deg.len() as f64).sqrt()
    }

    pub fn max_deg(&self) -> f64 {
        self.errors_deg.iter().copied().fold(0.0, f64::max)
    }

    pub fn nees_per_dof(&self) -> f64 {
        self.nees.iter().sum::<f64>() / self.nees.len() as f64
    }
}

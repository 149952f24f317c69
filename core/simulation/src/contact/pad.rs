//! The tool's pad: contact points on the surface, and their total wrench at the tool's origin.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Base, Pose, Tool};

use super::config::ContactConfig;
use super::friction::Friction;
use super::friction_variation::FrictionVariation;
use super::normal_force::HuntCrossley;
use crate::surfaces::{FACES_MAX, Surface};

/// A disk of contact points in the tool's xy plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PadConfig {
    /// Radius of the disk, m.
    pub radius_m: f64,
    /// Rings of points around the central one: ring `i` has `6 i` points. 0 is a single point.
    pub rings: usize,
    /// Whether only the outermost ring can touch.
    pub hollow: bool,
    /// Radius of the pad's crown, m: the rim is set back. The pad is flat if absent.
    pub crown_radius_m: Option<f64>,
}

impl Default for PadConfig {
    fn default() -> Self {
        Self {
            radius_m: 0.008,
            rings: 2,
            hollow: false,
            crown_radius_m: None,
        }
    }
}

/// Points of the disk, tool axes, m.
fn disk(pad: &PadConfig) -> Vec<Vector3<f64>> {
    let mut points = Vec::new();
    if !pad.hollow || pad.rings == 0 {
        points.push(Vector3::zeros());
    }
    for ring in 1..=pad.rings {
        if pad.hollow && ring < pad.rings {
            continue;
        }
        let radius = pad.radius_m * ring as f64 / pad.rings as f64;
        for i in 0..6 * ring {
            let angle =
                std::f64::consts::TAU * (i as f64 + 0.5 * (ring % 2) as f64) / (6 * ring) as f64;
            points.push(Vector3::new(
                radius * angle.cos(),
                radius * angle.sin(),
                0.0,
            ));
        }
    }
    if let Some(crown) = pad.crown_radius_m {
        for point in &mut points {
            point.z = -(point.x * point.x + point.y * point.y) / (2.0 * crown);
        }
    }
    points
}

/// Points of the pad with their bristles. The number of points is fixed after construction.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_mechanics::Pose;
/// use tangent_simulation::contact::{ContactConfig, Pad, PadConfig, PadMotion};
/// use tangent_simulation::{PoseConfig, ShapeConfig, Surface};
///
/// let table = Surface::new(&ShapeConfig::Plane {}, &PoseConfig::default())?;
/// let mut pad = Pad::new(&PadConfig::default(), &ContactConfig::default(), 5000.0);
///
/// // 1 mm deep in the table: 5000 N/m push back with 5 N.
/// let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
/// let motion = PadMotion::at_rest(&Pose::new(Vector3::new(0.0, 0.0, -0.001), down));
/// let contact = pad.step(&table, &motion, 0.001, None);
/// assert!((contact.wrench()[2] - 5.0).abs() < 1e-6);
/// # Ok::<(), tangent_simulation::surfaces::SurfaceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Pad {
    /// Positions of the points, tool axes, m; the centre of the ball for a round tip.
    points: Vec<Vector3<f64>>,
    /// One for each point; of a ball, one for each face.
    bristles: Vec<Vector3<f64>>,
    /// Radius of the ball around each point, m: that of a round tip, otherwise 0.
    ball_radius: f64,
    /// Height of the columns of a soft tip, which give along the tool's axis, m; 0: each point
    /// gives along the normal of the surface.
    column: f64,
    law: HuntCrossley,
    friction: Friction,
    friction_variation: Option<FrictionVariation>,
    reach: f64,
}

/// Pose and twist of the pad, base axes.
#[derive(Clone, Copy, Debug)]
pub struct PadMotion {
    /// Position of the tool's origin, m.
    pub origin: Vector3<f64>,
    /// `base_from_tool`.
    pub rotation: UnitQuaternion<f64>,
    /// Velocity of the tool's origin, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular: Vector3<f64>,
}

impl PadMotion {
    /// A pad at rest in a pose.
    pub fn at_rest(base_from_tool: &Pose<Base, Tool>) -> Self {
        Self::moving(base_from_tool, &Vector6::zeros())
    }

    /// Position of a point of the tool (tool axes, m), base axes, m.
    pub fn at(&self, point: &Vector3<f64>) -> Vector3<f64> {
        if *point == Vector3::zeros() {
            return self.origin;
        }
        self.origin + self.rotation * point
    }

    /// A pad in a pose, with the twist of the tool's origin, base axes, m/s and rad/s.
    pub fn moving(base_from_tool: &Pose<Base, Tool>, twist: &Vector6<f64>) -> Self {
        Self {
            origin: base_from_tool.translation(),
            rotation: base_from_tool.rotation(),
            linear: twist.fixed_rows::<3>(0).into_owned(),
            angular: twist.fixed_rows::<3>(3).into_owned(),
        }
    }
}

/// Effect of the surface on the pad, base axes, at the tool's origin.
#[derive(Clone, Copy, Debug)]
pub struct PadContact {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Torque, Nm.
    pub torque: Vector3<f64>,
    /// Sum of the points' normal forces, N.
    pub load: f64,
    /// Depth of the deepest point, m.
    pub depth: f64,
    /// Number of points that carry load.
    pub touching: usize,
}

impl PadContact {
    /// No contact.
    pub fn none() -> Self {
        Self {
            force: Vector3::zeros(),
            torque: Vector3::zeros(),
            load: 0.0,
            depth: 0.0,
            touching: 0,
        }
    }

    /// Force and torque, N and Nm.
    pub fn wrench(&self) -> Vector6<f64> {
        let (f, t) = (&self.force, &self.torque);
        Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
    }
}

/// Derivatives of the pad's wrench with respect to its motion, for an implicit step; base axes, at
/// the tool's origin.
#[derive(Clone, Copy, Debug)]
pub struct PadLinearisation {
    /// Minus the derivative with respect to displacement and small rotation.
    pub stiffness: Matrix6<f64>,
    /// Minus the derivative with respect to the twist.
    pub damping: Matrix6<f64>,
}

impl PadLinearisation {
    /// No contact.
    pub fn none() -> Self {
        Self {
            stiffness: Matrix6::zeros(),
            damping: Matrix6::zeros(),
        }
    }

    fn add(&mut self, arm: &Vector3<f64>, stiffness: &Matrix3<f64>, damping: &Matrix3<f64>) {
        // A point at `arm` moves by u + φ × arm = u - [arm] φ, and its force turns by arm × f =
        // [arm] f.
        let cross = arm.cross_matrix();
        for (sum, k) in [
            (&mut self.stiffness, stiffness),
            (&mut self.damping, damping),
        ] {
            let turned = k * -cross;
            let mut block = sum.fixed_view_mut::<3, 3>(0, 0);
            block += k;
            let mut block = sum.fixed_view_mut::<3, 3>(0, 3);
            block += turned;
            let mut block = sum.fixed_view_mut::<3, 3>(3, 0);
            block += cross * k;
            let mut block = sum.fixed_view_mut::<3, 3>(3, 3);
            block += cross * turned;
        }
    }
}

/// Height of a soft tip, m.
const COLUMN_M: f64 = 0.015;
/// Distance at which a column meets the surface, m, and most steps to find where.
const MEETS_M: f64 = 1e-7;
const STEPS_MAX: usize = 40;

/// Depth (negative, m) and normal of a column whose free end is at `end`, compressed by the surface
/// along its axis `out` (unit, out of the material), up to its whole `height` (m). The depth is
/// that along the normal of a surface flat across the column.
fn compressed(
    surface: &Surface,
    end: &Vector3<f64>,
    out: &Vector3<f64>,
    height: f64,
) -> (f64, Vector3<f64>) {
    let mut above = height;
    for _ in 0..STEPS_MAX {
        let (distance, normal) = surface.distance_and_normal(&(end + out * above));
        if distance < MEETS_M {
            return (-above * normal.dot(out).max(0.0), normal);
        }
        // No surface is nearer than its distance.
        above -= distance;
        if above <= 0.0 {
            return (0.0, normal);
        }
    }
    let (_, normal) = surface.distance_and_normal(&(end + out * above));
    (-above * normal.dot(out).max(0.0), normal)
}

impl Pad {
    /// `stiffness` is that of the whole pad, N/m, without the tool's compliance.
    pub fn new(pad: &PadConfig, contact: &ContactConfig, stiffness: f64) -> Self {
        Self::of_points(disk(pad), 0.0, contact, stiffness)
    }

    /// Soft columns along the tool's axis, an elastic foundation: a column over a gap reaches into
    /// it, and the depth of its neighbours does not move it sideways.
    pub fn soft(pad: &PadConfig, contact: &ContactConfig, stiffness: f64) -> Self {
        Self {
            column: COLUMN_M,
            ..Self::new(pad, contact, stiffness)
        }
    }

    /// A ball whose foremost point is the tool's origin: it touches each face where that is closest
    /// to its centre, as in the corner at the foot of a step. `radius` in m.
    pub fn ball(radius: f64, contact: &ContactConfig, stiffness: f64) -> Self {
        let centre = Vector3::new(0.0, 0.0, -radius);
        Self::of_points(vec![centre], radius, contact, stiffness)
    }

    fn of_points(
        points: Vec<Vector3<f64>>,
        ball_radius: f64,
        contact: &ContactConfig,
        stiffness: f64,
    ) -> Self {
        // With an exponent other than 1, the stiffness holds at a depth of 1 mm.
        let scale = 1e-3f64.powf(1.0 - contact.exponent);
        // A ball can touch several faces at once.
        let bristles = if ball_radius > 0.0 {
            FACES_MAX
        } else {
            points.len()
        };
        let law = HuntCrossley {
            stiffness: stiffness * scale / points.len() as f64,
            exponent: contact.exponent,
            dissipation_s_per_m: contact.dissipation_s_per_m,
        };
        Self {
            bristles: vec![Vector3::zeros(); bristles],
            reach: points.iter().map(|p| p.norm()).fold(0.0, f64::max) + ball_radius,
            points,
            ball_radius,
            column: 0.0,
            law,
            friction: Friction::new(&contact.friction),
            friction_variation: None,
        }
    }

    /// Lets the friction vary along the surface.
    pub fn vary_friction(&mut self, variation: FrictionVariation) {
        self.friction_variation = Some(variation);
    }

    /// Point of the tool from which the distance to the surface counts, tool axes, m: the centre
    /// of a round tip, otherwise the tool's origin. With it, the radius of the tip around it.
    pub fn reference(&self) -> (Vector3<f64>, f64) {
        if self.ball_radius > 0.0 {
            (self.points[0], self.ball_radius)
        } else {
            (Vector3::zeros(), 0.0)
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True without points, which `new` never makes.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Advances the bristles by `dt` (s) and returns the wrench; `linearisation` is filled when
    /// given.
    pub fn step(
        &mut self,
        surface: &Surface,
        motion: &PadMotion,
        dt: f64,
        mut linearisation: Option<&mut PadLinearisation>,
    ) -> PadContact {
        let mut sum = PadContact::none();
        let (distance, _) = surface.distance_and_normal(&motion.origin);
        if distance > self.reach {
            self.bristles.fill(Vector3::zeros());
            return sum;
        }
        let rotation = motion.rotation.to_rotation_matrix();
        let mut touch =
            |distance: f64, normal: Vector3<f64>, arm: Vector3<f64>, bristle: &mut _| {
                if distance >= 0.0 {
                    *bristle = Vector3::zeros();
                    return;
                }
                let velocity = motion.linear + motion.angular.cross(&arm);
                let rate = normal.dot(&velocity);
                let press = self.law.force(-distance, -rate);
                let tangential = velocity - normal * rate;
                let load = match &self.friction_variation {
                    Some(variation) => press.force * variation.factor(&(motion.origin + arm)),
                    None => press.force,
                };
                let rub = self.friction.step(bristle, &normal, &tangential, load, dt);
                let force = normal * press.force + rub.force;
                sum.force += force;
                sum.torque += arm.cross(&force);
                sum.load += press.force;
                sum.depth = sum.depth.max(-distance);
                sum.touching += usize::from(press.force > 0.0);
                if let Some(linear) = linearisation.as_deref_mut() {
                    let along = normal * normal.transpose();
                    let damping =
                        along * (press.damping - rub.damping) + Matrix3::identity() * rub.damping;
                    linear.add(&arm, &(along * press.stiffness), &damping);
                }
            };
        if self.ball_radius > 0.0 {
            let centre = rotation * self.points[0];
            let faces = surface.faces_around(&(motion.origin + centre));
            for (face, bristle) in faces.into_iter().zip(&mut self.bristles) {
                let Some((distance, normal)) = face else {
                    *bristle = Vector3::zeros();
                    continue;
                };
                let arm = centre - normal * self.ball_radius;
                touch(distance - self.ball_radius, normal, arm, bristle);
            }
            return sum;
        }
        for (point, bristle) in self.points.iter().zip(&mut self.bristles) {
            let arm = rotation * point;
            let (mut distance, mut normal) = surface.distance_and_normal(&(motion.origin + arm));
            if self.column > 0.0 && distance < 0.0 {
                let out = rotation * -Vector3::z();
                (distance, normal) = compressed(surface, &(motion.origin + arm), &out, self.column);
            }
            touch(distance, normal, arm, bristle);
        }
        sum
    }
}

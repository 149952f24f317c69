//! Where the surface of a draw lies before the arm, and where on it the tool lands.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use tangent_control::{Path, PathSpec};
use tangent_mechanics::{
    Arm, Base, Flange, Joints, ModelData, Pose, Tool, inverse_kinematics, manipulability,
};

use super::dice::Dice;
use super::ranges;
use super::surface_kind::SurfaceKind;
use crate::pose_config::PoseConfig;
use crate::start::{StartConfig, tool_pose};
use crate::surfaces::{ShapeConfig, Surface, SurfaceConfig};
use crate::tool::ToolConfig;

/// What the path does with the feature of its surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Crossing {
    /// The path stays on the surface.
    Stays,
    /// The path goes over the edge of the surface.
    Leaves,
}

/// Surface and start of a draw.
pub(super) struct Placement {
    pub surface: SurfaceConfig,
    pub near_m: [f64; 3],
    /// x axis of the path, base axes.
    pub x_axis: Vector3<f64>,
    /// Joints from which inverse kinematics starts, rad.
    pub seed_rad: Vec<f64>,
    pub crossing: Crossing,
}

/// A surface with the point where the tool lands, in the surface's axes.
struct Local {
    shape: ShapeConfig,
    point: Vector3<f64>,
    /// Direction of the path's x axis; any direction in the surface if absent.
    heading: Option<Vector3<f64>>,
    crossing: Crossing,
}

/// Joints of the arm before its base, tool down, rad.
const SEED_RAD: [f64; 6] = [PI, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];

/// Places along the path that are checked, and steps of the walk between two of them.
const CHECKS: u32 = 16;
const STEPS_PER_CHECK: u32 = 8;
/// Places tried before the last one is taken as it is.
const TRIES: usize = 200;

impl Placement {
    /// Draws surface and place until the arm reaches the whole path, away from singularities.
    pub fn draw(
        dice: &mut Dice,
        kind: SurfaceKind,
        robot: &str,
        tool: &ToolConfig,
        path: &PathSpec,
        landed: (f64, f64),
    ) -> Self {
        let local = local(dice, kind);
        let reach = ModelData::builtin(robot)
            .ok()
            .and_then(|model| Arm::<6>::new(&model).ok());
        let mut placement = Self::once(dice, &local);
        for _ in 0..TRIES {
            let is_reachable = reach
                .as_ref()
                .is_some_and(|arm| placement.is_reachable(arm, tool, path, landed));
            if is_reachable {
                break;
            }
            placement = Self::once(dice, &local);
        }
        placement
    }

    fn once(dice: &mut Dice, local: &Local) -> Self {
        let near = Vector3::new(
            dice.within((0.32, 0.52)),
            dice.within((-0.2, 0.2)),
            dice.within((0.05, 0.3)),
        );
        let lean = dice.within(ranges::FACING_RAD);
        let (sin, cos) = dice.angle().sin_cos();
        let facing = Vector3::new(lean.sin() * cos, lean.sin() * sin, lean.cos());
        let identity = PoseConfig::default();
        let on = Surface::new(&local.shape, &identity).map(|surface| surface.query(&local.point));
        let (point, normal) = on.map_or((local.point, Vector3::z()), |on| (on.point, on.normal));
        let turn = dice.angle();
        let rotation = facing_from(&facing, turn) * facing_from(&normal, 0.0).inverse();
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        let position = near - rotation * point;
        let (roll, pitch, yaw) = rotation.euler_angles();
        let pose = PoseConfig {
            position_m: position.into(),
            roll_pitch_yaw_rad: [roll, pitch, yaw],
        };
        let heading = dice.angle();
        let x_axis = match local.heading {
            Some(along) => rotation * along,
            None => facing_from(&facing, heading) * Vector3::x(),
        };
        let mut seed_rad = SEED_RAD;
        seed_rad[0] += near.y.atan2(near.x);
        Self {
            surface: SurfaceConfig {
                position_m: pose.position_m,
                roll_pitch_yaw_rad: pose.roll_pitch_yaw_rad,
                shape: local.shape.clone(),
            },
            near_m: near.into(),
            x_axis,
            seed_rad: seed_rad.to_vec(),
            crossing: local.crossing,
        }
    }

    /// Whether the arm reaches the start and the path with a square tool, with joints that follow
    /// from one another. The path is walked as the law does: lengths along the surface, from a
    /// plane square to the tool that lands.
    fn is_reachable(
        &self,
        arm: &Arm<6>,
        tool: &ToolConfig,
        path: &PathSpec,
        landed: (f64, f64),
    ) -> bool {
        let pose = self.surface.pose();
        let Ok(surface) = Surface::new(&self.surface.shape, &pose) else {
            return false;
        };
        let Ok(path) = Path::new(path, 0.1, 1.0) else {
            return false;
        };
        let start = tool_pose(&self.start(landed), &surface);
        let plane = -start.z_axis();
        let x = (self.x_axis - plane * plane.dot(&self.x_axis)).normalize();
        let y = plane.cross(&x);
        let flange_from_tool: Pose<Flange, Tool> =
            Pose::from_isometry(tool.flange_from_tool.isometry());
        let mut q = Joints::<6>::from_row_slice(&self.seed_rad);
        let mut on = surface.query_face(&Vector3::from(self.near_m));
        let mut before = Vector2::zeros();
        for i in 0..=CHECKS * STEPS_PER_CHECK {
            let share = f64::from(i) / f64::from(CHECKS * STEPS_PER_CHECK);
            let at: Vector2<f64> = path.at(path.duration_s() * share).position;
            let step = x * (at.x - before.x) + y * (at.y - before.y);
            before = at;
            let Some(turned) = UnitQuaternion::rotation_between(&plane, &on.normal) else {
                return false;
            };
            on = surface.query_face(&(on.point + turned * step));
            if i % STEPS_PER_CHECK != 0 {
                continue;
            }
            let target = Pose::<Base, Tool>::from_isometry(Isometry3::from_parts(
                Translation3::from(on.point + on.normal * 0.01),
                UnitQuaternion::from_rotation_matrix(&square(&on.normal)),
            ));
            let Ok(found) = inverse_kinematics(arm, &flange_from_tool, &target, &q) else {
                return false;
            };
            // Another branch of the inverse kinematics is no way to go along a path.
            let (_, jacobian) = arm.tool_and_jacobian(&found, &flange_from_tool);
            let jumped = i > 0 && (found - q).amax() > 1.0;
            if jumped || manipulability(&jacobian) < ranges::MANIPULABILITY_MIN {
                return false;
            }
            q = found;
        }
        true
    }

    /// Start of the tool, tilted by `landed`: angle and direction, rad.
    pub fn start(&self, (tilt_rad, tilt_direction_rad): (f64, f64)) -> StartConfig {
        StartConfig {
            near_m: self.near_m,
            clearance_m: 0.01,
            tilt_rad,
            tilt_direction_rad,
            yaw_rad: 0.0,
            seed_rad: Some(self.seed_rad.clone()),
        }
    }
}

/// Axes whose z is `normal`, turned about it.
fn facing_from(normal: &Vector3<f64>, turn: f64) -> Rotation3<f64> {
    let seed = if normal.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = (seed - normal * normal.dot(&seed)).normalize();
    let axes = Matrix3::from_columns(&[x, normal.cross(&x), *normal]);
    Rotation3::from_matrix_unchecked(axes) * Rotation3::from_axis_angle(&Vector3::z_axis(), turn)
}

/// Axes of a tool that is square to a surface, as a start pose without tilt and yaw.
fn square(normal: &Vector3<f64>) -> Rotation3<f64> {
    facing_from(&-normal, 0.0)
}

/// Shape and landing point of a kind of surface.
fn local(dice: &mut Dice, kind: SurfaceKind) -> Local {
    let across = |shape, distance: f64, slant: f64| Local {
        shape,
        point: Vector3::new(-distance, 0.0, 0.0),
        heading: Some(Vector3::new(slant.cos(), slant.sin(), 0.0)),
        crossing: Crossing::Stays,
    };
    let on = |shape, point| Local {
        shape,
        point,
        heading: None,
        crossing: Crossing::Stays,
    };
    match kind {
        SurfaceKind::Pipe => {
            let radius_m = dice.within_log((0.06, 0.3));
            on(
                ShapeConfig::Cylinder { radius_m },
                Vector3::new(radius_m, 0.0, 0.0),
            )
        }
        SurfaceKind::Cone => {
            let half_angle = dice.within((0.1, 0.5));
            let height_m: f64 = 0.9;
            let base_radius_m = height_m * half_angle.tan();
            // Far enough from the tip for the whole path, where the radius is 60 mm at least.
            let radius = dice.within((0.06_f64.max(0.25 * half_angle.sin()), 0.3));
            let z = height_m - radius / half_angle.tan();
            on(
                ShapeConfig::Cone {
                    height_m,
                    base_radius_m,
                },
                Vector3::new(radius, 0.0, z),
            )
        }
        SurfaceKind::Sphere => {
            let radius_m = dice.within_log((0.06, 0.3));
            on(
                ShapeConfig::Sphere { radius_m },
                Vector3::new(0.0, 0.0, radius_m),
            )
        }
        SurfaceKind::Plane => on(ShapeConfig::Plane {}, Vector3::zeros()),
        SurfaceKind::Ellipsoid => {
            let semi_axes_m = [0; 3].map(|_| dice.within_log((0.08, 0.3)));
            let direction = Vector3::from([0; 3].map(|_| dice.either_sign(1.0)));
            on(ShapeConfig::Ellipsoid { semi_axes_m }, direction)
        }
        SurfaceKind::TorusOutside | SurfaceKind::TorusInside => {
            let minor_radius_m = dice.within_log((0.05, 0.12));
            let major_radius_m = minor_radius_m + dice.within_log((0.1, 0.3));
            let inside = kind == SurfaceKind::TorusInside;
            // 0 on the outer equator, half a turn on the inner one.
            let around = if inside {
                dice.within((1.8, 2.6))
            } else {
                dice.within((0.0, 1.4))
            };
            let (sin, cos) = around.sin_cos();
            on(
                ShapeConfig::Torus {
                    major_radius_m,
                    minor_radius_m,
                },
                Vector3::new(
                    major_radius_m + minor_radius_m * cos,
                    0.0,
                    minor_radius_m * sin,
                ),
            )
        }
        SurfaceKind::WavedSheet => {
            let wavelength_m = [0; 2].map(|_| dice.within_log((0.06, 0.3)));
            let radius_m = dice.within_log((0.03, 0.3));
            let tau = std::f64::consts::TAU;
            // The radius of curvature on the crests, unless the slope would pass 0.35.
            let amplitude_m =
                wavelength_m.map(|l: f64| (l * l / (tau * tau * radius_m)).min(0.35 * l / tau));
            let point = Vector3::new(
                dice.either_sign(0.5 * wavelength_m[0]),
                dice.either_sign(0.5 * wavelength_m[1]),
                0.0,
            );
            on(
                ShapeConfig::Sheet {
                    amplitude_m,
                    wavelength_m,
                },
                point,
            )
        }
        SurfaceKind::HeightField => on(
            ShapeConfig::HeightField {
                csv: Some(heights(dice)),
                csv_file: None,
            },
            Vector3::new(dice.either_sign(0.05), dice.either_sign(0.05), 0.0),
        ),
        SurfaceKind::Step => {
            let height = dice.within_log((0.0003, 0.003));
            let height_m = if dice.chance(0.5) { height } else { -height };
            let shape = ShapeConfig::Step {
                height_m,
                edge_radius_m: dice.within((0.2e-3, 1e-3)),
            };
            let (distance, slant) = (dice.within((0.015, 0.03)), dice.either_sign(0.5));
            across(shape, distance, slant)
        }
        SurfaceKind::Gap => {
            let shape = ShapeConfig::Groove {
                width_m: dice.within((0.0005, 0.003)),
                depth_m: 0.03,
                edge_radius_m: dice.within((0.2e-3, 1e-3)),
            };
            let (distance, slant) = (dice.within((0.015, 0.03)), dice.either_sign(0.5));
            across(shape, distance, slant)
        }
        SurfaceKind::Seam => {
            let shape = ShapeConfig::Groove {
                width_m: dice.within((0.0005, 0.003)),
                depth_m: dice.within((0.0002, 0.001)),
                edge_radius_m: dice.within((0.1e-3, 0.5e-3)),
            };
            let (distance, slant) = (dice.within((0.015, 0.03)), dice.either_sign(0.5));
            across(shape, distance, slant)
        }
        SurfaceKind::Edge => {
            let shape = ShapeConfig::Edge {
                edge_radius_m: dice.within((0.2e-3, 1e-3)),
            };
            if dice.chance(0.5) {
                // Beside the path, which turns away from it by its slant of 0.3 at most.
                let distance = dice.within((0.015, 0.04));
                Local {
                    heading: Some(Vector3::new(-0.34, 0.94, 0.0)),
                    ..across(shape, distance, 0.0)
                }
            } else {
                let (distance, slant) = (dice.within((0.015, 0.03)), dice.either_sign(0.5));
                Local {
                    crossing: Crossing::Leaves,
                    ..across(shape, distance, slant)
                }
            }
        }
    }
}

/// Smooth heights on a grid of 25 mm: a few waves of random direction and phase.
fn heights(dice: &mut Dice) -> String {
    use std::fmt::Write;
    let waves: Vec<(Vector2<f64>, f64, f64)> = (0..5)
        .map(|_| {
            let length = dice.within_log((0.1, 0.4));
            let (sin, cos) = dice.angle().sin_cos();
            let number = std::f64::consts::TAU / length;
            // A slope of 0.12 at most each.
            let height = dice.within((0.02, 0.12)) / number;
            (Vector2::new(cos, sin) * number, dice.angle(), height)
        })
        .collect();
    let at = |i: i32| f64::from(i) * 0.025;
    let mut text = String::from("y\\x");
    for i in -10..=10 {
        // Writing to a string cannot fail.
        let _ = write!(text, ",{:.4}", at(i));
    }
    for j in -10..=10 {
        let _ = write!(text, "\n{:.4}", at(j));
        for i in -10..=10 {
            let p = Vector2::new(at(i), at(j));
            let height: f64 = waves
                .iter()
                .map(|(number, phase, height)| height * (number.dot(&p) + phase).sin())
                .sum();
            let _ = write!(text, ",{height:.6}");
        }
    }
    text
}

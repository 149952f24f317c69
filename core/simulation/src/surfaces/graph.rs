//! Surfaces given as a height over the xy plane: closest point by Newton's method, curvature from
//! the second derivatives.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// `z = h(x, y)`; material below.
pub(super) trait Graph {
    /// Height (m), gradient and second derivatives (1/m) at `(x, y)`.
    fn height(&self, x: f64, y: f64) -> (f64, Vector2<f64>, Matrix2<f64>);

    /// Upper bound of the gradient's norm.
    fn slope_max(&self) -> f64;
}

fn normal_of(gradient: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(-gradient.x, -gradient.y, 1.0).normalize()
}

/// Maximum number of Newton iterations. Near the surface two or three reach 1e-12 m; beyond a focal
/// distance more are needed.
const ROUNDS: usize = 30;
/// Maximum number of halvings of a step.
const HALVINGS: usize = 20;

/// Foot point of the perpendicular from a point to the graph.
struct Foot {
    place: Vector3<f64>,
    gradient: Vector2<f64>,
    hessian: Matrix2<f64>,
    /// Height of the point above the graph directly below it, m: its sign is that of the distance.
    above: f64,
}

/// Foot point of the perpendicular from `point`: the closest point or, beyond a focal distance, a
/// local minimum of the distance. The iteration starts directly below the point, and the distance
/// decreases in every step.
fn foot<G: Graph>(graph: &G, point: &Vector3<f64>) -> Foot {
    let (mut x, mut y) = (point.x, point.y);
    let (mut h, mut g, mut hessian) = graph.height(x, y);
    let over = point.z - h;
    let mut square = over * over;
    for _ in 0..ROUNDS {
        let above = point.z - h;
        let residual = Vector2::new(point.x - x, point.y - y) + g * above;
        let exact = Matrix2::identity() + g * g.transpose() - hessian * above;
        // Inside a focal distance the exact matrix is positive definite; beyond it, the
        // Gauss-Newton matrix still gives a descent direction.
        let matrix = if exact.m11 > 0.0 && exact.determinant() > 0.0 {
            exact
        } else {
            Matrix2::identity() + g * g.transpose()
        };
        let det = matrix.determinant();
        let mut step = Vector2::new(
            matrix.m22 * residual.x - matrix.m12 * residual.y,
            matrix.m11 * residual.y - matrix.m21 * residual.x,
        ) / det;
        for _ in 0..HALVINGS {
            let next = graph.height(x + step.x, y + step.y);
            let away = Vector3::new(
                point.x - (x + step.x),
                point.y - (y + step.y),
                point.z - next.0,
            );
            // Equal up to rounding.
            if away.norm_squared() <= square * (1.0 + 1e-9) + 1e-24 {
                square = away.norm_squared();
                (x, y) = (x + step.x, y + step.y);
                (h, g, hessian) = next;
                break;
            }
            step *= 0.5;
        }
        if step.norm_squared() < 1e-24 {
            break;
        }
    }
    Foot {
        place: Vector3::new(x, y, h),
        gradient: g,
        hessian,
        above: over,
    }
}

/// Signed distance and normal at the foot point.
pub(super) fn distance_and_normal<G: Graph>(
    graph: &G,
    point: &Vector3<f64>,
) -> (f64, Vector3<f64>) {
    let foot = foot(graph, point);
    let normal = normal_of(&foot.gradient);
    let away = point - foot.place;
    let distance = normal.dot(&away);
    if distance * foot.above < 0.0 && distance.abs() > 1e-9 {
        // The foot point is on the far side of a fold.
        let distance = away.norm().copysign(foot.above);
        return (distance, away / distance);
    }
    (distance, normal)
}

/// Shape operator `P (-H) P / |grad F|` at the foot point, with `F = z - h`.
pub(super) fn curvature<G: Graph>(graph: &G, point: &Vector3<f64>) -> Matrix3<f64> {
    let Foot {
        gradient: g,
        hessian,
        ..
    } = foot(graph, point);
    let normal = normal_of(&g);
    let mut second = Matrix3::zeros();
    second.fixed_view_mut::<2, 2>(0, 0).copy_from(&-hessian);
    let project = Matrix3::identity() - normal * normal.transpose();
    project * second * project / (1.0 + g.norm_squared()).sqrt()
}

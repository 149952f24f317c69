//! Surfaces given as a height over the xy plane: closest point by Newton's method, curvature from the second derivatives.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// `z = h(x, y)`; material below.
pub(super) trait Graph {
    /// Height (m), gradient and second derivatives (1/m) at `(x, y)`.
    fn height(&self, x: f64, y: f64) -> (f64, Vector2<f64>, Matrix2<f64>);

    /// A bound of the gradient's length anywhere.
    fn slope_max(&self) -> f64;
}

fn normal_of(gradient: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(-gradient.x, -gradient.y, 1.0).normalize()
}

/// Foot point `(x, y)` of the perpendicular from `point`, with gradient and second derivatives there.
fn foot<G: Graph>(graph: &G, point: &Vector3<f64>) -> (f64, f64, f64, Vector2<f64>, Matrix2<f64>) {
    let (mut x, mut y) = (point.x, point.y);
    let (mut h, mut g, mut hessian) = graph.height(x, y);
    // Near the surface two or three rounds reach 1e-12 m; a point far away just gets a first-order answer.
    for _ in 0..6 {
        let above = point.z - h;
        let residual = Vector2::new(point.x - x, point.y - y) + g * above;
        let exact = Matrix2::identity() + g * g.transpose() - hessian * above;
        // Inside a focal distance the exact matrix is positive; beyond it, the Gauss-Newton one still descends.
        let matrix = if exact.m11 > 0.0 && exact.determinant() > 0.0 {
            exact
        } else {
            Matrix2::identity() + g * g.transpose()
        };
        let det = matrix.determinant();
        let step = Vector2::new(
            matrix.m22 * residual.x - matrix.m12 * residual.y,
            matrix.m11 * residual.y - matrix.m21 * residual.x,
        ) / det;
        x += step.x;
        y += step.y;
        (h, g, hessian) = graph.height(x, y);
        if step.norm_squared() < 1e-24 {
            break;
        }
    }
    (x, y, h, g, hessian)
}

/// Signed distance and normal at the foot point.
pub(super) fn distance_and_normal<G: Graph>(
    graph: &G,
    point: &Vector3<f64>,
) -> (f64, Vector3<f64>) {
    let (x, y, h, g, _) = foot(graph, point);
    let normal = normal_of(&g);
    (normal.dot(&(point - Vector3::new(x, y, h))), normal)
}

/// Shape operator `P (-H) P / |grad F|` at the foot point, with `F = z - h`.
pub(super) fn curvature<G: Graph>(graph: &G, point: &Vector3<f64>) -> Matrix3<f64> {
    let (_, _, _, g, hessian) = foot(graph, point);
    let normal = normal_of(&g);
    let mut second = Matrix3::zeros();
    second.fixed_view_mut::<2, 2>(0, 0).copy_from(&-hessian);
    let project = Matrix3::identity() - normal * normal.transpose();
    project * second * project / (1.0 + g.norm_squared()).sqrt()
}

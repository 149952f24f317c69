//! Shapes of the stretches of a path: a place for each distance along them.

use nalgebra::Vector2;

/// Shape of a stretch, in plane coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Straight {
        from: Vector2<f64>,
        direction: Vector2<f64>,
    },
    Arc {
        centre: Vector2<f64>,
        radius: f64,
        start_rad: f64,
        sign: f64,
    },
    /// The length of its profile is the policy's time, s.
    Loops {
        radius: f64,
        turn_rate: f64,
        advance: f64,
    },
    /// Points of the path from `first`, passed without a stop.
    Chain { first: usize, count: usize },
}

/// Point of the path at a time, in plane coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// Position, m.
    pub position: Vector2<f64>,
    /// Velocity, m/s.
    pub velocity: Vector2<f64>,
}

impl Shape {
    /// Metres of path per unit of the profile's length.
    pub fn metres_per_unit(&self) -> f64 {
        match *self {
            Self::Straight { .. } | Self::Arc { .. } | Self::Chain { .. } => 1.0,
            Self::Loops {
                radius,
                turn_rate,
                advance,
            } => (radius * turn_rate).abs() + advance.abs(),
        }
    }

    /// `distance` and `speed` are those of the stretch's profile, `points` those of the path.
    pub fn at(&self, points: &[(Vector2<f64>, f64)], distance: f64, speed: f64) -> PathPoint {
        match *self {
            Self::Chain { first, count } => {
                along_chain(&points[first..first + count], distance, speed)
            }
            Self::Straight { from, direction } => PathPoint {
                position: from + direction * distance,
                velocity: direction * speed,
            },
            Self::Arc {
                centre,
                radius,
                start_rad,
                sign,
            } => {
                let (sin, cos) = (start_rad + sign * distance / radius).sin_cos();
                PathPoint {
                    position: centre + Vector2::new(cos, sin) * radius,
                    velocity: Vector2::new(-sin, cos) * (sign * speed),
                }
            }
            Self::Loops {
                radius,
                turn_rate,
                advance,
            } => {
                let (sin, cos) = (turn_rate * distance).sin_cos();
                let along = radius * turn_rate;
                PathPoint {
                    position: Vector2::new(radius * sin, radius * (cos - 1.0) - advance * distance),
                    velocity: Vector2::new(along * cos, -along * sin - advance) * speed,
                }
            }
        }
    }

    /// Upper bound of the path length from the start to `end` on the profile, m.
    pub fn way_max_m(&self, end: f64) -> f64 {
        match self {
            Self::Straight { .. } | Self::Arc { .. } | Self::Chain { .. } => end,
            Self::Loops {
                radius,
                turn_rate,
                advance,
            } => end * (radius * turn_rate.abs() + advance.abs()),
        }
    }
}

/// Point at `distance` (m) along a chain at `speed` (m/s). `points` hold the way from the first.
fn along_chain(points: &[(Vector2<f64>, f64)], distance: f64, speed: f64) -> PathPoint {
    let next = points.partition_point(|(_, way_m)| *way_m <= distance);
    let next = next.clamp(1, points.len() - 1);
    let ((from, start_m), (to, end_m)) = (points[next - 1], points[next]);
    let direction = (to - from) / (end_m - start_m);
    PathPoint {
        position: from + direction * (distance - start_m),
        velocity: direction * speed,
    }
}

//! A profile in the local xz plane, drawn out along y: a plate that ends, a step, a groove.
//!
//! Edges that stick out are rounded; inner corners are sharp.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::shape::{FACES_MAX, FacesAround, Shape};

/// Corners of a profile at most.
const CORNERS_MAX: usize = 4;

/// Material below a line of straight pieces, of which neighbours are perpendicular. The first piece
/// comes from `-x` infinity; the last one goes on for ever.
///
/// The shape is all points within `edge_radius` of a smaller body. This rounds the edges by that
/// radius and leaves the faces where they are.
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    /// Corners of the smaller body, by x, m.
    corners: [Vector2<f64>; CORNERS_MAX],
    count: usize,
    /// Direction of the last piece.
    leaves: Vector2<f64>,
    edge_radius: f64,
}

impl Profile {
    fn of(corners: &[[f64; 2]], leaves: [f64; 2], edge_radius: f64) -> Self {
        let mut all = [Vector2::zeros(); CORNERS_MAX];
        for (slot, corner) in all.iter_mut().zip(corners) {
            *slot = Vector2::from(*corner);
        }
        Self {
            corners: all,
            count: corners.len().min(CORNERS_MAX),
            leaves: leaves.into(),
            edge_radius,
        }
    }

    /// A plate with its top at `z = 0` that ends at `x = 0`.
    pub fn edge(edge_radius: f64) -> Self {
        let r = edge_radius;
        Self::of(&[[-r, -r]], [0.0, -1.0], r)
    }

    /// `z = 0` before `x = 0` and `z = height` beyond it; a negative height steps down. m.
    pub fn step(height: f64, edge_radius: f64) -> Self {
        let r = edge_radius;
        let wall = if height > 0.0 { r } else { -r };
        Self::of(&[[wall, -r], [wall, height - r]], [1.0, 0.0], r)
    }

    /// A plane `z = 0` with a groove of `width` around `x = 0` and of `depth`. m.
    pub fn groove(width: f64, depth: f64, edge_radius: f64) -> Self {
        let r = edge_radius;
        let (wall, bottom) = (0.5 * width + r, -depth - r);
        Self::of(
            &[[-wall, -r], [-wall, bottom], [wall, bottom], [wall, -r]],
            [1.0, 0.0],
            r,
        )
    }

    /// Signed distance from the rounded body and its gradient, in the plane, and the distance from
    /// the smaller body's corner if that is what is closest.
    fn at(&self, p: &Vector2<f64>) -> (f64, Vector2<f64>, Option<f64>) {
        let nearest = (1..=self.count)
            .map(|i| self.piece(i, p))
            .fold(self.piece(0, p), Piece::or);
        self.rounded(&nearest)
    }

    /// `p` against a piece; piece `i` ends at corner `i`.
    fn piece(&self, i: usize, p: &Vector2<f64>) -> Piece {
        let corners = &self.corners[..self.count];
        if i == 0 {
            // The piece from infinity: straight along +x.
            return Piece::new(
                p,
                &corners[0],
                &Vector2::new(-1.0, 0.0),
                f64::INFINITY,
                -1.0,
            );
        }
        let from = corners[i - 1];
        let Some(to) = corners.get(i) else {
            return Piece::new(p, &from, &self.leaves, f64::INFINITY, 1.0);
        };
        let along = to - from;
        let length = along.norm();
        Piece::new(p, &from, &(along / length), length, 1.0)
    }

    /// As [`Profile::at`], with the nearest piece of the smaller body.
    fn rounded(&self, nearest: &Piece) -> (f64, Vector2<f64>, Option<f64>) {
        let length = nearest.away.norm();
        let sign = if nearest.side >= 0.0 { 1.0 } else { -1.0 };
        if nearest.at_corner && length > 1e-12 {
            let gradient = nearest.away * (sign / length);
            return (sign * length - self.edge_radius, gradient, Some(length));
        }
        (nearest.side - self.edge_radius, nearest.normal, None)
    }

    /// Signed distance and normal of each face at its point closest to `point`: a ball between two
    /// of them touches both. Pieces that meet at an edge are one face, between two inner corners.
    pub fn faces_around(&self, point: &Vector3<f64>) -> FacesAround {
        let p = Vector2::new(point.x, point.z);
        let mut nearest: [Option<Piece>; FACES_MAX] = [None; FACES_MAX];
        let mut face = 0;
        for i in 0..=self.count {
            let piece = self.piece(i, &p);
            nearest[face] = Some(nearest[face].map_or(piece, |other| other.or(piece)));
            face += usize::from(i < self.count && self.is_inner(i));
        }
        let out = |piece: Piece| {
            let (distance, gradient, _) = self.rounded(&piece);
            (distance, Vector3::new(gradient.x, 0.0, gradient.y))
        };
        let closest = nearest.into_iter().flatten().reduce(Piece::or);
        if let Some(closest) = closest.filter(|piece| piece.side < 0.0) {
            // In the material, the distances from its other faces say nothing.
            return [Some(out(closest)), None, None];
        }
        // An inner corner is not what a ball touches: it touches the faces beside it.
        let at_inner = |piece: &Piece| {
            let at = p - piece.away;
            (0..self.count)
                .any(|i| self.is_inner(i) && (at - self.corners[i]).norm_squared() < 1e-18)
        };
        nearest.map(|piece| piece.filter(|piece| !at_inner(piece)).map(out))
    }

    /// Whether the material forms an inner corner there: the profile turns left.
    fn is_inner(&self, corner: usize) -> bool {
        let corners = &self.corners[..self.count];
        let from = match corner {
            0 => Vector2::x(),
            i => corners[i] - corners[i - 1],
        };
        let to = match corners.get(corner + 1) {
            Some(next) => next - corners[corner],
            None => self.leaves,
        };
        from.perp(&to) > 0.0
    }
}

/// A point against one straight piece of the profile.
#[derive(Clone, Copy)]
struct Piece {
    /// From the closest point of the piece to the point, m.
    away: Vector2<f64>,
    /// Normal of the piece, out of the material.
    normal: Vector2<f64>,
    /// Distance from the piece's line, m: negative inside the material.
    side: f64,
    /// Whether an end of the piece is closest.
    at_corner: bool,
}

impl Piece {
    /// A piece that starts at `from` and goes `length` along the unit vector `along`; `sense` is -1
    /// if the profile runs against `along`.
    fn new(
        p: &Vector2<f64>,
        from: &Vector2<f64>,
        along: &Vector2<f64>,
        length: f64,
        sense: f64,
    ) -> Self {
        let offset = p - from;
        let share = offset.dot(along);
        let inside = share.clamp(0.0, length);
        // The material is on the right of the profile as it runs.
        let normal = Vector2::new(-along.y, along.x) * sense;
        Self {
            away: offset - along * inside,
            normal,
            side: offset.dot(&normal),
            at_corner: share != inside,
        }
    }

    /// The nearer of two pieces. At a corner both are as near, and the one whose face the point is
    /// further from tells inside from outside.
    fn or(self, other: Self) -> Self {
        let (a, b) = (self.away.norm_squared(), other.away.norm_squared());
        if (a - b).abs() <= 1e-24 {
            if self.side.abs() >= other.side.abs() {
                self
            } else {
                other
            }
        } else if a < b {
            self
        } else {
            other
        }
    }
}

impl Shape for Profile {
    fn distance_and_normal(&self, point: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (distance, gradient, _) = self.at(&Vector2::new(point.x, point.z));
        (distance, Vector3::new(gradient.x, 0.0, gradient.y))
    }

    fn curvature(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let (_, gradient, corner) = self.at(&Vector2::new(point.x, point.z));
        if corner.is_none() || self.edge_radius <= 0.0 {
            return Matrix3::zeros();
        }
        let around = Vector3::new(-gradient.y, 0.0, gradient.x);
        around * around.transpose() / self.edge_radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Closed forms of the profiles at chosen points: distance and normal in the xz plane.
    #[test]
    fn edges_steps_and_grooves_have_their_faces_and_their_rounded_edges() {
        let r = 0.001;
        let edge = Profile::edge(r);
        let up = Profile::step(0.005, r);
        let down = Profile::step(-0.005, r);
        let groove = Profile::groove(0.004, 0.003, r);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let cases: &[(&Profile, [f64; 2], f64, [f64; 2])] = &[
            (&edge, [-0.02, 0.003], 0.003, [0.0, 1.0]),
            (&edge, [-0.02, -0.003], -0.003, [0.0, 1.0]),
            (&edge, [0.004, -0.02], 0.004, [1.0, 0.0]),
            (
                &edge,
                [0.002, 0.002],
                (2.0 * 9e-6f64).sqrt() - r,
                [half, half],
            ),
            (&up, [-0.02, 0.001], 0.001, [0.0, 1.0]),
            (&up, [-0.001, 0.002], 0.001, [-1.0, 0.0]),
            (&up, [0.02, 0.006], 0.001, [0.0, 1.0]),
            (&up, [0.02, 0.004], -0.001, [0.0, 1.0]),
            (&up, [-0.001, 0.006], 8f64.sqrt() * r - r, [-half, half]),
            (&down, [-0.02, 0.001], 0.001, [0.0, 1.0]),
            (&down, [0.001, -0.002], 0.001, [1.0, 0.0]),
            (&down, [0.02, -0.004], 0.001, [0.0, 1.0]),
            (&groove, [-0.02, 0.001], 0.001, [0.0, 1.0]),
            (&groove, [0.0, -0.002], 0.001, [0.0, 1.0]),
            (&groove, [0.0015, -0.001], 0.0005, [-1.0, 0.0]),
            (&groove, [-0.0015, -0.001], 0.0005, [1.0, 0.0]),
            (&groove, [0.02, 0.001], 0.001, [0.0, 1.0]),
        ];
        for (i, (profile, at, distance, normal)) in cases.iter().enumerate() {
            let (got, out) = profile.distance_and_normal(&Vector3::new(at[0], 0.3, at[1]));
            assert!(
                (got - distance).abs() < 1e-12,
                "case {i}: {got} m, not {distance} m"
            );
            let want = Vector3::new(normal[0], 0.0, normal[1]);
            assert!((out - want).norm() < 1e-9, "case {i}: {out}");
        }
        // The rounded edge has its radius.
        let on = edge.curvature(&Vector3::new(0.002, 0.0, 0.002));
        assert!((on.symmetric_eigenvalues().max() - 1.0 / r).abs() < 1e-6);
    }

    /// A ball in the inner corner of a step, and one that bridges a groove, touch two faces; over
    /// a plain face, one.
    #[test]
    fn a_ball_in_a_corner_or_over_a_groove_has_two_faces_around_it() {
        let r = 0.0005;
        let up = Profile::step(0.002, r);
        let groove = Profile::groove(0.004, 0.003, r);
        let near = |profile: &Profile, x: f64, z: f64| {
            let mut faces: Vec<_> = profile
                .faces_around(&Vector3::new(x, 0.0, z))
                .into_iter()
                .flatten()
                .filter(|(distance, _)| *distance < 0.008)
                .collect();
            faces.sort_by(|a, b| a.1.x.total_cmp(&b.1.x));
            faces
        };
        // The foot of the step and its edge.
        let found = near(&up, -0.004, 0.0079);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[1].0 - 0.0079).abs() < 1e-12 && found[1].1.z == 1.0);
        let edge = Vector3::new(-0.0045, 0.0, 0.0064_f64);
        assert!((found[0].0 - (edge.norm() - r)).abs() < 1e-12);
        assert!((found[0].1 - edge.normalize()).norm() < 1e-9);
        // Both edges of the groove, as far from its middle.
        let found = near(&groove, 0.0, 0.007);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0].0 - found[1].0).abs() < 1e-15);
        assert!((found[0].1.x + found[1].1.x).abs() < 1e-12);
        assert_eq!(near(&up, -0.05, 0.007).len(), 1);
        assert_eq!(near(&up, 0.05, 0.007).len(), 1);
        assert_eq!(near(&groove, 0.05, 0.007).len(), 1);
        assert_eq!(near(&Profile::step(-0.002, r), -0.05, 0.007).len(), 1);
        assert_eq!(near(&Profile::edge(r), -0.05, 0.007).len(), 1);
    }

    proptest! {
        /// The nearest of the faces around a point outside is the closest point.
        #[test]
        fn the_nearest_face_is_the_closest_point(x in -0.02f64..0.02, z in 0.0f64..0.02) {
            for profile in [
                Profile::edge(0.0005),
                Profile::step(0.002, 0.0003),
                Profile::step(-0.003, 0.001),
                Profile::groove(0.003, 0.002, 0.0002),
            ] {
                let p = Vector3::new(x, 0.0, z);
                let (distance, _) = profile.distance_and_normal(&p);
                let nearest: f64 = profile
                    .faces_around(&p)
                    .into_iter()
                    .flatten()
                    .map(|face| face.0)
                    .fold(f64::INFINITY, f64::min);
                // In the sharp inner corner of the smaller body no face has a closest point.
                let in_corner = distance < 0.001;
                prop_assert!(in_corner || (nearest - distance).abs() < 1e-12, "{profile:?} {p}: {nearest} {distance}");
            }
        }

        /// The distance of a profile is continuous and grows by no more than one moves. Without
        /// this, a tool that passes an edge would be deep in the material at once.
        #[test]
        fn nothing_is_deep_at_once_beside_an_edge(
            at in prop::array::uniform2(-0.01f64..0.01),
            step in prop::array::uniform2(-0.001f64..0.001),
        ) {
            for profile in [
                Profile::edge(0.0005),
                Profile::step(0.002, 0.0003),
                Profile::step(-0.003, 0.001),
                Profile::groove(0.003, 0.002, 0.0002),
            ] {
                let p = Vector3::new(at[0], 0.0, at[1]);
                let q = p + Vector3::new(step[0], 0.0, step[1]);
                let [a, b] = [p, q].map(|x| profile.distance_and_normal(&x).0);
                prop_assert!((b - a).abs() <= (q - p).norm() + 1e-12, "{profile:?}: {a} {b}");
            }
        }
    }
}

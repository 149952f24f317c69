//! Leaves out points of a line that it does not need: Ramer-Douglas-Peucker.

use nalgebra::Vector2;

/// Those of `points` (m) from which no other one is further away than the tolerance (m). A closed
/// ring stays closed.
pub(crate) fn simplify(points: &[Vector2<f64>], tolerance_m: f64) -> Vec<Vector2<f64>> {
    let Some(last) = points.len().checked_sub(1) else {
        return Vec::new();
    };
    let mut stays = vec![false; points.len()];
    (stays[0], stays[last]) = (true, true);
    let mut spans = vec![(0, last)];
    while let Some((from, to)) = spans.pop() {
        let furthest = (from + 1..to)
            .map(|i| (i, away_m(&points[i], &points[from], &points[to])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((i, away)) = furthest
            && away > tolerance_m
        {
            stays[i] = true;
            spans.push((from, i));
            spans.push((i, to));
        }
    }
    let kept = points.iter().zip(stays).filter(|(_, stays)| *stays);
    kept.map(|(point, _)| *point).collect()
}

fn away_m(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let along = b - a;
    let share = (point - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
    (point - a - along * share.clamp(0.0, 1.0)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_keeps_its_shape_and_stays_closed() {
        let ring: Vec<_> = (0..=400)
            .map(|k| {
                let (sin, cos) = (f64::from(k % 400) * std::f64::consts::TAU / 400.0).sin_cos();
                Vector2::new(cos, sin) * 0.05
            })
            .collect();
        let found = simplify(&ring, 1e-4);
        assert!((20..80).contains(&found.len()), "{}", found.len());
        assert_eq!(found[0], found[found.len() - 1]);
        for ends in found.windows(2) {
            assert!(0.05 - (0.5 * (ends[0] + ends[1])).norm() < 1.1e-4);
        }
    }
}

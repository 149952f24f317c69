//! Leaves out points of a line that it does not need: Ramer-Douglas-Peucker, so that no point is
//! further from the result than the tolerance.

use nalgebra::Vector2;

use super::polygon::nearest_on;

/// Those of `points` (m) that stay: the first, the last, and as many between as the tolerance (m)
/// needs. A closed ring stays closed.
pub fn simplify(points: &[Vector2<f64>], tolerance_m: f64) -> Vec<Vector2<f64>> {
    let Some(last) = points.len().checked_sub(1) else {
        return Vec::new();
    };
    let mut stays = vec![false; points.len()];
    stays[0] = true;
    stays[last] = true;
    let mut spans = vec![(0, last)];
    while let Some((from, to)) = spans.pop() {
        let furthest = (from + 1..to)
            .map(|i| (i, distance_m(&points[i], &points[from], &points[to])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((i, away_m)) = furthest
            && away_m > tolerance_m
        {
            stays[i] = true;
            spans.push((from, i));
            spans.push((i, to));
        }
    }
    let kept = points.iter().zip(stays).filter(|(_, stays)| *stays);
    kept.map(|(point, _)| *point).collect()
}

/// Distance of `point` from the line segment between `a` and `b`, m.
fn distance_m(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    (nearest_on(a, b, point) - point).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_keeps_its_ends_and_a_corner_stays() {
        let line: Vec<_> = (0..=50)
            .map(|i| Vector2::new(1e-3 * f64::from(i), 0.0))
            .collect();
        assert_eq!(simplify(&line, 1e-3), [line[0], line[50]]);
        let corner = Vector2::new(0.05, 0.04);
        let both = [line.as_slice(), &[corner]].concat();
        assert_eq!(simplify(&both, 1e-3), [line[0], line[50], corner]);
        assert!(simplify(&[], 1e-3).is_empty());
    }

    #[test]
    fn a_circle_is_followed_within_the_tolerance() {
        let on = |i: usize| {
            let angle = 2.0 * std::f64::consts::PI * i as f64 / 300.0;
            Vector2::new(0.05 * angle.cos(), 0.05 * angle.sin())
        };
        let circle: Vec<_> = (0..=300).map(on).collect();
        let found = simplify(&circle, 2e-3);
        assert!((8..=20).contains(&found.len()), "{}", found.len());
        for point in &circle {
            let nearest = found
                .windows(2)
                .map(|pair| distance_m(point, &pair[0], &pair[1]))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest <= 2e-3 + 1e-12);
        }
    }

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

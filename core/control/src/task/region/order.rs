//! The order of strokes: each next one begins near the end of the one before, and a way over the
//! surface is preferred to one for which the tool lifts off.
//!
//! Called while a task is loaded; allocates.

use nalgebra::Vector2;

use super::polygon::Polygon;

/// A lift counts as this much more way, m.
const LIFT_M: f64 = 0.15;

/// Points of a stroke, m.
pub type Points = Vec<Vector2<f64>>;

/// A stroke in its order.
#[derive(Clone, Debug, PartialEq)]
pub struct Ordered {
    /// Points, m.
    pub points: Points,
    /// Its place among the strokes that were given, from 0.
    pub given: usize,
    /// Whether the tool lifts off on the way to it.
    pub lifts: bool,
}

/// Orders strokes from `start` (m). Strokes are reversed where that is nearer; closed ones begin at
/// the point nearest to the tool. Within `inside`, up to `over_m` beyond its edge, the tool slides
/// from stroke to stroke.
pub fn ordered(
    strokes: Vec<Points>,
    start: Vector2<f64>,
    inside: &Polygon,
    over_m: f64,
) -> Vec<Ordered> {
    let mut at = start;
    let mut sorted = Vec::with_capacity(strokes.len());
    let mut strokes: Vec<(usize, Points)> = strokes.into_iter().enumerate().collect();
    while !strokes.is_empty() {
        let mut ways: Vec<(f64, usize)> = strokes
            .iter()
            .enumerate()
            .map(|(i, (_, stroke))| ((nearest_start(stroke, &at).1 - at).norm(), i))
            .collect();
        ways.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut best: Option<(f64, usize, bool)> = None;
        for (way_m, index) in ways {
            if best.is_some_and(|(cost, ..)| cost <= way_m) {
                break;
            }
            let to = nearest_start(&strokes[index].1, &at).1;
            let lifts = !inside.sees(&at, &to, over_m);
            let cost = way_m + if lifts { LIFT_M } else { 0.0 };
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, index, lifts));
            }
        }
        let Some((_, index, lifts)) = best else {
            break;
        };
        let (given, mut points) = strokes.remove(index);
        let begin = nearest_start(&points, &at).0;
        if is_closed(&points) {
            points.pop();
            points.rotate_left(begin);
            points.push(points[0]);
        } else if begin > 0 {
            points.reverse();
        }
        at = points.last().copied().unwrap_or(at);
        sorted.push(Ordered {
            points,
            given,
            lifts,
        });
    }
    sorted
}

/// Index and place of the point at which a stroke begins for a tool at `at`.
fn nearest_start(stroke: &[Vector2<f64>], at: &Vector2<f64>) -> (usize, Vector2<f64>) {
    let last = stroke.len() - 1;
    let candidates = if is_closed(stroke) {
        0..last
    } else {
        0..stroke.len()
    };
    candidates
        .filter(|i| is_closed(stroke) || *i == 0 || *i == last)
        .map(|i| (i, stroke[i]))
        .min_by(|a, b| (a.1 - at).norm().total_cmp(&(b.1 - at).norm()))
        .unwrap_or((0, stroke[0]))
}

fn is_closed(stroke: &[Vector2<f64>]) -> bool {
    stroke.len() > 3 && stroke.first() == stroke.last()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_run_back_and_forth() {
        let plate = Polygon::new(&[[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]], &[]);
        let row = |y: f64| vec![Vector2::new(0.01, y), Vector2::new(0.09, y)];
        let rows = vec![row(0.05), row(0.01), row(0.09)];
        let sorted = ordered(rows, Vector2::zeros(), &plate, 1e-3);
        let starts: Vec<_> = sorted
            .iter()
            .map(|s| (s.points[0].x, s.points[0].y))
            .collect();
        assert_eq!(starts, [(0.01, 0.01), (0.09, 0.05), (0.01, 0.09)]);
        assert!(sorted.iter().all(|s| !s.lifts));
        let given: Vec<_> = sorted.iter().map(|s| s.given).collect();
        assert_eq!(given, [1, 0, 2]);
    }

    #[test]
    fn a_closed_stroke_begins_where_the_tool_is() {
        let plate = Polygon::new(&[[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]], &[]);
        let corners = [
            (0.01, 0.01),
            (0.09, 0.01),
            (0.09, 0.09),
            (0.01, 0.09),
            (0.01, 0.01),
        ];
        let ring = corners.map(|(x, y)| Vector2::new(x, y)).to_vec();
        let sorted = ordered(vec![ring], Vector2::new(0.095, 0.095), &plate, 1e-3);
        let points = &sorted[0].points;
        assert_eq!(
            (points[0], points[4]),
            (Vector2::new(0.09, 0.09), points[0])
        );
        assert_eq!(points.len(), 5);
    }
}

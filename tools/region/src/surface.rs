//! The expected surface of a task: the heights of the map on a coarser grid.

use std::collections::VecDeque;

use nalgebra::Vector2;
use tangent_control::ExpectedSurface;

use crate::fill::Filled;
use crate::height_map::HeightMap;

/// Least distance between heights, m, and most heights.
const CELL_MIN_M: f64 = 0.003;
const HEIGHTS_MAX: f64 = 6000.0;
/// Border around the strokes, m.
const BORDER_M: f64 = 0.01;
/// Rounds in which heights where nothing is known are smoothed.
const SMOOTHED: usize = 60;

/// Heights around the strokes, relative to the place `at` (m) at `height_m`.
pub(crate) fn expected(
    map: &HeightMap,
    filled: &Filled,
    at: &Vector2<f64>,
    height_m: f64,
) -> ExpectedSurface {
    let points = filled
        .strokes
        .iter()
        .flat_map(|stroke| &stroke.points)
        .chain(filled.edge.rings.iter().flatten());
    let (low, high) = points.fold((*at, *at), |(low, high), p| (low.inf(p), high.sup(p)));
    let border = Vector2::repeat(BORDER_M);
    let (low, high) = (low - border, high + border);
    let size = high - low;
    let cell_m = CELL_MIN_M.max((size.x * size.y / HEIGHTS_MAX).sqrt());
    let count = |length: f64| (length / cell_m).ceil() as usize + 1;
    let (columns, rows) = (count(size.x), count(size.y));
    let place = |k: usize| low + Vector2::new((k % columns) as f64, (k / columns) as f64) * cell_m;
    let known: Vec<Option<f64>> = (0..columns * rows)
        .map(|k| map.height_m(&place(k)).map(|h| h - height_m))
        .collect();
    let heights = filled_up(&known, columns);
    let round = |h: f64| (h * 1e5).round() / 1e5 + 0.0;
    let corner = low - at;
    ExpectedSurface {
        corner_m: [round(corner.x), round(corner.y)],
        cell_m,
        columns,
        heights_m: heights.into_iter().map(round).collect(),
    }
}

/// Unknown heights: those of the nearest known ones, smoothed.
fn filled_up(known: &[Option<f64>], columns: usize) -> Vec<f64> {
    let beside = |k: usize| {
        let (i, rows) = (k % columns, known.len() / columns);
        let j = k / columns;
        [
            (i > 0).then(|| k - 1),
            (i + 1 < columns).then(|| k + 1),
            (j > 0).then(|| k - columns),
            (j + 1 < rows).then(|| k + columns),
        ]
    };
    let mut heights: Vec<f64> = known.iter().map(|h| h.unwrap_or(f64::NAN)).collect();
    let mut open: VecDeque<usize> = (0..known.len()).filter(|k| known[*k].is_some()).collect();
    while let Some(k) = open.pop_front() {
        for other in beside(k).into_iter().flatten() {
            if heights[other].is_nan() {
                heights[other] = heights[k];
                open.push_back(other);
            }
        }
    }
    for _ in 0..SMOOTHED {
        for k in (0..known.len()).filter(|k| known[*k].is_none()) {
            let (sum, count) = (beside(k).into_iter().flatten())
                .fold((0.0, 0.0), |(sum, count), other| {
                    (sum + heights[other], count + 1.0)
                });
            heights[k] = sum / count;
        }
    }
    heights
}

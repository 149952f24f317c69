//! Strokes for the cells of a grid that have too little: one stroke a call, the nearest first.
//!
//! A stroke runs along the rows or the columns of the grid, whichever way it covers more, and goes
//! as slowly as the missing dose asks for.

use nalgebra::Vector2;

use super::dose_grid::DoseGrid;
use super::rules::RoundRules;
use crate::task::path::{Path, StrokeWay};

/// Most strokes of a round.
pub(super) const STROKES_MAX: usize = 256;
/// A stroke covers what is nearer than this share of the radius across it.
const ACROSS_SHARE: f64 = 0.6;
/// A stroke goes on over this many radii that need nothing.
const GAP_RADII: f64 = 1.5;
/// The tool slides to a stroke that is nearer than this, in radii.
const NEAR_RADII: f64 = 3.0;
/// The missing dose is filled up to this multiple of the least, but not beyond the middle of the
/// band.
const FILL: f64 = 1.5;
/// Slowest stroke, as a share of the path's speed.
const SLOWEST_SHARE: f64 = 0.3;

/// A stroke on the grid: from a cell along an axis.
#[derive(Clone, Copy, Debug)]
struct Line {
    along: (i64, i64),
    first: (i64, i64),
    cells: i64,
    covers: usize,
}

impl Line {
    fn cell(&self, k: i64) -> (i64, i64) {
        (
            self.first.0 + k * self.along.0,
            self.first.1 + k * self.along.1,
        )
    }

    fn across(&self) -> (i64, i64) {
        (self.along.1, self.along.0)
    }
}

/// State of a round's planning.
#[derive(Clone, Debug)]
pub(super) struct Planner {
    at: Vector2<f64>,
    strokes: usize,
}

impl Planner {
    /// Starts with the tool at `from`, m.
    pub fn new(from: Vector2<f64>, grid: &mut DoseGrid) -> Self {
        for cell in &mut grid.cells {
            cell.planned = false;
        }
        Self {
            at: from,
            strokes: 0,
        }
    }

    /// Adds the next stroke to `path`; `false` if none is left.
    pub fn step(&mut self, grid: &mut DoseGrid, rules: &RoundRules, path: &mut Path) -> bool {
        if self.strokes >= STROKES_MAX {
            return false;
        }
        let away = |index: usize| (grid.middle(index) - self.at).norm_squared();
        let wanted = |index: &usize| {
            let cell = &grid.cells[*index];
            !cell.planned && cell.reached_from.is_some() && grid.is_under(*index, rules)
        };
        let nearest = (0..grid.cells.len())
            .filter(wanted)
            .min_by(|a, b| away(*a).total_cmp(&away(*b)));
        let Some(index) = nearest else {
            return false;
        };
        let from = grid.cells[index].reached_from.map_or(index, |i| i as usize);
        let line = [(1, 0), (0, 1)]
            .map(|along| line(grid, rules, grid.place(from), along))
            .into_iter()
            .max_by_key(|line| line.covers);
        let Some(line) = line else {
            return false;
        };
        let (covered, mean) = cover(grid, rules, &line);
        // The seed counts as covered in any case, so that the planning ends.
        grid.cells[index].planned = true;
        let ends = [line.cell(0), line.cell(line.cells - 1)].map(|(i, j)| {
            let index = grid.index(i, j).unwrap_or(from);
            grid.middle(index)
        });
        let turned = (ends[1] - self.at).norm() < (ends[0] - self.at).norm();
        let mut points = if turned { [ends[1], ends[0]] } else { ends };
        if points[0] == points[1] {
            // A path has no strokes without a length.
            points[1] += Vector2::new(0.25 * grid.cell_m, 0.0);
        }
        let speed_m_per_s = speed(rules, if covered > 0 { mean } else { 0.0 });
        let lifts = self.strokes == 0 || !self.slides_to(grid, rules, &points[0]);
        self.at = path.stroke(
            self.at,
            &StrokeWay {
                points: &points,
                lifts,
                force_n: None,
                profile: &[],
                speed_m_per_s,
                pause_s: 0.0,
            },
            rules.bounds,
        );
        self.strokes += 1;
        true
    }

    /// Whether the tool may slide to `to`: it is near, and the way stays in the region.
    fn slides_to(&self, grid: &DoseGrid, rules: &RoundRules, to: &Vector2<f64>) -> bool {
        let way = to - self.at;
        let steps = (way.norm() / (0.5 * grid.cell_m)).ceil().max(1.0) as usize;
        way.norm() <= NEAR_RADII * rules.radius_m
            && (0..=steps).all(|k| {
                let (i, j) = grid.place_of(&(self.at + way * (k as f64 / steps as f64)));
                grid.index(i, j)
                    .is_some_and(|index| grid.cells[index].allowed)
            })
    }
}

/// Whether a cell needs a stroke that none covers yet.
fn is_open(grid: &DoseGrid, rules: &RoundRules, (i, j): (i64, i64)) -> bool {
    grid.index(i, j)
        .is_some_and(|index| !grid.cells[index].planned && grid.is_under(index, rules))
}

fn is_allowed(grid: &DoseGrid, (i, j): (i64, i64)) -> bool {
    grid.index(i, j)
        .is_some_and(|index| grid.cells[index].allowed)
}

fn half_width(grid: &DoseGrid, rules: &RoundRules) -> i64 {
    ((ACROSS_SHARE * rules.across_m / grid.cell_m).floor() as i64).max(1)
}

/// The stroke along an axis through a cell from which the tool may press. It moves to the middle of
/// a narrow strip, and away from the edge of a wide one.
fn line(grid: &DoseGrid, rules: &RoundRules, seed: (i64, i64), along: (i64, i64)) -> Line {
    let across = (along.1, along.0);
    let width = half_width(grid, rules);
    let beside = |k: i64| (seed.0 + k * across.0, seed.1 + k * across.1);
    let open = |sign: i64| {
        (1..=2 * width)
            .take_while(|k| is_open(grid, rules, beside(sign * k)))
            .count() as i64
    };
    let wanted = ((open(1) - open(-1)) / 2).clamp(-width, width);
    let shift = (0..=wanted.abs())
        .rev()
        .map(|k| k * wanted.signum())
        .find(|k| (1..=k.abs()).all(|m| is_allowed(grid, beside(m * k.signum()))))
        .unwrap_or(0);
    let start = beside(shift);
    let gap = (GAP_RADII * rules.radius_m / grid.cell_m).ceil() as i64;
    let needs = |(i, j): (i64, i64)| {
        (-width..=width).any(|k| is_open(grid, rules, (i + k * across.0, j + k * across.1)))
    };
    // As far as the tool may go, up to the last cell that needs it.
    let reach = |sign: i64| {
        let (mut last, mut k) = (0, 0);
        while k - last <= gap {
            k += 1;
            let cell = (start.0 + sign * k * along.0, start.1 + sign * k * along.1);
            if !is_allowed(grid, cell) {
                break;
            }
            if needs(cell) {
                last = k;
            }
        }
        last
    };
    let (back, ahead) = (reach(-1), reach(1));
    let mut line = Line {
        along,
        first: (start.0 - back * along.0, start.1 - back * along.1),
        cells: back + ahead + 1,
        covers: 0,
    };
    line.covers = under(grid, rules, &line).count();
    line
}

/// Cells that a stroke covers and that need it.
fn under<'a>(
    grid: &'a DoseGrid,
    rules: &'a RoundRules,
    line: &'a Line,
) -> impl Iterator<Item = usize> + 'a {
    let (width, across) = (half_width(grid, rules), line.across());
    // The tool slows down at the ends, so that they get as much.
    (-width..line.cells + width)
        .flat_map(move |k| (-width..=width).map(move |m| (k, m)))
        .map(move |(k, m)| {
            let (i, j) = line.cell(k);
            (i + m * across.0, j + m * across.1)
        })
        .filter(move |cell| is_open(grid, rules, *cell))
        .filter_map(move |(i, j)| grid.index(i, j))
}

/// Marks what a stroke covers. Returns the number of cells and their mean dose, N*s/cm².
fn cover(grid: &mut DoseGrid, rules: &RoundRules, line: &Line) -> (usize, f64) {
    let (mut count, mut sum) = (0, 0.0);
    let (width, across) = (half_width(grid, rules), line.across());
    for k in -width..line.cells + width {
        let (i, j) = line.cell(k);
        for m in -width..=width {
            let cell = (i + m * across.0, j + m * across.1);
            if let Some(index) = grid.index(cell.0, cell.1)
                && is_open(grid, rules, cell)
            {
                grid.cells[index].planned = true;
                count += 1;
                sum += grid.dose(index);
            }
        }
    }
    (count, sum / count.max(1) as f64)
}

/// Speed of a stroke over cells with this mean dose (N*s/cm²), m/s.
fn speed(rules: &RoundRules, mean: f64) -> f64 {
    let Some([least, most]) = rules.band else {
        return rules.speed_m_per_s;
    };
    let missing = (FILL * least).min(0.5 * (least + most)) - mean;
    // A disk of radius r that slides with speed v and force F leaves 2 F / (pi r v) on its middle
    // line.
    let whole =
        2.0 * rules.force_n / (std::f64::consts::PI * rules.radius_m * rules.speed_m_per_s * 1e4);
    rules.speed_m_per_s * (whole / missing.max(1e-9)).clamp(SLOWEST_SHARE, 1.0)
}

//! What a map of the dose says of the wanted dose: too little, too much, and holes between covered
//! places.

use std::collections::{BTreeMap, HashSet};

use nalgebra::Vector3;

use super::{Cell, DoseMap, Place};

/// Widest gap between covered places that counts as a hole, in radii of the tip.
const HOLE_RADII: f64 = 4.0;
/// The wanted dose, if the cell file does not state it, as shares of the median.
const DEFAULT_BAND: [f64; 2] = [0.5, 2.0];

/// The wanted dose, and what the map says of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Judgement {
    /// Least and most wanted dose, N*s/cm².
    pub band: [f64; 2],
    /// Whether the band is the default.
    pub is_default: bool,
    /// Area with at least some dose, cm².
    pub area_cm2: f64,
    /// Area within the band, cm².
    pub good_cm2: f64,
    /// Area above the band, cm².
    pub over_cm2: f64,
    /// Middles of the cells that are below the band between covered places, m.
    pub holes: Vec<Vector3<f64>>,
    /// Their area in the plane of the grid, cm².
    pub hole_cm2: f64,
}

impl DoseMap {
    /// Compares the map with a wanted band, or with the default band.
    pub fn judge(&self, wanted: Option<[f64; 2]>) -> Judgement {
        let band = wanted.unwrap_or_else(|| {
            let median = self.median();
            DEFAULT_BAND.map(|share| share * median)
        });
        let mut found = Judgement {
            band,
            is_default: wanted.is_none(),
            ..Judgement::default()
        };
        for cell in &self.cells {
            found.area_cm2 += cell.area_cm2;
            if cell.dose() > band[1] {
                found.over_cm2 += cell.area_cm2;
            } else if cell.dose() >= band[0] {
                found.good_cm2 += cell.area_cm2;
            }
        }
        found.holes = self.holes(band[0]);
        found.hole_cm2 = found.holes.len() as f64 * self.cell_m * self.cell_m * 1e4;
        found
    }

    fn median(&self) -> f64 {
        let mut doses: Vec<f64> = self.cells.iter().map(Cell::dose).collect();
        if doses.is_empty() {
            return 0.0;
        }
        let middle = doses.len() / 2;
        *doses.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Middles of the cells with less than `least` between two covered cells of the same row or
    /// column of the grid that are near each other.
    fn holes(&self, least: f64) -> Vec<Vector3<f64>> {
        let mut lines: BTreeMap<(u8, bool, i64), Vec<(i64, usize)>> = BTreeMap::new();
        for cell in self.cells.iter().filter(|c| c.dose() >= least) {
            let Place { plane, i, j } = cell.place;
            let row = lines.entry((plane, true, i)).or_default();
            row.push((j, cell.number));
            let column = lines.entry((plane, false, j)).or_default();
            column.push((i, cell.number));
        }
        let widest = (HOLE_RADII * self.radius_m / self.cell_m).ceil() as i64;
        let (mut places, mut holes) = (HashSet::new(), Vec::new());
        for ((plane, is_row, line), mut covered) in lines {
            covered.sort_unstable();
            for pair in covered.windows(2) {
                let [(from, first), (to, last)] = [pair[0], pair[1]];
                if to - from - 1 > widest {
                    continue;
                }
                for k in from + 1..to {
                    let (i, j) = if is_row { (line, k) } else { (k, line) };
                    if places.insert(Place { plane, i, j }) {
                        let share = (k - from) as f64 / (to - from) as f64;
                        let (first, last) = (self.cells[first].point, self.cells[last].point);
                        holes.push(first + (last - first) * share);
                    }
                }
            }
        }
        holes
    }
}

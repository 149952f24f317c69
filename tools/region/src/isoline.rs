//! Lines of equal value in a grid: marching squares. Each line is a closed ring.

use std::collections::HashMap;

use nalgebra::Vector2;

/// A grid of values. Those on its border are below every level that is asked for.
pub(crate) struct Field<'a> {
    pub values: &'a [f64],
    pub columns: usize,
    pub low: Vector2<f64>,
    pub cell_m: f64,
}

/// Place on an edge of the grid: the node at its lower end, and whether the edge runs along y.
type Cut = (usize, bool);

impl Field<'_> {
    /// Rings around what is at least `level`; a last point repeats the first one.
    pub fn rings(&self, level: f64) -> Vec<Vec<Vector2<f64>>> {
        let mut next: HashMap<Cut, Cut> = HashMap::new();
        let mut order = Vec::new();
        let rows = self.values.len() / self.columns;
        for j in 0..rows - 1 {
            for i in 0..self.columns - 1 {
                let node = j * self.columns + i;
                for (from, to) in self.segments(node, level) {
                    next.insert(from, to);
                    order.push(from);
                }
            }
        }
        let mut rings = Vec::new();
        for first in order {
            let mut ring = Vec::new();
            let mut cut = first;
            while let Some(to) = next.remove(&cut) {
                ring.push(self.place(cut, level));
                cut = to;
            }
            if ring.len() >= 3 && cut == first {
                ring.push(ring[0]);
                rings.push(ring);
            }
        }
        rings
    }

    /// Segments of one square, with what is at least `level` on their left.
    fn segments(&self, node: usize, level: f64) -> Vec<(Cut, Cut)> {
        let corners = [node, node + 1, node + self.columns + 1, node + self.columns];
        let above = corners.map(|corner| self.values[corner] >= level);
        // Edges: below, right, top, left.
        let edges: [Cut; 4] = [
            (node, false),
            (node + 1, true),
            (node + self.columns, false),
            (node, true),
        ];
        let mut segments = Vec::new();
        // Around the square counterclockwise, the line leaves it where the value falls.
        let falls: Vec<usize> = (0..4)
            .filter(|k| above[*k] && !above[(k + 1) % 4])
            .collect();
        let rises: Vec<usize> = (0..4)
            .filter(|k| !above[*k] && above[(k + 1) % 4])
            .collect();
        match (falls.len(), rises.len()) {
            (1, 1) => segments.push((edges[falls[0]], edges[rises[0]])),
            (2, 2) => {
                // A saddle: the mean decides whether its corners are joined.
                let mean = corners.iter().map(|c| self.values[*c]).sum::<f64>() / 4.0;
                for &fall in &falls {
                    let rise = if mean >= level {
                        (fall + 1) % 4
                    } else {
                        (fall + 3) % 4
                    };
                    segments.push((edges[fall], edges[rise]));
                }
            }
            _ => {}
        }
        segments
    }

    fn place(&self, (node, along_y): Cut, level: f64) -> Vector2<f64> {
        let other = if along_y {
            node + self.columns
        } else {
            node + 1
        };
        let (a, b) = (self.values[node], self.values[other]);
        let share = if a == b {
            0.5
        } else {
            ((level - a) / (b - a)).clamp(0.0, 1.0)
        };
        let (i, j) = ((node % self.columns) as f64, (node / self.columns) as f64);
        let step = if along_y {
            Vector2::new(0.0, share)
        } else {
            Vector2::new(share, 0.0)
        };
        self.low + (Vector2::new(i, j) + step) * self.cell_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_with_a_hole_gives_two_rings_of_their_length() {
        let columns = 101;
        let values: Vec<f64> = (0..columns * columns)
            .map(|k| {
                let (x, y) = ((k % columns) as f64 - 50.0, (k / columns) as f64 - 50.0);
                let r = x.hypot(y);
                (45.0 - r).min(r - 15.0)
            })
            .collect();
        let field = Field {
            values: &values,
            columns,
            low: Vector2::zeros(),
            cell_m: 0.001,
        };
        for (level, radii) in [(0.0, [0.015, 0.045]), (10.0, [0.025, 0.035])] {
            let mut rings = field.rings(level);
            rings.sort_by_key(Vec::len);
            assert_eq!(rings.len(), 2);
            for (ring, radius) in rings.iter().zip(radii) {
                let length: f64 = ring.windows(2).map(|e| (e[1] - e[0]).norm()).sum();
                let wanted = std::f64::consts::TAU * radius;
                assert!((length / wanted - 1.0).abs() < 0.02, "{length} {wanted}");
            }
        }
        assert!(field.rings(20.0).is_empty());
    }
}

//! Segments of similar orientation, and connected components: cells connected without a jump or a
//! crease, whatever their orientation.
//!
//! Region growing over the grid's nodes, after the paper's II.B (Westfechtel et al.), but without a
//! point cloud: neighbours are neighbours in the image.

use nalgebra::{Matrix3, Vector3};

use super::config::DepthNormalConfig;
use super::facets::Facet;
use super::windows::Node;

/// Label of a cell that belongs to nothing.
pub(super) const NONE: u16 = 0;

/// Labels of the cells.
#[derive(Clone, Debug, Default)]
pub(super) struct Segments {
    /// Segment of each cell, by orientation, from 1.
    pub segment: Vec<u16>,
    /// Connected component of each cell, from 1.
    pub body: Vec<u16>,
    queue: Vec<u32>,
    /// Sides over which a cell's surface continues: one bit each, in the order of
    /// [`Neighbours::of`].
    sides: Vec<u8>,
    /// Extent of each connected component around the tool.
    votes: Vec<f64>,
    pub segments: u16,
    columns: usize,
}

/// Principal components of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentShape {
    /// Mean point, camera axes, m.
    pub middle: Vector3<f64>,
    /// Direction of least spread, towards the camera: the paper's `n_s`.
    pub normal: Vector3<f64>,
    /// Eq. (16): λ3 / tr Σ.
    pub variation: f64,
    /// Number of cells.
    pub cells: usize,
}

impl Segments {
    pub fn resize(&mut self, columns: usize, rows: usize) {
        let n = columns * rows;
        if self.segment.len() == n && self.columns == columns {
            return;
        }
        self.columns = columns;
        for labels in [&mut self.segment, &mut self.body] {
            labels.clear();
            labels.resize(n, NONE);
        }
        self.sides.clear();
        self.sides.resize(n, 0);
        self.queue.clear();
        self.queue.reserve(n);
        self.votes.clear();
        self.votes.reserve(n + 1);
    }

    /// Finds the sides over which the surface continues from cell to cell, and labels the connected
    /// components. Must be called first.
    pub fn grow_bodies(
        &mut self,
        config: &DepthNormalConfig,
        nodes: &[Node],
        facets: &[Facet],
        jump: [f64; 2],
    ) {
        self.body.fill(NONE);
        let mut bodies = NONE;
        let seams = Seams {
            nodes,
            facets,
            jump,
            config,
            columns: self.columns,
        };
        seams.find(&mut self.sides);
        let neighbours = Neighbours {
            sides: &self.sides,
            columns: self.columns,
        };
        for (seed, facet) in facets.iter().enumerate() {
            if facet.valid && self.body[seed] == NONE && bodies < u16::MAX {
                bodies += 1;
                flood(
                    &mut self.body,
                    &mut self.queue,
                    seed,
                    bodies,
                    &neighbours,
                    |_| true,
                );
            }
        }
        self.votes.clear();
        self.votes.resize(usize::from(bodies) + 1, 0.0);
    }

    /// Labels the segments; the tool's segment is grown first, so that it is centred there. Call
    /// after [`Segments::grow_bodies`].
    pub fn grow_segments(
        &mut self,
        config: &DepthNormalConfig,
        facets: &[Facet],
        tool: Option<usize>,
    ) {
        self.segment.fill(NONE);
        self.segments = NONE;
        let spread = config.segment_spread_rad.min(std::f64::consts::PI).cos();
        let neighbours = Neighbours {
            sides: &self.sides,
            columns: self.columns,
        };
        for seed in tool.into_iter().chain(0..facets.len()) {
            if !facets[seed].valid || self.segment[seed] != NONE || self.segments == u16::MAX {
                continue;
            }
            self.segments += 1;
            let mut mean = facets[seed].normal;
            flood(
                &mut self.segment,
                &mut self.queue,
                seed,
                self.segments,
                &neighbours,
                |to| {
                    let normal = &facets[to].normal;
                    // The mean is not normalised: comparing the cosine needs its length only once.
                    let alike = mean.dot(normal) >= spread * mean.norm();
                    if alike {
                        mean += normal;
                    }
                    alike
                },
            );
        }
    }

    /// The cell at `place` (cells): the nearest cell of the connected component with the largest
    /// extent around it, within `reach(cell)` cells. An isolated cell is thus not mistaken for the
    /// surface because it is nearest.
    pub fn at(
        &mut self,
        place: [f64; 2],
        facets: &[Facet],
        reach: impl Fn(&Facet) -> f64,
    ) -> Option<usize> {
        let distance = |i: usize| {
            let x = (i % self.columns) as f64 - place[0];
            let y = (i / self.columns) as f64 - place[1];
            x * x + y * y
        };
        let within = |i: usize| {
            let square = distance(i);
            (facets[i].valid && square <= reach(&facets[i]).powi(2)).then_some(square)
        };
        self.votes.fill(0.0);
        for (i, body) in self.body.iter().enumerate() {
            if *body != NONE
                && let Some(square) = within(i)
            {
                self.votes[usize::from(*body)] += 1.0 / (1.0 + square);
            }
        }
        let most = self.votes.iter().copied().fold(0.0, f64::max);
        let body = self.votes.iter().position(|v| *v == most && most > 0.0)?;
        let members = (0..facets.len())
            .filter(|i| usize::from(self.body[*i]) == body && within(*i).is_some());
        members.min_by(|m, n| distance(*m).total_cmp(&distance(*n)))
    }

    /// Principal components of a segment's points.
    pub fn shape(&self, label: u16, facets: &[Facet]) -> Option<SegmentShape> {
        let points = || {
            let of = self.segment.iter().zip(facets);
            of.filter(move |(l, f)| **l == label && f.valid)
                .map(|(_, f)| f.point)
        };
        let cells = points().count();
        if label == NONE || cells < 3 {
            return None;
        }
        let middle = points().sum::<Vector3<f64>>() / cells as f64;
        let spread: Matrix3<f64> = points()
            .map(|p| (p - middle) * (p - middle).transpose())
            .sum();
        shape_of(middle, &(spread / cells as f64), cells)
    }
}

/// Normal and variation, eq. (16), from the mean and covariance of points.
pub(super) fn shape_of(
    middle: Vector3<f64>,
    spread: &Matrix3<f64>,
    cells: usize,
) -> Option<SegmentShape> {
    let eigen = spread.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let trace = spread.trace();
    if trace.is_nan() || trace <= 0.0 {
        return None;
    }
    let axis: Vector3<f64> = eigen.eigenvectors.column(least).into();
    Some(SegmentShape {
        middle,
        normal: if axis.dot(&middle) > 0.0 { -axis } else { axis },
        variation: (eigen.eigenvalues[least] / trace).abs(),
        cells,
    })
}

/// Connections of a cell's surface.
struct Neighbours<'a> {
    sides: &'a [u8],
    columns: usize,
}

impl Neighbours<'_> {
    /// Neighbouring cells over which the surface continues: left, right, above, below.
    fn of(&self, from: usize) -> impl Iterator<Item = usize> {
        let sides = self.sides[from];
        let cells = [
            from.wrapping_sub(1),
            from + 1,
            from.wrapping_sub(self.columns),
            from + self.columns,
        ];
        cells
            .into_iter()
            .enumerate()
            .filter_map(move |(side, to)| (sides >> side & 1 == 1).then_some(to))
    }
}

/// Data for comparing neighbouring cells.
struct Seams<'a> {
    nodes: &'a [Node],
    facets: &'a [Facet],
    jump: [f64; 2],
    config: &'a DepthNormalConfig,
    columns: usize,
}

impl Seams<'_> {
    /// Compares every pair of neighbours once, for both sides.
    fn find(&self, sides: &mut [u8]) {
        sides.fill(0);
        let n = self.facets.len();
        for i in 0..n {
            if !self.facets[i].valid {
                continue;
            }
            let right = (i + 1 < n && (i + 1) % self.columns != 0).then_some((i + 1, 0));
            let below = (i + self.columns < n).then_some((i + self.columns, 1));
            for (next, axis) in [right, below].into_iter().flatten() {
                let [on, back] = self.joins(i, next, axis);
                sides[i] |= u8::from(on) << (2 * axis + 1);
                sides[next] |= u8::from(back) << (2 * axis);
            }
        }
    }

    /// Whether the surface continues to the next cell along an axis without a jump or a crease, and
    /// the same in the opposite direction.
    fn joins(&self, from: usize, to: usize, axis: usize) -> [bool; 2] {
        let (a, b) = (&self.facets[from], &self.facets[to]);
        if !b.valid {
            return [false; 2];
        }
        // If normals are uncertain, or cells far apart, the normals may differ by more.
        let doubt = 2.0 * (a.sd_rad * a.sd_rad + b.sd_rad * b.sd_rad).sqrt();
        let bend = self.config.bend_max_per_m * (a.point - b.point).norm();
        let allowed = self.config.crease_rad + doubt + bend;
        if (a.normal - b.normal).norm_squared() > allowed * allowed {
            return [false; 2];
        }
        // Compares both planes half way between the cells.
        let (m, n) = (&self.nodes[from], &self.nodes[to]);
        let there = m.w + 0.5 * m.slope[axis];
        let back = n.w - 0.5 * n.slope[axis];
        let apart = (there - back).abs();
        [m, n].map(|node| apart <= self.jump[0] + self.jump[1] * node.w)
    }
}

fn flood(
    labels: &mut [u16],
    queue: &mut Vec<u32>,
    seed: usize,
    label: u16,
    neighbours: &Neighbours<'_>,
    mut belongs: impl FnMut(usize) -> bool,
) {
    queue.clear();
    queue.push(seed as u32);
    labels[seed] = label;
    // Every cell enters the queue once, so it never outgrows the grid. First in, first out grows
    // evenly around the seed.
    let mut next = 0;
    while let Some(from) = queue.get(next).copied() {
        next += 1;
        for to in neighbours.of(from as usize) {
            if labels[to] == NONE && belongs(to) {
                labels[to] = label;
                queue.push(to as u32);
            }
        }
    }
}

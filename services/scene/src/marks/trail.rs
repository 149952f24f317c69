//! A path in space as a line: the newest points, in order.

use std::collections::VecDeque;

use nalgebra::Vector3;
use tangent_schemas::standard::Marker;

use super::Seen;
use super::blocks::{BLOCK, Blocks, POINTS_MAX};
use super::shape::{kind, marker, removed};

/// A line that forgets its oldest block when it is full.
pub struct Trail {
    name: &'static str,
    step_m: f64,
    color: [f32; 3],
    width_m: f64,
    points: VecDeque<Vector3<f64>>,
    /// Number of the block that the first point is in.
    first: usize,
    blocks: Blocks,
}

impl Trail {
    pub fn new(name: &'static str, step_m: f64, color: [f32; 3], width_m: f64) -> Self {
        Self {
            name,
            step_m,
            color,
            width_m,
            points: VecDeque::new(),
            first: 0,
            blocks: Blocks::default(),
        }
    }

    fn end(&self) -> usize {
        self.first + self.points.len().div_ceil(BLOCK)
    }

    /// Removes all points.
    pub fn clear(&mut self) {
        for block in self.first..self.end() {
            self.blocks.remove(block);
        }
        self.points.clear();
        self.first = 0;
    }

    /// Adds a point, world axes, m, if it is far enough from the one before.
    pub fn add(&mut self, point: Vector3<f64>) {
        let near = |last: &Vector3<f64>| (last - point).norm() < self.step_m;
        if self.points.back().is_some_and(near) || !point.iter().all(|x| x.is_finite()) {
            return;
        }
        if self.points.len() == POINTS_MAX {
            self.points.drain(..BLOCK);
            self.blocks.remove(self.first);
            self.first += 1;
        }
        self.points.push_back(point);
        let last = self.end() - 1;
        self.blocks.change(last);
        // The line of a block ends at the first point of the next one.
        if self.points.len() % BLOCK == 1 && last > self.first {
            self.blocks.change(last - 1);
        }
    }

    pub fn draw(&mut self, seen: &Seen, markers: &mut Vec<Marker>) {
        for block in self.blocks.gone() {
            markers.push(removed(seen.stamp, self.name, block as i32));
        }
        let Some(block) = self.blocks.next(seen.now, self.first, self.end()) else {
            return;
        };
        let start = (block - self.first) * BLOCK;
        let points = self.points.iter().skip(start).take(BLOCK + 1);
        let mut line = marker(seen.stamp, "world", self.name, kind::LINE_STRIP, self.color);
        line.id = block as i32;
        line.scale.x = self.width_m;
        line.points = points.map(Into::into).collect();
        if line.points.len() >= 2 {
            markers.push(line);
        }
    }
}

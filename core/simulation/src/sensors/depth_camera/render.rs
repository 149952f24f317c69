//! Renders the true inverse depth of every pixel: rays at the nodes of blocks, a quadratic between
//! them where the scene is smooth, and a ray per pixel elsewhere.

use super::scene::{Scene, Thing};
use tangent_estimation::depth_normal::Intrinsics;

/// Pixels between two rays of the coarse grid; a block has two such steps along either side.
const STEP: usize = 8;
const BLOCK: usize = 2 * STEP;

/// Inverse depths, 1/m, row by row; 0 where the ray hits nothing.
pub struct Renderer {
    width: usize,
    height: usize,
    nodes: Vec<(Thing, f64)>,
}

impl Renderer {
    /// Renderer for images of one size, pixels.
    pub fn new(width: usize, height: usize) -> Self {
        let columns = 2 * width.div_ceil(BLOCK) + 1;
        let rows = 2 * height.div_ceil(BLOCK) + 1;
        Self {
            width,
            height,
            nodes: vec![(Thing::Nothing, 0.0); columns * rows],
        }
    }

    /// Fills `inverse_depth`. Blocks whose error, estimated from a few more rays, exceeds
    /// `tolerance` (1/m) are rendered with a ray per pixel.
    pub fn render(
        &mut self,
        scene: &Scene<'_>,
        intrinsics: &Intrinsics,
        tolerance: f64,
        inverse_depth: &mut [f32],
    ) {
        let ray = |u: usize, v: usize| intrinsics.ray(u as f64, v as f64);
        let inverse = |(thing, depth): (Thing, f64)| match thing {
            Thing::Nothing => (thing, 0.0),
            _ => (thing, 1.0 / depth),
        };
        let blocks = [self.width.div_ceil(BLOCK), self.height.div_ceil(BLOCK)];
        let columns = 2 * blocks[0] + 1;
        for (i, node) in self.nodes.iter_mut().enumerate() {
            let (row, column) = (i / columns, i % columns);
            *node = inverse(scene.cast(ray(column * STEP, row * STEP)));
        }
        for block in 0..blocks[0] * blocks[1] {
            let (row, column) = (block / blocks[0], block % blocks[0]);
            let (left, top) = (column * BLOCK, row * BLOCK);
            let mut nodes = [[0.0; 3]; 3];
            let first = self.nodes[2 * row * columns + 2 * column].0;
            let mut alike = true;
            for (j, line) in nodes.iter_mut().enumerate() {
                for (i, value) in line.iter_mut().enumerate() {
                    let (thing, w) = self.nodes[(2 * row + j) * columns + 2 * column + i];
                    alike &= thing == first;
                    *value = w;
                }
            }
            // Rays between the nodes, where the error of the quadratic is largest.
            let smooth = alike
                && [(4, 4), (12, 4), (4, 12), (12, 12)].iter().all(|&(i, j)| {
                    let (thing, w) = inverse(scene.cast(ray(left + i, top + j)));
                    thing == first && (w - biquadratic(&nodes, i, j)).abs() <= tolerance
                });
            let right = (left + BLOCK).min(self.width);
            for v in top..(top + BLOCK).min(self.height) {
                let line = &mut inverse_depth[v * self.width + left..v * self.width + right];
                if smooth {
                    let along = along(&nodes, v - top);
                    for (i, w) in line.iter_mut().enumerate() {
                        let [a, b, c] = weights(i);
                        *w = (a * along[0] + b * along[1] + c * along[2]) as f32;
                    }
                } else {
                    for (i, w) in line.iter_mut().enumerate() {
                        *w = inverse(scene.cast(ray(left + i, v))).1 as f32;
                    }
                }
            }
        }
    }
}

/// Lagrange weights of the nodes at 0, `STEP` and 2 `STEP` pixels.
fn weights(i: usize) -> [f64; 3] {
    let x = i as f64 / STEP as f64 - 1.0;
    [0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0)]
}

fn along(nodes: &[[f64; 3]; 3], j: usize) -> [f64; 3] {
    let [a, b, c] = weights(j);
    [0, 1, 2].map(|i| a * nodes[0][i] + b * nodes[1][i] + c * nodes[2][i])
}

fn biquadratic(nodes: &[[f64; 3]; 3], i: usize, j: usize) -> f64 {
    let [a, b, c] = weights(i);
    let line = along(nodes, j);
    a * line[0] + b * line[1] + c * line[2]
}

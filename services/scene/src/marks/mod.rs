//! `/markers`: normals with their cones of uncertainty, the force, the wanted and the driven path,
//! the surface touched, and what was covered.
//!
//! Arrows go out with every call. Everything that grows with the task is kept in blocks of a
//! bounded number, and at most one block of each layer goes out per second.

mod blocks;
mod cone;
mod patches;
mod planned;
mod shape;
mod trail;

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tip, Tool, World};
use tangent_schemas::standard::Marker;
use tangent_schemas::tangent::{ControlState, NormalEstimate};

use patches::Patches;
use planned::Planned;
use shape::arrow;
use trail::Trail;

use crate::pressed::{Pressed, cover_radius_m};

/// Length of the force's arrow per newton, m.
const METRES_PER_N: f64 = 0.02;
/// Length of a normal's arrow, m.
const NORMAL_M: f64 = 0.08;
/// Interval of the cones.
const CONES: Duration = Duration::from_millis(200);
/// Spacing of the points of a path, m.
const TRAIL_STEP_M: f64 = 0.002;
/// Edge of the cells in which the touched surface is kept, m.
const TOUCH_CELL_M: f64 = 0.003;
/// Share of the wanted force from which the tool counts as touching.
const TOUCH_SHARE: f64 = 0.2;

/// The newest state of the cell.
pub struct Seen {
    pub now: Instant,
    /// Stamp of the arm's state, ns.
    pub stamp: i64,
    pub base_from_tool: Pose<Base, Tool>,
    pub world_from_base: Pose<World, Base>,
    pub control: ControlState,
    /// New estimates, by estimator.
    pub estimates: Vec<(String, NormalEstimate)>,
}

impl Seen {
    fn world(&self, in_base: &Vector3<f64>) -> Vector3<f64> {
        self.world_from_base.transform_point(in_base)
    }
}

/// What is drawn of the task so far. What stays in place is kept in world axes.
pub struct Marks {
    tip: Tip,
    activation: Option<u64>,
    planned: Planned,
    wanted: Trail,
    driven: Trail,
    touched: Patches,
    covered: Patches,
    coned: Option<Instant>,
}

impl Marks {
    pub fn new(tip: Tip) -> Self {
        let cover_m = cover_radius_m(&tip);
        Self {
            tip,
            activation: None,
            planned: Planned::default(),
            wanted: Trail::new("path/wanted", TRAIL_STEP_M, [0.95, 0.75, 0.1], 0.002),
            driven: Trail::new("path/tool", TRAIL_STEP_M, [0.2, 0.8, 0.3], 0.003),
            touched: Patches::touched("surface", TOUCH_CELL_M),
            covered: Patches::covered("coverage", cover_m),
            coned: None,
        }
    }

    /// Whether no task of this number has begun here.
    pub fn is_new(&self, activation: u64) -> bool {
        self.activation != Some(activation)
    }

    /// A task begins, with the tool at this pose: what was drawn of the one before is removed.
    pub fn begin(
        &mut self,
        activation: u64,
        task: Option<&str>,
        base_from_tool: &Pose<Base, Tool>,
    ) {
        self.activation = Some(activation);
        self.planned = Planned::of_task(task, base_from_tool);
        self.wanted.clear();
        self.driven.clear();
        self.touched.clear();
        self.covered.clear();
    }

    /// The markers of this moment.
    pub fn draw(&mut self, seen: &Seen) -> Vec<Marker> {
        let (control, at) = (&seen.control, seen.base_from_tool.translation());
        let normal = Vector3::from(&control.normal);
        let force = seen
            .base_from_tool
            .rotate(&Vector3::from(&control.wrench.force));
        let mut markers = vec![arrow(
            seen.stamp,
            "normal",
            at,
            normal * NORMAL_M,
            [0.1, 0.4, 1.0],
        )];
        // Without a usable wrench the force is not a number, which no viewer draws.
        if force.iter().all(|x| x.is_finite()) {
            let along = force * METRES_PER_N;
            markers.push(arrow(seen.stamp, "force", at, along, [1.0, 0.3, 0.1]));
        }
        self.keep(seen);
        if self.coned.is_none_or(|coned| seen.now >= coned + CONES) && !seen.estimates.is_empty() {
            self.coned = Some(seen.now);
            for (name, estimate) in &seen.estimates {
                markers.extend(cone::of_estimate(name, estimate, &control.estimator));
            }
        }
        markers.extend(self.planned.draw(seen));
        self.wanted.draw(seen, &mut markers);
        self.driven.draw(seen, &mut markers);
        self.touched.draw(seen, &mut markers);
        self.covered.draw(seen, &mut markers);
        markers
    }

    /// Adds the present place to the paths and to the surface.
    fn keep(&mut self, seen: &Seen) {
        let control = &seen.control;
        let is = |phase: Phase| control.phase == phase as u8;
        if is(Phase::Slide) {
            let reference = Vector3::from(&control.path_reference);
            self.planned.begin_at(&reference, &seen.world_from_base);
            self.wanted.add(seen.world(&reference));
            self.driven
                .add(seen.world(&seen.base_from_tool.translation()));
        }
        let tool = &seen.base_from_tool;
        let pressed = Pressed::of(control, tool, &seen.world_from_base, &self.tip);
        let touches = |p: &Pressed| p.force_n >= TOUCH_SHARE * p.reference_n;
        if let Some(pressed) = pressed.filter(touches) {
            let share = pressed.force_n / pressed.reference_n;
            self.touched.touch(pressed.point, share);
            self.covered.cover(pressed.point, &pressed.normal);
        }
    }
}

#[cfg(test)]
mod tests;

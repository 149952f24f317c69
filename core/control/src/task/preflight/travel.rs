//! Checks the way to the start pose and home: joints against their end stops, and the tool against
//! the workspace along the straight way in joint space.

use tangent_mechanics::Joints;

use super::{Edge, Preflight, Refusal};
use crate::joint_move::left_rad;
use crate::task::StartSpec;

/// Distance between the places of the way that are checked, rad of the joint that moves most.
const SPACING_RAD: f64 = 0.02;

/// Result of the check of the way to the start.
#[derive(Default)]
pub(super) struct Travelled<const N: usize> {
    pub refusals: Vec<Refusal>,
    /// Joint positions from which the path begins, if the task states them and they are allowed.
    pub start: Option<Joints<N>>,
}

impl<const N: usize> Preflight<'_, N> {
    /// Checks `[start]` and `[home]`; `standing` is where the arm stands, if known.
    pub(super) fn travel(&self, standing: Option<&Joints<N>>) -> Travelled<N> {
        let mut found = Travelled {
            refusals: Vec::new(),
            start: None,
        };
        if let Some(home) = &self.task.home {
            let _ = self.pose("home", home, &mut found.refusals);
        }
        let Some(spec) = &self.task.start else {
            return found;
        };
        let Some(start) = self.pose("start", spec, &mut found.refusals) else {
            return found;
        };
        if let Some(q) = standing {
            if self.travels {
                found.refusals.extend(self.way("start", q, &start));
            } else if left_rad(q, &start) > spec.tolerance_rad {
                let (joint, _) = (start - q).abs().argmax();
                found.refusals.push(Refusal::StartAway {
                    joint: joint + 1,
                    away_rad: left_rad(q, &start),
                    tolerance_rad: spec.tolerance_rad,
                });
            }
        }
        found.start = Some(start);
        found
    }

    /// The joint positions of `spec`; `None` with a refusal if this arm cannot stand there.
    fn pose(
        &self,
        table: &'static str,
        spec: &StartSpec,
        refusals: &mut Vec<Refusal>,
    ) -> Option<Joints<N>> {
        let Ok(q) = spec.joints::<N>(table) else {
            refusals.push(Refusal::StartJoints {
                table,
                joints: spec.joints_rad.len(),
                arm: N,
            });
            return None;
        };
        let bounds = self.arm.limits();
        let margin_rad = self.limits.joint_margin_rad;
        let beyond = (0..N).find_map(|i| {
            let lower_rad = bounds.position_lower[i] + margin_rad;
            let upper_rad = bounds.position_upper[i] - margin_rad;
            (!(lower_rad..=upper_rad).contains(&q[i])).then_some(Refusal::StartEndStop {
                table,
                joint: i + 1,
                angle_rad: q[i],
                lower_rad,
                upper_rad,
            })
        });
        if let Some(refusal) = beyond {
            refusals.push(refusal);
            return None;
        }
        Some(q)
    }

    /// The first place of the straight way in joint space that is outside the workspace.
    fn way(&self, table: &'static str, from: &Joints<N>, to: &Joints<N>) -> Option<Refusal> {
        let steps = (left_rad(from, to) / SPACING_RAD).ceil().max(1.0);
        if !steps.is_finite() {
            // The arm's state is invalid; that is refused elsewhere, with the reason.
            return None;
        }
        (0..=steps as usize).find_map(|step| {
            let share = step as f64 / steps;
            let q = from + (to - from) * share;
            let position = (self.arm.base_from_flange(&q) * *self.flange_from_tool).translation();
            Edge::crossed(self.limits, &position).map(|edge| Refusal::WayOutside {
                table,
                share,
                in_base_m: position.into(),
                edge,
            })
        })
    }
}

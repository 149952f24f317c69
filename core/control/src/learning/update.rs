//! What a memory learns from a completed pass.

use nalgebra::Vector3;

use super::memory::{Bin, Memory, Stroke};
use super::pass::{Pass, Point};
use super::spec::LearningSpec;
use crate::contact::alignment::angle_between;

/// Growth of a bin's weight by a pass that agrees with it.
const WEIGHT_STEP: f64 = 0.5;
/// Angle between the stored and the measured direction of the surface beyond which a pass
/// contradicts a bin, rad.
const CONTRADICTION_RAD: f64 = 0.06;
/// Share of contradicted bins above which a pass was over another part: all are replaced.
const OTHER_PART_SHARE: f64 = 0.15;
/// Number of passes over which a bin averages.
const AVERAGED_MAX: u32 = 4;
/// Growth of a stroke's force error over that without a memory at which its weights are halved.
const WORSE_FACTOR: f64 = 1.2;
/// Force error below which no such growth counts, N.
const WORSE_LEAST_N: f64 = 0.02;

impl Memory {
    /// Learns from a completed pass.
    pub(super) fn learn(&mut self, pass: &Pass, spec: &LearningSpec) {
        let (mut learnt, mut measured, mut contradicted) = (false, 0.0, 0.0);
        for (index, stroke) in self.strokes.iter().enumerate() {
            for (bin, point) in points(stroke, pass, index) {
                if stroke.bins[bin].passes > 0 {
                    measured += 1.0;
                    contradicted += f64::from(u8::from(contradicts(&stroke.bins[bin], &point)));
                }
            }
        }
        let is_other_part = contradicted > OTHER_PART_SHARE * measured;
        for (index, stroke) in self.strokes.iter_mut().enumerate() {
            if is_other_part {
                stroke.bins.iter_mut().for_each(|bin| bin.weight = 0.0);
            }
            for i in 0..stroke.bins.len() {
                if let Some(point) = pass.smoothed(index, stroke.place_m(i)) {
                    update(
                        &mut stroke.bins[i],
                        &point,
                        spec.change_max_rad,
                        is_other_part,
                    );
                    learnt = true;
                }
            }
            let error_n = pass.error_rms_n(index);
            if pass.weight(index) < 0.1 {
                if error_n > 0.0 {
                    stroke.error_without_n = error_n;
                }
            } else if stroke.error_without_n > 0.0
                && error_n > WORSE_FACTOR * stroke.error_without_n + WORSE_LEAST_N
            {
                stroke.bins.iter_mut().for_each(|bin| bin.weight *= 0.5);
            }
        }
        if learnt {
            self.passes = self.passes.saturating_add(1);
        }
    }
}

fn contradicts(bin: &Bin, point: &Point) -> bool {
    angle_between(&Vector3::from(bin.tangent), &point.tangent) > CONTRADICTION_RAD
}

/// What a pass measured in a stroke, by bin.
fn points<'a>(
    stroke: &'a Stroke,
    pass: &'a Pass,
    index: usize,
) -> impl Iterator<Item = (usize, Point)> + 'a {
    (0..stroke.bins.len()).filter_map(move |bin| {
        let point = pass.smoothed(index, stroke.place_m(bin))?;
        Some((bin, point))
    })
}

fn update(bin: &mut Bin, point: &Point, change_max_rad: f64, is_other_part: bool) {
    let tangent = Vector3::from(bin.tangent);
    let angle = angle_between(&tangent, &point.tangent);
    if bin.passes == 0 || is_other_part || contradicts(bin, point) {
        // The first pass here, or another surface: what was known is replaced, and a replacement
        // has no weight before the next pass confirms it.
        let weight = if bin.passes == 0 { WEIGHT_STEP } else { 0.0 };
        *bin = Bin {
            passes: 1,
            weight,
            position: point.position.into(),
            tangent: point.tangent.into(),
            normal: point.normal.into(),
            correction: point.correction,
        };
        return;
    }
    bin.passes = (bin.passes + 1).min(AVERAGED_MAX);
    let gain = 1.0 / f64::from(bin.passes);
    let limited = gain.min(change_max_rad / angle.max(1e-9));
    let turned = tangent.lerp(&point.tangent, limited);
    let position = Vector3::from(bin.position).lerp(&point.position, gain);
    let old_normal = Vector3::from(bin.normal);
    let turn = angle_between(&old_normal, &point.normal);
    let normal = old_normal.lerp(&point.normal, gain.min(change_max_rad / turn.max(1e-9)));
    if let (Some(tangent), Some(normal)) = (turned.try_normalize(0.1), normal.try_normalize(0.1)) {
        bin.tangent = tangent.into();
        bin.normal = normal.into();
        bin.position = position.into();
        let step = (point.correction - bin.correction) * gain;
        bin.correction += step.clamp(-change_max_rad, change_max_rad);
        bin.weight = (bin.weight + WEIGHT_STEP).min(1.0);
    }
}

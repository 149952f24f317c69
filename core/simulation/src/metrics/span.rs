//! The cycles of a run that the figures cover.

use std::borrow::Cow;

use tangent_control::Phase;

use super::sample::CycleSample;

/// Time after first contact that the settled figures leave out, s.
pub const SETTLING_LEFT_OUT_S: f64 = 1.0;

/// The cycles in which the tool is meant to be on the surface: without its ways above the surface,
/// from stroke to stroke, up to the touch at their end.
pub(super) fn meant_to_touch(span: &[CycleSample]) -> Cow<'_, [CycleSample]> {
    if !span.iter().any(|sample| sample.phase == Phase::Lift) {
        return Cow::Borrowed(span);
    }
    let mut above = false;
    let mut meant = Vec::with_capacity(span.len());
    for sample in span {
        above = sample.phase == Phase::Lift
            || above && sample.phase == Phase::Seek && !sample.touches();
        if !above {
            meant.push(*sample);
        }
    }
    Cow::Owned(meant)
}

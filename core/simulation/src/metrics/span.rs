//! The cycles of a run that the figures cover.

use std::borrow::Cow;

use tangent_control::Phase;

use super::sample::CycleSample;

/// Time after first contact that the settled figures leave out, s.
pub const SETTLING_LEFT_OUT_S: f64 = 1.0;

/// The cycles in which the tool is meant to be on the surface: without its ways above the surface,
/// from stroke to stroke or past something in the way, up to the touch at their end. A way above
/// the surface after a lost contact is part of the search for it.
pub(super) fn meant_to_touch(span: &[CycleSample]) -> Cow<'_, [CycleSample]> {
    if !span.iter().any(|sample| sample.phase == Phase::Lift) {
        return Cow::Borrowed(span);
    }
    let mut above = false;
    let mut slid = false;
    let mut meant = Vec::with_capacity(span.len());
    for sample in span {
        above = match sample.phase {
            Phase::Lift => above || slid,
            Phase::Seek => above && !sample.touches(),
            _ => false,
        };
        slid = sample.phase == Phase::Slide && sample.touches();
        if !above {
            meant.push(*sample);
        }
    }
    Cow::Owned(meant)
}

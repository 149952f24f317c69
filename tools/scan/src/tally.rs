//! What became of the images: counts, and words for a person.

/// Fastest motion of the surface past the camera, m/s: at 10 ms between the stamps of camera and
/// arm, this displaces points by 1.5 mm.
pub const FAST_M_PER_S: f64 = 0.15;

/// Counts of depth images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    /// Images that arrived.
    pub received: usize,
    /// Images that were placed, of which a bounded number is kept.
    pub placed: usize,
    /// Images older than one before them.
    pub out_of_order: usize,
    /// Images stamped long before the newest state of the arm.
    pub late: usize,
    /// Images stamped after the newest state of the arm.
    pub ahead: usize,
    /// Images without a state of the arm around their stamp, or without a calibration.
    pub unplaced: usize,
    /// Images taken while the camera moved too fast.
    pub fast: usize,
    /// Images without a reading in range.
    pub blank: usize,
    /// Messages that cannot be used.
    pub refused: usize,
    /// Why the first of them was refused.
    pub refusal: Option<String>,
    /// Largest lateness, and largest lead, of an image that was left out for it, s.
    pub apart_s: [f64; 2],
}

impl Tally {
    pub(crate) fn refuse(&mut self, reason: String) {
        self.refused += 1;
        self.refusal.get_or_insert(reason);
    }

    /// Why images were left out, with their numbers; empty if none was.
    pub fn left_out(&self) -> Vec<String> {
        let [late_s, lead_s] = self.apart_s;
        let refusal = self.refusal.as_deref().unwrap_or_default();
        [
            (
                self.out_of_order,
                "older than an image before them: two drivers on one topic, or a burst after a cut"
                    .to_owned(),
            ),
            (
                self.late,
                format!(
                    "stamped up to {late_s:.1} s before the arm/state of their arrival: compare the clocks of \
                     the hosts of camera and arm (`tangent doctor`)"
                ),
            ),
            (
                self.ahead,
                format!(
                    "stamped up to {lead_s:.1} s after the newest arm/state: compare the clocks of the hosts of \
                     camera and arm (`tangent doctor`), or arm/state has stopped"
                ),
            ),
            (
                self.unplaced,
                "without arm/state around their stamp, or before the first camera/info".to_owned(),
            ),
            (
                self.fast,
                format!("taken at more than {FAST_M_PER_S} m/s: move the arm more slowly"),
            ),
            (
                self.blank,
                "without a reading between 0.02 and 3 m".to_owned(),
            ),
            (self.refused, format!("refused: {refusal}")),
        ]
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, why)| format!("{count} {why}"))
        .collect()
    }
}

//! Which of a task's estimators a torque law goes by: when the next is taken, when a switch is refused.

use arrayvec::ArrayVec;
use tangent_control::{EstimatorName, MAX_ESTIMATORS, SwitchCause, SwitchRefusal};
use tangent_sensing::Validity;

/// Normals that differ by more are not switched between without force, where the task says nothing else, rad.
pub const SWITCH_GATE_RAD: f64 = 0.2;

/// Per estimator of the list: that it can be used, or why not.
pub type Judged = ArrayVec<Result<(), Validity>, MAX_ESTIMATORS>;

/// What one that said `validity`, `age_s` ago, is good for; none where it said nothing.
pub fn judge(said: Option<(Validity, f64)>, patience_s: f64) -> Result<(), Validity> {
    match said {
        None => Err(Validity::Missing),
        Some((_, age_s)) if age_s > patience_s => Err(Validity::Stale),
        Some((validity, _)) if !validity.is_valid() => Err(validity),
        Some(_) => Ok(()),
    }
}

/// See the module. The law itself moves over to another estimate at its bounded speed, whatever is chosen here.
#[derive(Clone, Debug)]
pub struct Choice {
    names: ArrayVec<EstimatorName, MAX_ESTIMATORS>,
    gate_rad: f64,
    active: usize,
    cause: SwitchCause,
    switches: u32,
}

impl Choice {
    /// In the order of the task's list. `gate_rad` is how far the normal of a chosen one may lie from that in use.
    pub fn new(names: impl IntoIterator<Item = EstimatorName>, gate_rad: f64) -> Self {
        Self {
            names: names.into_iter().take(MAX_ESTIMATORS).collect(),
            gate_rad,
            active: 0,
            cause: SwitchCause::Task,
            switches: 0,
        }
    }

    /// The next that can be used, where the one in use cannot. Returns the place of the one in use.
    pub fn fall_back(&mut self, judged: &Judged) -> usize {
        if let Some(Err(reason)) = judged.get(self.active)
            && let Some(other) = judged.iter().position(Result::is_ok)
        {
            self.switch(other, SwitchCause::FellBack(*reason));
        }
        self.active
    }

    /// Takes another of the list. `angle_rad` says how far the normal of one at a place is from that in use; `force` waives that and its
    /// validity.
    ///
    /// # Errors
    /// Unknown, silent, invalid, or too far from the one in use.
    pub fn select(
        &mut self,
        name: &EstimatorName,
        force: bool,
        judged: &Judged,
        angle_rad: impl Fn(usize) -> Option<f64>,
    ) -> Result<(), SwitchRefusal> {
        let index = self
            .names
            .iter()
            .position(|known| known == name)
            .ok_or(SwitchRefusal::Unknown)?;
        match judged.get(index) {
            None | Some(Err(Validity::Missing | Validity::Stale)) => {
                return Err(SwitchRefusal::Silent);
            }
            Some(Err(validity)) if !force => return Err(SwitchRefusal::Invalid(*validity)),
            _ => {}
        }
        if !force
            && let Some(angle_rad) = angle_rad(index)
            && angle_rad > self.gate_rad
        {
            return Err(SwitchRefusal::Disagrees {
                angle_rad,
                allowed_rad: self.gate_rad,
            });
        }
        if index != self.active {
            let cause = if force {
                SwitchCause::Forced
            } else {
                SwitchCause::Asked
            };
            self.switch(index, cause);
        }
        Ok(())
    }

    /// Name of the one in use, changes since the task started, and why this one.
    pub fn in_use(&self) -> (EstimatorName, u32, SwitchCause) {
        let name = self.names.get(self.active).copied();
        (name.unwrap_or_default(), self.switches, self.cause)
    }

    /// Place of the one in use.
    pub fn active(&self) -> usize {
        self.active
    }

    fn switch(&mut self, index: usize, cause: SwitchCause) {
        self.active = index;
        self.cause = cause;
        self.switches += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> EstimatorName {
        EstimatorName::from(text).unwrap()
    }

    fn said(judged: &[Result<(), Validity>]) -> Judged {
        judged.iter().copied().collect()
    }

    fn choice() -> Choice {
        Choice::new(["a", "b", "c"].map(name), 0.2)
    }

    #[test]
    fn silence_and_nonsense_take_the_next_that_can_be_used() {
        let mut choice = choice();
        let silent = Err(Validity::Stale);
        assert_eq!(choice.fall_back(&said(&[Ok(()); 3])), 0);
        let judged = said(&[silent, Err(Validity::NotFinite), Ok(())]);
        assert_eq!(choice.fall_back(&judged), 2);
        assert_eq!(choice.in_use().2, SwitchCause::FellBack(Validity::Stale));
        // Nobody: it stays.
        assert_eq!(choice.fall_back(&said(&[silent; 3])), 2);
        assert_eq!(choice.in_use().1, 1);
    }

    #[test]
    fn a_newcomer_must_be_known_fresh_valid_and_near() {
        let mut choice = choice();
        let judged = said(&[Ok(()), Err(Validity::Stale), Err(Validity::NotFinite)]);
        let far = |_| Some(0.3);
        let refused = choice.select(&name("x"), true, &judged, far);
        assert_eq!(refused, Err(SwitchRefusal::Unknown));
        let refused = choice.select(&name("b"), true, &judged, far);
        assert_eq!(refused, Err(SwitchRefusal::Silent));
        let refused = choice.select(&name("c"), false, &judged, far);
        assert_eq!(refused, Err(SwitchRefusal::Invalid(Validity::NotFinite)));
        let good = said(&[Ok(()); 3]);
        let refused = choice.select(&name("c"), false, &good, far);
        assert!(matches!(refused, Err(SwitchRefusal::Disagrees { .. })));
        assert_eq!(choice.in_use().1, 0);
        choice.select(&name("c"), true, &judged, far).unwrap();
        assert_eq!(choice.in_use(), (name("c"), 1, SwitchCause::Forced));
        choice
            .select(&name("a"), false, &good, |_| Some(0.1))
            .unwrap();
        assert_eq!(choice.in_use(), (name("a"), 2, SwitchCause::Asked));
    }
}

//! Whether the surface ends or falls away under the tool.
//!
//! Called by `response_guard` in each cycle. A tool that moves in without an answer, or is held
//! aside, with much less force than it had pressed with, may be over a rim; or the surface is
//! steeper than the normal in use says, and the force law cannot follow at this speed. So the first
//! such sign is a doubt, in which the path should stand. On a surface the force then comes back.

/// Time constant of the mean forces, s; shares of the reference that the pressing force has reached
/// and below which it has fallen.
const MEAN_S: f64 = 0.04;
const REACHED_SHARE: f64 = 0.8;
const FALLEN_SHARE: f64 = 0.7;
/// Time that the path takes to stand, s.
const BRAKES_S: f64 = 0.2;

/// Force in one cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Felt {
    /// Whether the tool is meant to press.
    pub pressing: bool,
    /// Part of the force along the normal in use, and the whole force, N.
    pub force_n: f64,
    pub whole_n: f64,
    /// Reference of the pressing force, N.
    pub reference_n: f64,
    /// Period, s.
    pub dt_s: f64,
}

/// State for one task. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FallingAway {
    /// Means of the pressing force and of the whole force, N.
    mean_n: f64,
    whole_n: f64,
    /// Whether the first has reached its reference in this task.
    reached: bool,
    /// Time since the first sign, s, until the force is back.
    doubted_s: Option<f64>,
    ended: bool,
}

impl FallingAway {
    /// Processes the force of one cycle; returns whether a tool that had pressed with its reference
    /// now presses with much less.
    pub fn presses_less(&mut self, felt: &Felt) -> bool {
        let share = felt.dt_s / (felt.dt_s + MEAN_S);
        self.mean_n += (felt.force_n - self.mean_n) * share;
        self.whole_n += (felt.whole_n - self.whole_n) * share;
        let reaches = self.mean_n >= REACHED_SHARE * felt.reference_n;
        self.reached |= felt.pressing && reaches;
        if reaches || !felt.pressing {
            self.doubted_s = None;
        }
        // A force that has only turned aside is not less: that is the sensor, not the surface.
        // Once it has been less, what is aside is the rim.
        let fallen_n = match self.doubted_s {
            None => self.mean_n.max(self.whole_n) / FALLEN_SHARE,
            Some(_) => self.mean_n / REACHED_SHARE,
        };
        felt.pressing && self.reached && fallen_n < felt.reference_n
    }

    /// Takes one cycle in which the tool presses less; `shown`: it has moved in without an answer,
    /// or is held aside. Returns whether to look for such a sign anew: one from before the path
    /// stood says nothing.
    pub fn looks_again(&mut self, shown: bool, dt_s: f64) -> bool {
        match &mut self.doubted_s {
            None => {
                self.doubted_s = shown.then_some(0.0);
                shown
            }
            Some(doubted_s) if *doubted_s < BRAKES_S => {
                *doubted_s += dt_s;
                true
            }
            Some(_) => {
                self.ended |= shown;
                false
            }
        }
    }

    /// Whether there was a sign, and the force is not back since.
    pub fn is_doubted(&self) -> bool {
        self.doubted_s.is_some()
    }

    /// Whether there was a sign when the path stood: the surface ends or falls away there.
    pub fn has_ended(&self) -> bool {
        self.ended
    }
}

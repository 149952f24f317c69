//! The path of commands to the arm: which answers of the controller arrive, and which are accepted.

use tangent_actuation::lease::{SILENCE_S, Source};

/// Effect of a fault on an answer on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// The answer arrives.
    Open,
    /// The last answer before the fault arrives in its place.
    Repeated,
    /// The answer arrives together with the next one, and after it.
    Swapped,
}

/// The path, with the answers that it holds back.
#[derive(Debug)]
pub struct Arrivals<T> {
    last_sent: Option<T>,
    held_back: Option<T>,
}

impl<T> Default for Arrivals<T> {
    fn default() -> Self {
        Self {
            last_sent: None,
            held_back: None,
        }
    }
}

impl<T: Clone> Arrivals<T> {
    /// The answers that arrive in the cycle in which `sent` is sent. `disturb` applies the faults
    /// to the answer.
    pub fn pass(&mut self, way: Way, mut sent: T, disturb: impl FnOnce(&mut T)) -> Vec<T> {
        if way == Way::Repeated {
            return self.last_sent.clone().into_iter().collect();
        }
        self.last_sent = Some(sent.clone());
        disturb(&mut sent);
        if way == Way::Swapped {
            return match self.held_back.take() {
                Some(older) => vec![sent, older],
                None => {
                    self.held_back = Some(sent);
                    Vec::new()
                }
            };
        }
        vec![sent]
    }

    /// Discards the answers that are held back.
    pub fn forget(&mut self) {
        self.held_back = None;
    }
}

/// The newest command that `admit` accepts. `own` is the controller of the cell, which was last
/// accepted at `spoke_s`. Asserts that no other source is accepted beside it.
pub fn newest<T>(
    queue: Vec<(Source, T)>,
    own: &Source,
    spoke_s: &mut f64,
    now_s: f64,
    mut admit: impl FnMut(&Source, &T) -> bool,
) -> Option<T> {
    let mut newest = None;
    for (source, sent) in queue {
        let admitted = admit(&source, &sent);
        let is_own = source == *own;
        assert!(
            is_own || !admitted || now_s - *spoke_s > SILENCE_S,
            "a second source is let in beside the first"
        );
        if admitted {
            if is_own {
                *spoke_s = now_s;
            }
            newest = Some(sent);
        }
    }
    newest
}

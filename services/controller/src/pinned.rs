//! Ties a task to the arm on which it was started.

/// Publisher of the `arm/state` on which the task was started.
#[derive(Clone, Copy, Debug, Default)]
pub struct PinnedArm {
    of: Option<[u8; 16]>,
}

impl PinnedArm {
    /// Whether this state comes from another publisher than the one that the running task was
    /// started on. Without a task every publisher is followed.
    pub fn is_another(&mut self, publisher: [u8; 16], active: bool) -> bool {
        match self.of {
            Some(of) if active => of != publisher,
            _ => {
                self.of = Some(publisher);
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_follows_until_a_task_runs_and_again_after_it() {
        let (a, b) = ([1; 16], [2; 16]);
        let mut arm = PinnedArm::default();
        assert!(!arm.is_another(a, false) && !arm.is_another(b, false));
        assert!(!arm.is_another(b, true) && arm.is_another(a, true) && !arm.is_another(b, true));
        assert!(!arm.is_another(a, false) && !arm.is_another(a, true));
    }
}

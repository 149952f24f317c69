//! The pages that are open, and when their loss has to be answered.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// Largest number of pages that are remembered.
const PAGES_MAX: usize = 64;

/// Signs of life of the pages.
pub struct Pages {
    after: Duration,
    seen: HashMap<String, (Instant, bool)>,
    /// Last sign of life of a page, or of a program, that may command.
    commanded: Option<Instant>,
    /// A task runs that was started or resumed from a page.
    armed: bool,
}

impl Pages {
    /// A page counts as lost after this time without a sign of life.
    pub fn new(after: Duration) -> Self {
        Self {
            after,
            seen: HashMap::new(),
            commanded: None,
            armed: false,
        }
    }

    /// The page with this number is there.
    pub fn here(&mut self, page: &str, may_command: bool, now: Instant) {
        self.forget(now);
        if may_command {
            self.commanded = Some(now);
        }
        if self.seen.len() < PAGES_MAX || self.seen.contains_key(page) {
            self.seen.insert(page.to_owned(), (now, may_command));
        }
    }

    /// A task was started or resumed from a page.
    pub fn started(&mut self, now: Instant) {
        self.commanded = Some(now);
        self.armed = true;
    }

    /// Number of pages, and of those that may command.
    pub fn count(&mut self, now: Instant) -> (usize, usize) {
        self.forget(now);
        let commanding = self.seen.values().filter(|(_, may)| *may).count();
        (self.seen.len(), commanding)
    }

    fn forget(&mut self, now: Instant) {
        let after = self.after;
        self.seen.retain(|_, (seen, _)| now - *seen <= after);
    }

    /// Whether the loss of every page that may command has to be answered now: once, while a task
    /// is active that was started from a page.
    pub fn are_lost(&mut self, is_active: bool, now: Instant) -> bool {
        let since = self.commanded.map(|at| now - at);
        // A task that was just started may not be active yet.
        if !is_active && since.is_none_or(|since| since > self.after) {
            self.armed = false;
        }
        let lost = self.armed && is_active && since.is_none_or(|since| since > self.after);
        if lost {
            self.armed = false;
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AFTER: Duration = Duration::from_secs(3);
    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_loss_is_answered_once_while_a_task_of_a_page_runs() {
        let (mut pages, begun) = (Pages::new(AFTER), Instant::now());
        pages.started(begun);
        for second in 0..10 {
            pages.here("a", true, begun + SECOND * second);
            assert!(!pages.are_lost(true, begun + SECOND * second));
        }
        // A page that only reads does not replace the one that commands.
        for second in 10..13 {
            pages.here("b", false, begun + SECOND * second);
            assert!(!pages.are_lost(true, begun + SECOND * second));
        }
        assert!(pages.are_lost(true, begun + SECOND * 13));
        assert!(!pages.are_lost(true, begun + SECOND * 14));
        // Resumed by hand on another page.
        pages.started(begun + SECOND * 20);
        assert!(!pages.are_lost(true, begun + SECOND * 22));
        assert!(pages.are_lost(true, begun + SECOND * 24));
    }

    #[test]
    fn a_task_of_a_terminal_goes_on_without_any_page() {
        let (mut pages, begun) = (Pages::new(AFTER), Instant::now());
        pages.here("a", true, begun);
        assert!(!pages.are_lost(true, begun + SECOND * 60));
        // Neither does a task that a terminal starts after one of a page has ended.
        pages.started(begun + SECOND * 60);
        assert!(!pages.are_lost(false, begun + SECOND * 70));
        assert!(!pages.are_lost(true, begun + SECOND * 80));
    }

    #[test]
    fn pages_are_counted_and_their_number_is_bounded() {
        let (mut pages, begun) = (Pages::new(AFTER), Instant::now());
        for page in 0..1000 {
            pages.here(&page.to_string(), page % 2 == 0, begun);
        }
        assert_eq!(pages.count(begun), (PAGES_MAX, PAGES_MAX / 2));
        assert_eq!(pages.count(begun + SECOND * 4), (0, 0));
    }
}

//! Random sequences of requests to the mailbox: a refused request has no effect, and an accepted
//! one has exactly one.
//!
//! One test steps through thousands of interleavings with a simulated clock, one uses threads.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use super::*;

/// A small seeded generator: the same interleavings in every run.
struct Draw(u64);

impl Draw {
    fn below(&mut self, bound: u64) -> u64 {
        // xorshift64* (Vigna, 2016).
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) % bound
    }
}

/// A program is the number of its request.
type Number = u32;

fn action(number: Number, kind: u64) -> Action<Number> {
    match kind {
        0 => Action::Pause,
        1 => Action::Stop,
        _ => Action::Start {
            program: Box::new(Some(number)),
            said_clear: false,
        },
    }
}

/// One request of a history.
struct Entry {
    number: Number,
    kind: u64,
    received: Instant,
    /// Whether a stop was requested after it arrived and before the loop claimed it.
    stopped: bool,
}

/// Requesters and a loop take single steps in random order; each step is one that threads can take
/// between the steps of others.
fn history(seed: u64) -> (usize, usize, usize) {
    let mut draw = Draw(seed);
    let mailbox = Mailbox::<Number>::default();
    let begin = mailbox.epoch;
    let mut now = begin + Duration::from_secs(1);
    let mut open: Vec<(Entry, Posted<'_, Number>)> = Vec::new();
    // Requests that the loop has seen waiting, and those that it has claimed.
    let (mut slots, mut held) = (Vec::new(), Vec::<(MailboxRequest<Number>, usize)>::new());
    let mut effects: HashSet<Number> = HashSet::new();
    let (mut done, mut refused) = (HashSet::new(), HashSet::new());
    // Number of the request in each slot.
    let mut in_slot = [0; SLOTS];
    let mut number = 0;
    let mut steps = 0;
    let mut ending = false;
    while !ending || !open.is_empty() {
        steps += 1;
        ending |= number == 60;
        match draw.below(10) {
            0 | 1 if !ending => {
                let kind = draw.below(6);
                let late = Duration::from_millis(draw.below(40));
                let received = now - Duration::from_millis(draw.below(30));
                let request = action(number, kind);
                let Some(index) = mailbox.reserve(&request) else {
                    continue;
                };
                in_slot[index] = number;
                let deadline = now + late;
                let posted = mailbox.post(index, request, Time { received, deadline });
                let entry = Entry {
                    number,
                    kind,
                    received,
                    stopped: false,
                };
                open.push((entry, posted));
                number += 1;
            }
            2 => {
                mailbox.stop_asked(now);
                for (entry, _) in &mut open {
                    entry.stopped |= entry.received < now && !effects.contains(&entry.number);
                }
            }
            3 => now += Duration::from_millis(draw.below(15)),
            4 => slots.extend(mailbox.waiting()),
            5 | 6 if !slots.is_empty() => {
                let index = slots.remove(0);
                if let Some(request) = mailbox.take(index, now) {
                    // From here on the loop carries out the request.
                    let number = in_slot[index];
                    assert!(effects.insert(number), "{number} twice, seed {seed}");
                    held.push((request, index));
                }
            }
            7 if !held.is_empty() => {
                let (request, _) = held.remove(0);
                let (activation, phase) = (1, Phase::Slide);
                request.answer(Outcome::Done { activation, phase });
            }
            _ if !open.is_empty() => {
                let at = draw.below(open.len() as u64) as usize;
                if let Some(outcome) = open[at].1.poll(now) {
                    let (entry, _) = open.swap_remove(at);
                    let is_done = matches!(outcome, Ok(Outcome::Done { .. }));
                    assert!(!matches!(outcome, Err(Silence::Lost)), "seed {seed}");
                    assert!(
                        !(is_done && entry.stopped && entry.kind > 1),
                        "{} started after a stop, seed {seed}",
                        entry.number
                    );
                    if is_done { &mut done } else { &mut refused }.insert(entry.number);
                }
            }
            _ => {}
        }
    }
    assert_eq!(done, effects, "seed {seed}");
    assert!(refused.is_disjoint(&effects), "seed {seed}");
    assert_eq!(done.len() + refused.len(), number as usize);
    (done.len(), refused.len(), steps)
}

#[test]
fn refused_means_no_effect_in_every_interleaving() {
    let (mut done, mut refused, mut steps) = (0, 0, 0);
    for seed in 1..=5_000 {
        let (d, r, s) = history(seed);
        (done, refused, steps) = (done + d, refused + r, steps + s);
    }
    println!("5000 histories, seeds 1 to 5000: {done} done, {refused} refused, {steps} steps");
    // Both outcomes occurred.
    assert!(done > 20_000 && refused > 20_000);
}

#[test]
fn refused_means_no_effect_between_threads() {
    let mailbox = Mailbox::<Number>::default();
    let ended = AtomicBool::new(false);
    let (effects, outcomes) = std::thread::scope(|scope| {
        let turning = scope.spawn(|| {
            let mut draw = Draw(7);
            let mut effects = HashSet::new();
            while !ended.load(Ordering::Acquire) {
                for index in mailbox.waiting() {
                    if let Some(mut request) = mailbox.take(index, Instant::now()) {
                        if let Action::Start { program, .. } = request.action() {
                            effects.insert(program.take().unwrap());
                        }
                        let (activation, phase) = (1, Phase::Slide);
                        request.answer(Outcome::Done { activation, phase });
                    }
                }
                // Some cycles follow at once, some after a deadline.
                std::thread::park_timeout(Duration::from_micros(draw.below(300)));
            }
            effects
        });
        let askers: Vec<_> = (0..4)
            .map(|asker| {
                let mailbox = &mailbox;
                scope.spawn(move || {
                    let mut draw = Draw(100 + asker);
                    (0..2_000)
                        .map(|i| {
                            let number = (asker as u32) * 10_000 + i;
                            let received = Instant::now();
                            let deadline = received + Duration::from_micros(draw.below(300));
                            let request = action(number, 2);
                            let outcome = mailbox.ask(request, Time { received, deadline });
                            (number, matches!(outcome, Ok(Outcome::Done { .. })))
                        })
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        let outcomes: Vec<_> = askers.into_iter().flat_map(|a| a.join().unwrap()).collect();
        ended.store(true, Ordering::Release);
        (turning.join().unwrap(), outcomes)
    });
    for (number, done) in outcomes {
        assert_eq!(done, effects.contains(&number), "request {number}");
    }
}

#[test]
fn a_loop_that_ends_during_a_request_is_reported() {
    let mailbox = Mailbox::<Number>::default();
    let time = Time::now();
    std::thread::scope(|scope| {
        let asking = scope.spawn(|| mailbox.ask(Action::Pause, time));
        let request = loop {
            if let Some(index) = mailbox.waiting().next() {
                break mailbox.take(index, time.received);
            }
            std::thread::yield_now();
        };
        assert!(request.is_some());
        drop(request);
        assert!(matches!(asking.join().unwrap(), Err(Silence::Lost)));
    });
}

#[test]
fn a_stop_gets_a_slot_when_all_others_are_taken_and_is_handled_last() {
    let mailbox = Mailbox::<Number>::default();
    let time = Time::now();
    let ordinary: Vec<_> = (0..ORDINARY)
        .map(|i| {
            let index = mailbox.reserve(&Action::Resume).unwrap();
            mailbox.post(index, action(i as u32, 2), time)
        })
        .collect();
    assert!(mailbox.reserve(&Action::Resume).is_none());
    let index = mailbox.reserve(&Action::Stop).unwrap();
    let _stop = mailbox.post(index, Action::Stop, time);
    let order: Vec<usize> = mailbox.waiting().collect();
    assert_eq!(order.len(), ORDINARY + 1);
    let mut last = mailbox.take(order[ORDINARY], time.received).unwrap();
    assert!(matches!(last.action(), Action::Stop));
    drop(ordinary);
}

//! A sensor that stands still behind records that go on: whole records that repeat, or one axis of
//! them.
//!
//! An analogue sensor is never quite still: its converters see noise, so consecutive counts differ
//! most of the time. The watch learns how often, at the quietest that the sensor has been, and
//! calls a run of repeats a fault when noise alone would make one like it less than once in 10^11
//! records. A sensor that repeats by its nature (coarse resolution, an ideal one in a simulation)
//! is never judged by its repeats: they are likely. What it cannot do either is to repeat to the
//! count while a tool that presses moves on.

use nalgebra::Vector3;

/// How a sensor's standstill is told from a quiet moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatchConfig {
    /// Probability of a run of repeats below which it is a fault.
    pub false_alarm: f64,
    /// Time of one look at the noise, s; nothing is judged before the first is over.
    pub window_s: f64,
    /// A shorter standstill is a hiccup, s.
    pub least_s: f64,
    /// The fault is over when everything has lived for so long, s.
    pub heal_s: f64,
    /// A loaded tool that moves so far under records that repeat exactly has a frozen sensor, noise
    /// or not, m.
    pub way_max_m: f64,
}

impl Default for RecordWatchConfig {
    fn default() -> Self {
        Self {
            false_alarm: 1e-11,
            window_s: 1.0,
            least_s: 0.003,
            heal_s: 0.5,
            way_max_m: 1.5e-3,
        }
    }
}

/// Looks that the quietest one is kept of: it is remembered for one to two such blocks, 4 to 8
/// minutes.
const BLOCK_WINDOWS: u32 = 256;
/// Fewest pairs of records in a look.
const PAIRS_MIN: u32 = 64;
/// Least share of steps by more than one count: an axis with less of it is too coarse for its
/// noise, and may rightly stand still.
const WIDE_MIN: f64 = 0.02;
/// Least share of changes of direction: what moves without them is a load that moves, not noise.
const TURNS_MIN: f64 = 0.01;
/// Repeats at the worst place between two counts, by the noise's mean step in counts: at most 0.65
/// where [`WIDE_MIN`] holds; for wider noise 0.32 counts over the step, and half as much again.
const REPEAT_MAX: f64 = 0.65;
const REPEAT_PER_COUNT: f64 = 0.5;
/// An axis that repeats more often than this is not judged.
const LIVELY_MAX: f64 = 0.8;
/// A whole record that repeats by chance is believed to be no rarer than this.
const WHOLE_MIN: f64 = 1e-6;
/// Share of repeated whole records from which on the box sends faster than it measures, and from
/// which on the sensor is still.
const OVERSAMPLED: f64 = 0.3;
const STILL: f64 = 0.9;

/// What a run of records says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordVerdict {
    /// Nothing against it, or nothing learnt yet.
    Plausible,
    /// Whole records repeat.
    Frozen,
    /// These axes repeat while others live: bit 0 Fx to bit 5 Tz.
    AxisStuck(u8),
}

/// The watch's numbers for one rate of records; all memory is in [`RecordWatchState`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatch {
    ln_false_alarm: f64,
    window: u32,
    least: u32,
    heal: u32,
    way_max_m: f64,
}

/// Noise of one look, or of the quietest of many.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Noise {
    /// Share of pairs that repeat as a whole.
    repeats: f64,
    /// Share of the other pairs in which an axis repeats.
    same: [f64; 6],
    /// Mean step, counts.
    step: [f64; 6],
    /// Share of pairs with a step of more than one count, and with a change of direction.
    wide: [f64; 6],
    turns: [f64; 6],
    /// Longest run of repeats that ended by itself, per axis and of whole records.
    longest: [u32; 6],
    longest_whole: u32,
}

/// Sums of a look that goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Look {
    pairs: u32,
    repeats: u32,
    same: [u32; 6],
    moved: [f64; 6],
    wide: [u32; 6],
    turns: [u32; 6],
    longest: [u32; 6],
    longest_whole: u32,
}

/// Memory of a [`RecordWatch`]. A new one is the reset: nothing learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatchState {
    last: Option<[i32; 6]>,
    /// Steps before the last one that was none.
    step: [i64; 6],
    /// Repeats in a row, up to now.
    run: [u32; 6],
    run_whole: u32,
    /// Smallest step ever seen: one count of the sensor's own.
    unit: [i64; 6],
    look: Look,
    pairs: u64,
    /// The quietest of the block before, and of this one, and how many looks this one has.
    quietest: [Option<Noise>; 2],
    looks: u32,
    /// Runs that are faults.
    bound: [u32; 6],
    bound_whole: u32,
    frozen: bool,
    stuck: u8,
    /// Records since the last that spoke against it, counted from the first that changed.
    healthy: u32,
    lived: bool,
    /// Where the tool pressed when the records began to repeat, m.
    stands_at: Option<Vector3<f64>>,
}

impl Default for RecordWatchState {
    fn default() -> Self {
        Self {
            last: None,
            step: [0; 6],
            run: [0; 6],
            run_whole: 0,
            unit: [i64::MAX; 6],
            look: Look::default(),
            pairs: 0,
            quietest: [None; 2],
            looks: 0,
            bound: [u32::MAX; 6],
            bound_whole: u32::MAX,
            frozen: false,
            stuck: 0,
            healthy: 0,
            lived: false,
            stands_at: None,
        }
    }
}

impl RecordWatchState {
    /// Axes that stand still: bit 0 Fx to bit 5 Tz.
    pub fn stuck_axes(&self) -> u8 {
        if self.frozen { 0x3f } else { self.stuck }
    }

    /// What comes next is not a neighbour of what came last: the sensor said itself that it was not
    /// right.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
        self.run = [0; 6];
        self.run_whole = 0;
        self.look = Look::default();
        self.stands_at = None;
    }
}

impl RecordWatch {
    /// For `rate_hz` records per second.
    pub fn new(config: &RecordWatchConfig, rate_hz: f64) -> Self {
        let records = |time_s: f64, least: u32| ((time_s * rate_hz).ceil() as u32).max(least);
        Self {
            ln_false_alarm: config.false_alarm.clamp(1e-300, 0.5).ln(),
            window: records(config.window_s, PAIRS_MIN),
            least: records(config.least_s, 2),
            heal: records(config.heal_s, 2),
            way_max_m: config.way_max_m,
        }
    }

    /// One record's counts, in the order of their measurement. `pressing_at` is where the tool is
    /// (m, in axes that rest), as long as it is known to press.
    pub fn take(
        &self,
        state: &mut RecordWatchState,
        counts: &[i32; 6],
        pressing_at: Option<Vector3<f64>>,
    ) -> RecordVerdict {
        let Some(last) = state.last.replace(*counts) else {
            return state.verdict();
        };
        let whole = last == *counts;
        state.look.pairs += 1;
        if whole {
            state.look.repeats += 1;
            state.run_whole = state.run_whole.saturating_add(1);
        } else {
            state.look.longest_whole = state.look.longest_whole.max(state.run_whole);
            state.run_whole = 0;
            for i in 0..6 {
                state.axis(i, i64::from(counts[i]) - i64::from(last[i]));
            }
        }
        if !whole || pressing_at.is_none() {
            state.stands_at = pressing_at;
        }
        let moved = match (state.stands_at, pressing_at) {
            (Some(from), Some(at)) => (at - from).norm() >= self.way_max_m,
            (None, at) => {
                state.stands_at = at;
                false
            }
            _ => false,
        };
        state.lived |= !whole;
        self.judge(state, moved);
        if state.frozen || state.stuck != 0 {
            // A fault is not learnt from.
            state.look = Look::default();
        } else if state.look.pairs >= self.window {
            self.learn(state);
        }
        state.verdict()
    }

    fn judge(&self, state: &mut RecordWatchState, moved: bool) {
        let frozen = moved || state.run_whole >= state.bound_whole;
        let mut stuck = 0;
        for i in 0..6 {
            if state.run[i] >= state.bound[i] {
                stuck |= 1 << i;
            }
        }
        if frozen || stuck != 0 {
            state.frozen |= frozen;
            state.stuck |= stuck;
            (state.healthy, state.lived) = (0, false);
        } else if (state.frozen || state.stuck != 0) && state.lived {
            state.healthy += 1;
            if state.healthy >= self.heal {
                (state.frozen, state.stuck, state.healthy) = (false, 0, 0);
            }
        }
    }

    /// One look is over.
    fn learn(&self, state: &mut RecordWatchState) {
        let look = std::mem::take(&mut state.look);
        state.pairs += u64::from(look.pairs - look.repeats);
        let noise = Noise::of(&look, &state.unit);
        if state.looks >= BLOCK_WINDOWS {
            state.quietest[0] = state.quietest[1].take();
            state.looks = 0;
        }
        state.looks += 1;
        let block = &mut state.quietest[1];
        *block = Some(block.map_or(noise, |quietest| quietest.quieter(&noise)));
        let quietest = match state.quietest {
            [Some(before), Some(now)] => before.quieter(&now),
            _ => state.quietest[1].unwrap_or(noise),
        };
        self.bound(state, &quietest);
    }

    /// From the noise, the shortest runs that it does not make.
    fn bound(&self, state: &mut RecordWatchState, noise: &Noise) {
        // What was never seen in n pairs may still happen once in so many.
        let unseen = 1.0 / (state.pairs as f64 + 2.0);
        let mut ln_whole = 0.0;
        for i in 0..6 {
            let lively = noise.repeats <= STILL
                && noise.wide[i] >= WIDE_MIN
                && noise.turns[i] >= TURNS_MIN
                && noise.same[i] <= LIVELY_MAX;
            if !lively {
                state.bound[i] = u32::MAX;
                continue;
            }
            let by_step = (REPEAT_PER_COUNT / noise.step[i]).min(REPEAT_MAX);
            let ln = noise.same[i].max(by_step).max(unseen).ln();
            ln_whole += ln;
            state.bound[i] = self.run_of(ln, 1, noise.longest[i]);
        }
        state.bound_whole = u32::MAX;
        if ln_whole < 0.0 {
            // Records per measurement: where every measurement comes several times, so must a
            // repeat of it.
            let copies = if noise.repeats >= OVERSAMPLED {
                noise.longest_whole.saturating_add(1)
            } else {
                1
            };
            let ln = ln_whole.max(WHOLE_MIN.ln());
            state.bound_whole = self.run_of(ln, copies, noise.longest_whole);
        }
    }

    /// Repeats in a row that are rarer than the false alarm, of measurements that come in `copies`
    /// records each, and rarer than what was seen.
    fn run_of(&self, ln_repeat: f64, copies: u32, longest: u32) -> u32 {
        let rare = (self.ln_false_alarm / ln_repeat).ceil();
        (rare as u32)
            .saturating_mul(copies)
            .max(longest.saturating_mul(2).saturating_add(1))
            .max(self.least)
    }
}

impl RecordWatchState {
    fn axis(&mut self, i: usize, step: i64) {
        let size = step.abs();
        if size == 0 {
            self.run[i] = self.run[i].saturating_add(1);
            self.look.same[i] += 1;
            return;
        }
        self.look.longest[i] = self.look.longest[i].max(self.run[i]);
        self.run[i] = 0;
        self.unit[i] = self.unit[i].min(size);
        self.look.moved[i] += size as f64;
        if size > self.unit[i] {
            self.look.wide[i] += 1;
        }
        if step.signum() == -self.step[i].signum() {
            self.look.turns[i] += 1;
        }
        self.step[i] = step;
    }

    fn verdict(&self) -> RecordVerdict {
        if self.frozen {
            RecordVerdict::Frozen
        } else if self.stuck != 0 {
            RecordVerdict::AxisStuck(self.stuck)
        } else {
            RecordVerdict::Plausible
        }
    }
}

impl Noise {
    fn of(look: &Look, unit: &[i64; 6]) -> Self {
        let pairs = f64::from((look.pairs - look.repeats).max(1));
        let share = |n: [u32; 6]| n.map(|n| f64::from(n) / pairs);
        Self {
            repeats: f64::from(look.repeats) / f64::from(look.pairs.max(1)),
            same: share(look.same),
            step: std::array::from_fn(|i| look.moved[i] / pairs / unit[i].max(1) as f64),
            wide: share(look.wide),
            turns: share(look.turns),
            longest: look.longest,
            longest_whole: look.longest_whole,
        }
    }

    /// Axis by axis the quieter of both.
    fn quieter(&self, other: &Self) -> Self {
        let least = |a: &[f64; 6], b: &[f64; 6]| std::array::from_fn(|i| a[i].min(b[i]));
        Self {
            repeats: self.repeats.max(other.repeats),
            same: std::array::from_fn(|i| self.same[i].max(other.same[i])),
            step: least(&self.step, &other.step),
            wide: least(&self.wide, &other.wide),
            turns: least(&self.turns, &other.turns),
            longest: std::array::from_fn(|i| self.longest[i].max(other.longest[i])),
            longest_whole: self.longest_whole.max(other.longest_whole),
        }
    }
}

#[cfg(test)]
#[path = "records_tests.rs"]
mod tests;

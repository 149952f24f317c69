//! Detection of a frozen sensor: records arrive, but whole records or single axes repeat.
//!
//! The converters of an analogue sensor see noise, so successive counts differ most of the time.
//! The watch learns how often they repeat in the quietest conditions so far. A run of repeats is a
//! fault if noise alone would produce it less than once in 10^11 records. A sensor that often
//! repeats (coarse resolution, or an ideal one in a simulation) is not judged by its repeats. But
//! no sensor may repeat exactly while a loaded tool moves.
//!
//! Of the repeats of one axis, only those count during which another axis shows noise. Otherwise
//! whatever excited the readings has ended: an estimate that is computed from an arm's torques then
//! settles axis by axis.

use nalgebra::Vector3;

/// Settings by which a frozen sensor is distinguished from a quiet one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatchConfig {
    /// Probability of a run of repeats below which it is a fault.
    pub false_alarm: f64,
    /// Length of one window in which the noise is measured, s. Nothing is judged before the end of
    /// the first.
    pub window_s: f64,
    /// Shortest standstill that counts as a fault, s.
    pub least_s: f64,
    /// Time for which all axes must vary before the fault ends, s.
    pub heal_s: f64,
    /// Distance that a loaded tool may move while records repeat exactly, m; beyond it, the sensor
    /// is frozen, whatever its noise.
    pub way_max_m: f64,
}

impl Default for RecordWatchConfig {
    fn default() -> Self {
        Self {
            false_alarm: 1e-11,
            window_s: 1.0,
            least_s: 0.002,
            heal_s: 0.5,
            way_max_m: 1.5e-3,
        }
    }
}

/// Number of windows in a block. The quietest window of the last one to two blocks (4 to 8 minutes)
/// is in use.
const BLOCK_WINDOWS: u32 = 256;
/// Smallest number of pairs of records in a window.
const PAIRS_MIN: u32 = 64;
/// Smallest share of steps by more than one count. An axis below it is too coarse for its noise,
/// and may repeat without a fault.
const WIDE_MIN: f64 = 0.02;
/// Smallest share of changes of direction. An axis that moves without them follows a load, not
/// noise.
const TURNS_MIN: f64 = 0.01;
/// Largest probability of a repeat at the worst place between two counts, if [`WIDE_MIN`] holds.
/// For wider noise it is 0.32 counts divided by the mean step, plus a margin of one half.
const REPEAT_MAX: f64 = 0.65;
const REPEAT_PER_COUNT: f64 = 0.5;
/// An axis that repeats more often than this is not judged.
const LIVELY_MAX: f64 = 0.8;
/// Smallest probability that is assumed for the repeat of a whole record by chance.
const WHOLE_MIN: f64 = 1e-6;
/// Share of repeated whole records above which the sensor sends faster than it measures.
const OVERSAMPLED: f64 = 0.3;
/// Share of repeated whole records above which the axes are not judged.
const STILL: f64 = 0.9;

/// Verdict on a run of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordVerdict {
    /// No fault found, or too few records so far.
    Plausible,
    /// Whole records repeat.
    Frozen,
    /// These axes repeat while others vary: bit 0 is Fx, bit 5 is Tz.
    AxisStuck(u8),
}

/// Watch for records that repeat, at one rate. The state is in [`RecordWatchState`].
///
/// ```
/// use tangent_sensing::{RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState};
///
/// let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
/// let mut state = RecordWatchState::default();
/// // Two seconds of noise, from a pseudo-random sequence.
/// let mut random = 1_u32;
/// let mut counts = [0; 6];
/// for _ in 0..2000 {
///     for count in &mut counts {
///         random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
///         *count = (random >> 24) as i32;
///     }
///     assert_eq!(watch.take(&mut state, &counts, None), RecordVerdict::Plausible);
/// }
/// // Then the last record repeats.
/// let last = (0..100).map(|_| watch.take(&mut state, &counts, None)).last();
/// assert_eq!(last, Some(RecordVerdict::Frozen));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatch {
    ln_false_alarm: f64,
    window: u32,
    least: u32,
    heal: u32,
    way_max_m: f64,
}

/// Noise in one window, or in the quietest of several.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Noise {
    /// Share of pairs in which the whole record repeats.
    repeats: f64,
    /// Share of the other pairs in which an axis repeats.
    same: [f64; 6],
    /// Mean step, counts.
    step: [f64; 6],
    /// Share of pairs with a step of more than one count.
    wide: [f64; 6],
    /// Share of pairs with a change of direction.
    turns: [f64; 6],
    /// Longest run of repeats per axis that ended without a fault.
    longest: [u32; 6],
    /// Longest run of repeated whole records that ended without a fault.
    longest_whole: u32,
}

/// Sums over the present window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct WindowSums {
    pairs: u32,
    repeats: u32,
    same: [u32; 6],
    moved: [f64; 6],
    wide: [u32; 6],
    turns: [u32; 6],
    longest: [u32; 6],
    longest_whole: u32,
}

/// State of a [`RecordWatch`]. A new one is the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordWatchState {
    last: Option<[i32; 6]>,
    /// Last step of each axis that was not zero.
    step: [i64; 6],
    /// Present number of successive repeats per axis.
    run: [u32; 6],
    run_whole: u32,
    /// Number of those repeats during which another axis changed its direction, as noise does.
    alone: [u32; 6],
    /// Smallest step so far: the resolution of the sensor in counts.
    unit: [i64; 6],
    window: WindowSums,
    pairs: u64,
    /// Noise in the quietest window of the block before, and of the present one.
    quietest: [Option<Noise>; 2],
    /// Number of windows in the present block.
    windows: u32,
    /// Length of a run of repeats from which it is a fault.
    bound: [u32; 6],
    bound_whole: u32,
    frozen: bool,
    stuck: u8,
    /// Number of records without a fault since the first that changed.
    healthy: u32,
    lived: bool,
    /// Position of the pressing tool when the records began to repeat, m.
    stands_at: Option<Vector3<f64>>,
}

impl Default for RecordWatchState {
    fn default() -> Self {
        Self {
            last: None,
            step: [0; 6],
            run: [0; 6],
            run_whole: 0,
            alone: [0; 6],
            unit: [i64::MAX; 6],
            window: WindowSums::default(),
            pairs: 0,
            quietest: [None; 2],
            windows: 0,
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
    /// Axes whose value stands still: bit 0 is Fx, bit 5 is Tz.
    pub fn stuck_axes(&self) -> u8 {
        if self.frozen { 0x3f } else { self.stuck }
    }

    /// Breaks the sequence, because the sensor itself has reported a fault: the next record is not
    /// compared with the last.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
        self.run = [0; 6];
        self.alone = [0; 6];
        self.run_whole = 0;
        self.window = WindowSums::default();
        self.stands_at = None;
    }
}

impl RecordWatch {
    /// Watch for `rate_hz` records per second.
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

    /// Judges the counts of one record. `pressing_at` is the position of the tool (m, axes at rest)
    /// while it is known to press.
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
        state.window.pairs += 1;
        if whole {
            state.window.repeats += 1;
            state.run_whole = state.run_whole.saturating_add(1);
        } else {
            state.window.longest_whole = state.window.longest_whole.max(state.run_whole);
            state.run_whole = 0;
            let mut turned = 0;
            for i in 0..6 {
                if state.axis(i, i64::from(counts[i]) - i64::from(last[i])) {
                    turned |= u8::from(state.bound[i] != u32::MAX) << i;
                }
            }
            for i in 0..6 {
                if state.run[i] > 0 && turned & !(1 << i) != 0 {
                    state.alone[i] = state.alone[i].saturating_add(1);
                }
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
            // No noise is learnt during a fault.
            state.window = WindowSums::default();
        } else if state.window.pairs >= self.window {
            self.learn(state);
        }
        state.verdict()
    }

    fn judge(&self, state: &mut RecordWatchState, moved: bool) {
        let frozen = moved || state.run_whole >= state.bound_whole;
        let mut stuck = 0;
        for i in 0..6 {
            if state.alone[i] >= state.bound[i] {
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

    /// Evaluates a complete window.
    fn learn(&self, state: &mut RecordWatchState) {
        let sums = std::mem::take(&mut state.window);
        state.pairs += u64::from(sums.pairs - sums.repeats);
        let noise = Noise::of(&sums, &state.unit);
        if state.windows >= BLOCK_WINDOWS {
            state.quietest[0] = state.quietest[1].take();
            state.windows = 0;
        }
        state.windows += 1;
        let block = &mut state.quietest[1];
        *block = Some(block.map_or(noise, |quietest| quietest.quieter(&noise)));
        let quietest = match state.quietest {
            [Some(before), Some(now)] => before.quieter(&now),
            _ => state.quietest[1].unwrap_or(noise),
        };
        self.bound(state, &quietest);
    }

    /// Computes the shortest runs that the noise does not produce.
    fn bound(&self, state: &mut RecordWatchState, noise: &Noise) {
        // An event that did not occur in n pairs may have a probability of 1/n.
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
            // Number of records per measurement: if each measurement is sent several times, so is a
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

    /// Number of successive repeats that is less probable than the false alarm and longer than any
    /// run so far, if each measurement is sent in `copies` records.
    fn run_of(&self, ln_repeat: f64, copies: u32, longest: u32) -> u32 {
        let rare = (self.ln_false_alarm / ln_repeat).ceil();
        (rare as u32)
            .saturating_mul(copies)
            .max(longest.saturating_mul(2).saturating_add(1))
            .max(self.least)
    }
}

impl RecordWatchState {
    /// Takes the step of axis `i`; returns whether it changed its direction.
    fn axis(&mut self, i: usize, step: i64) -> bool {
        let size = step.abs();
        if size == 0 {
            self.run[i] = self.run[i].saturating_add(1);
            self.window.same[i] += 1;
            return false;
        }
        self.window.longest[i] = self.window.longest[i].max(self.run[i]);
        (self.run[i], self.alone[i]) = (0, 0);
        self.unit[i] = self.unit[i].min(size);
        self.window.moved[i] += size as f64;
        if size > self.unit[i] {
            self.window.wide[i] += 1;
        }
        let turned = step.signum() == -self.step[i].signum();
        if turned {
            self.window.turns[i] += 1;
        }
        self.step[i] = step;
        turned
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
    fn of(sums: &WindowSums, unit: &[i64; 6]) -> Self {
        let pairs = f64::from((sums.pairs - sums.repeats).max(1));
        let share = |n: [u32; 6]| n.map(|n| f64::from(n) / pairs);
        Self {
            repeats: f64::from(sums.repeats) / f64::from(sums.pairs.max(1)),
            same: share(sums.same),
            step: std::array::from_fn(|i| sums.moved[i] / pairs / unit[i].max(1) as f64),
            wide: share(sums.wide),
            turns: share(sums.turns),
            longest: sums.longest,
            longest_whole: sums.longest_whole,
        }
    }

    /// The smaller noise of both, axis by axis.
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

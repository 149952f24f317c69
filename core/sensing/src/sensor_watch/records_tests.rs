//! A frozen sensor is noticed within two cycles at every rate, and a quiet one never.

use super::*;
use proptest::prelude::*;

/// Reproducible noise: sums of a linear congruential generator, approximately normal, standard
/// deviation 1.
struct Gauss(u64);

impl Gauss {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn next(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A reading with `noise` counts around a slowly varying mean, in steps of `unit`.
fn reading(gauss: &mut Gauss, time_s: f64, noise: f64, unit: f64) -> [i32; 6] {
    std::array::from_fn(|i| {
        let load = 4000.0 * (0.7 * time_s + i as f64).sin();
        ((load + noise * gauss.next()) / unit).round() as i32 * unit as i32
    })
}

/// Number of records until the verdict is no longer plausible.
fn records_until_noticed(
    watch: &RecordWatch,
    state: &mut RecordWatchState,
    mut next: impl FnMut() -> [i32; 6],
) -> (u32, RecordVerdict) {
    for n in 1..20_000 {
        let verdict = watch.take(state, &next(), None);
        if verdict != RecordVerdict::Plausible {
            return (n, verdict);
        }
    }
    (u32::MAX, RecordVerdict::Plausible)
}

fn learnt(
    rate_hz: f64,
    seconds: f64,
    noise: f64,
    unit: f64,
) -> (RecordWatch, RecordWatchState, Gauss) {
    let watch = RecordWatch::new(&RecordWatchConfig::default(), rate_hz);
    let mut state = RecordWatchState::default();
    let mut gauss = Gauss(7);
    for k in 0..(seconds * rate_hz) as u32 {
        let counts = reading(&mut gauss, f64::from(k) / rate_hz, noise, unit);
        assert_eq!(
            watch.take(&mut state, &counts, None),
            RecordVerdict::Plausible
        );
    }
    (watch, state, gauss)
}

#[test]
fn a_frozen_sensor_is_noticed_within_two_cycles_at_every_rate() {
    // Robots at 1 kHz and 125 Hz. A sensor as slow as the robot has two records in two cycles.
    for (rate_hz, cycle_s) in [(7000.0, 0.001), (1000.0, 0.001), (125.0, 0.008)] {
        for seconds in [2.0, 10.0] {
            let (watch, mut state, _) = learnt(rate_hz, seconds, 40_000.0, 1.0);
            let last = state.last.unwrap();
            let (n, verdict) = records_until_noticed(&watch, &mut state, || last);
            assert_eq!(verdict, RecordVerdict::Frozen);
            let time_s = f64::from(n) / rate_hz;
            assert!(time_s <= 2.0 * cycle_s, "{rate_hz} Hz: {time_s} s");
            assert_eq!(state.stuck_axes(), 0x3f);
        }
    }
}

#[test]
fn a_sensor_whose_noise_is_a_few_of_its_own_counts_is_noticed_too() {
    // A Gamma according to its data sheet: steps of 25 mN, noise of 45 mN per record at 1 kHz.
    let (watch, mut state, _) = learnt(1000.0, 5.0, 45_000.0, 25_000.0);
    let last = state.last.unwrap();
    let (n, verdict) = records_until_noticed(&watch, &mut state, || last);
    assert_eq!(verdict, RecordVerdict::Frozen);
    assert!(n <= 16, "{n} ms");
}

#[test]
fn one_stuck_axis_is_noticed_and_named() {
    for (rate_hz, cycle_s) in [(7000.0, 0.002), (1000.0, 0.008)] {
        for axis in 0..6 {
            let (watch, mut state, mut gauss) = learnt(rate_hz, 3.0, 40_000.0, 1.0);
            let stuck = state.last.unwrap()[axis];
            let mut k = 0;
            let (n, verdict) = records_until_noticed(&watch, &mut state, || {
                k += 1;
                let mut counts = reading(&mut gauss, 3.0 + f64::from(k) / rate_hz, 40_000.0, 1.0);
                counts[axis] = stuck;
                counts
            });
            assert_eq!(verdict, RecordVerdict::AxisStuck(1 << axis));
            let time_s = f64::from(n) / rate_hz;
            assert!(time_s <= 2.0 * cycle_s, "{rate_hz} Hz: {time_s} s");
        }
    }
}

#[test]
fn it_is_a_fault_until_it_has_lived_for_a_while() {
    let (watch, mut state, mut gauss) = learnt(1000.0, 3.0, 40_000.0, 1.0);
    let last = state.last.unwrap();
    for _ in 0..300 {
        watch.take(&mut state, &last, None);
    }
    let mut alive = || reading(&mut gauss, 3.0, 40_000.0, 1.0);
    for _ in 0..400 {
        assert_eq!(
            watch.take(&mut state, &alive(), None),
            RecordVerdict::Frozen
        );
    }
    // It freezes once more: the time is counted from zero again.
    for _ in 0..30 {
        assert_eq!(watch.take(&mut state, &last, None), RecordVerdict::Frozen);
    }
    for _ in 0..400 {
        assert_eq!(
            watch.take(&mut state, &alive(), None),
            RecordVerdict::Frozen
        );
    }
    for _ in 0..150 {
        watch.take(&mut state, &alive(), None);
    }
    assert_eq!(
        watch.take(&mut state, &alive(), None),
        RecordVerdict::Plausible
    );
    // The fault is detected again.
    let (n, verdict) = records_until_noticed(&watch, &mut state, || last);
    assert_eq!((verdict, n < 16), (RecordVerdict::Frozen, true));
}

#[test]
fn a_sensor_that_is_quiet_by_its_nature_is_never_judged() {
    // No noise at all: standing, then a load that changes smoothly for a minute, then standing
    // again for a minute.
    for rate_hz in [7000.0, 1000.0, 125.0] {
        let watch = RecordWatch::new(&RecordWatchConfig::default(), rate_hz);
        let mut state = RecordWatchState::default();
        let mut k = 0u32;
        let (n, verdict) = records_until_noticed(&watch, &mut state, || {
            k += 1;
            let time_s = f64::from(k) / rate_hz;
            let moving = (1.0..1.6).contains(&time_s);
            let load = if moving {
                1e6 * (9.0 * time_s).sin()
            } else {
                3e6
            };
            [load as i32; 6]
        });
        assert_eq!(
            (n, verdict),
            (u32::MAX, RecordVerdict::Plausible),
            "{rate_hz} Hz"
        );
    }
}

#[test]
fn a_load_that_moves_is_no_noise() {
    // Switched on during a motion: the watch has never seen it at rest.
    let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
    let mut state = RecordWatchState::default();
    for k in 0..30_000 {
        let load = if k < 20_000 {
            2e6 * (f64::from(k) * 3e-3).sin()
        } else {
            1e6
        };
        assert_eq!(
            watch.take(&mut state, &[load as i32; 6], None),
            RecordVerdict::Plausible
        );
    }
}

#[test]
fn a_box_that_sends_every_measurement_several_times_is_no_frozen_one() {
    for copies in [2, 7] {
        let watch = RecordWatch::new(&RecordWatchConfig::default(), 7000.0);
        let mut state = RecordWatchState::default();
        let mut gauss = Gauss(3);
        let mut counts = [0; 6];
        for k in 0..70_000u32 {
            if k % copies == 0 {
                counts = reading(&mut gauss, f64::from(k) / 7000.0, 40_000.0, 1.0);
            }
            assert_eq!(
                watch.take(&mut state, &counts, None),
                RecordVerdict::Plausible
            );
        }
        let (n, verdict) = records_until_noticed(&watch, &mut state, || counts);
        assert_eq!((verdict, n < 56), (RecordVerdict::Frozen, true), "{n}");
    }
}

#[test]
fn a_load_between_two_coarse_counts_may_stand_still() {
    // Noise of a quarter of a count: the reading flickers near an edge between counts but not in
    // the middle. The load rests at varying levels.
    let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
    let mut state = RecordWatchState::default();
    let mut gauss = Gauss(11);
    for k in 0..60_000u32 {
        let place = if (k / 3000) % 2 == 0 { 0.5 } else { 0.0 };
        let counts = std::array::from_fn(|_| (place + 0.25 * gauss.next()).round() as i32 * 25_000);
        assert_eq!(
            watch.take(&mut state, &counts, None),
            RecordVerdict::Plausible
        );
    }
}

#[test]
fn an_axis_that_never_lived_is_not_judged() {
    let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
    let mut state = RecordWatchState::default();
    let mut gauss = Gauss(5);
    for k in 0..30_000u32 {
        let mut counts = reading(&mut gauss, f64::from(k) * 1e-3, 40_000.0, 1.0);
        counts[4] = 0;
        assert_eq!(
            watch.take(&mut state, &counts, None),
            RecordVerdict::Plausible
        );
    }
    let last = state.last.unwrap();
    let (n, verdict) = records_until_noticed(&watch, &mut state, || last);
    assert_eq!((verdict, n <= 4), (RecordVerdict::Frozen, true));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
    /// For any noise and resolution of a sensor: five minutes at 1 kHz without a false alarm.
    #[test]
    fn no_live_sensor_is_called_frozen(seed: u64, noise in 0.05f64..40.0, low_pass in 0.0f64..0.97) {
        let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
        let mut state = RecordWatchState::default();
        let mut gauss = Gauss(seed);
        let mut held = [0.0; 6];
        for k in 0..300_000u32 {
            let time_s = f64::from(k) * 1e-3;
            let counts = std::array::from_fn(|i| {
                // The sensor box's own filter correlates neighbouring records.
                held[i] = low_pass * held[i] + (1.0 - low_pass) * noise * gauss.next();
                let load = 30.0 * (0.05 * time_s + i as f64).sin();
                (load + held[i]).round() as i32
            });
            let verdict = watch.take(&mut state, &counts, None);
            prop_assert_eq!(verdict, RecordVerdict::Plausible, "at {} s", time_s);
        }
    }
}

/// The bug: the only noise of a simulated robot's estimate was the trembling push of a test's
/// thread. The estimate settled axis by axis when that thread had no processor for 30 ms. The
/// torques, of some micronewton metres, stood first.
#[test]
fn an_estimate_that_settles_axis_by_axis_has_no_stuck_axis() {
    for pause in [20, 35, 45] {
        let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
        let mut state = RecordWatchState::default();
        let mut gauss = Gauss(17);
        let mut estimate = [0.0; 6];
        let mut push = [0.0; 6];
        for k in 0..60_000u32 {
            // Observer of 150 rad/s; steps of a micronewton and a micronewton metre.
            if k < 3000 || k % 1000 >= pause {
                push = std::array::from_fn(|i| gauss.next() * if i < 3 { 15_000.0 } else { 20.0 });
            }
            let counts = std::array::from_fn(|i| {
                estimate[i] += (push[i] - estimate[i]) * 0.14;
                3e6 as i32 + estimate[i].round() as i32
            });
            let verdict = watch.take(&mut state, &counts, None);
            assert_eq!(verdict, RecordVerdict::Plausible, "at {k} ms, {pause} ms");
        }
    }
}

#[test]
fn a_tool_that_presses_and_moves_under_exact_repeats_has_a_frozen_sensor() {
    // Without any noise, there are no statistics to learn.
    let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
    let mut state = RecordWatchState::default();
    let at = |k: u32| Some(Vector3::new(0.4 + 2e-5 * f64::from(k), 0.0, 0.2));
    for k in 0..5000u32 {
        // Standing and pressing for a long time; then sliding with a force that follows.
        let (counts, place) = if k < 3000 {
            (7, at(0))
        } else {
            (k as i32, at(k - 3000))
        };
        let verdict = watch.take(&mut state, &[counts; 6], place);
        assert_eq!(verdict, RecordVerdict::Plausible);
    }
    let (mut k, mut noticed) = (2000, None);
    while noticed.is_none() && k < 3000 {
        k += 1;
        let verdict = watch.take(&mut state, &[4999; 6], at(k));
        noticed = (verdict == RecordVerdict::Frozen).then_some(k);
    }
    let way_m = 2e-5 * f64::from(k - 2000);
    assert!(noticed.is_some() && way_m <= 2e-3, "{way_m} m");
    // The fault does not end because the arm stands still again.
    for _ in 0..2000 {
        let verdict = watch.take(&mut state, &[4999; 6], at(k));
        assert_eq!(verdict, RecordVerdict::Frozen);
    }
}

#[test]
fn a_tool_in_the_air_may_move_under_exact_repeats() {
    let watch = RecordWatch::new(&RecordWatchConfig::default(), 1000.0);
    let mut state = RecordWatchState::default();
    for _ in 0..5000 {
        let verdict = watch.take(&mut state, &[0; 6], None);
        assert_eq!(verdict, RecordVerdict::Plausible);
    }
}

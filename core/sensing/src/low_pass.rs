//! Second-order Butterworth low-pass with a known delay, whose cut-off may change while it runs.

use nalgebra::SVector;

use crate::SensingError;

/// Damping of a Butterworth pair, `1/Q`.
const INVERSE_Q: f64 = std::f64::consts::SQRT_2;

/// Highest cut-off as a share of the sample rate. Above it, the bilinear warping distorts the
/// Butterworth response.
const CUTOFF_SHARE_MAX: f64 = 0.45;

/// Coefficients for one cut-off and one sample rate.
///
/// The analogue prototype under the bilinear transform, prewarped so that the cut-off (-3 dB) is
/// exact, in the trapezoidal state-variable form. Its two states do not depend on the coefficients,
/// so a change of the cut-off makes no step in the output.
///
/// ```
/// use nalgebra::SVector;
/// use tangent_sensing::{LowPass, LowPassState};
///
/// let filter = LowPass::new(30.0, 1000.0)?;
/// let mut state = LowPassState::<1>::default();
/// // The first sample sets the state, so there is no transient.
/// assert_eq!(filter.update(&mut state, &SVector::repeat(5.0))[0], 5.0);
/// // A step is followed within `settling_samples`.
/// let mut output = 5.0;
/// for _ in 0..filter.settling_samples() {
///     output = filter.update(&mut state, &SVector::repeat(6.0))[0];
/// }
/// assert!((output - 6.0).abs() < 1e-3);
/// assert!((filter.delay_s() - 0.2251 / 30.0).abs() < 1e-4);
/// # Ok::<(), tangent_sensing::SensingError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    sample_rate_hz: f64,
    cutoff_hz: f64,
    a1: f64,
    a2: f64,
    a3: f64,
    delay_s: f64,
}

/// State of a [`LowPass`] on `N` channels. A new one is the reset: the filter then starts in the
/// steady state of the first sample.
///
/// ```
/// use nalgebra::SVector;
/// use tangent_sensing::{LowPass, LowPassState};
///
/// let filter = LowPass::new(30.0, 1000.0)?;
/// let mut state = LowPassState::<1>::default();
/// filter.update(&mut state, &SVector::repeat(5.0));
/// // A tare subtracts 5 from all samples, past ones included.
/// state.shift(&SVector::repeat(-5.0));
/// assert_eq!(filter.update(&mut state, &SVector::repeat(0.0))[0], 0.0);
/// # Ok::<(), tangent_sensing::SensingError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPassState<const N: usize> {
    first: SVector<f64, N>,
    second: SVector<f64, N>,
    started: bool,
}

impl<const N: usize> Default for LowPassState<N> {
    fn default() -> Self {
        Self {
            first: SVector::zeros(),
            second: SVector::zeros(),
            started: false,
        }
    }
}

impl<const N: usize> LowPassState<N> {
    /// Shifts the state as if the input had always been higher by `by`.
    pub fn shift(&mut self, by: &SVector<f64, N>) {
        self.second += by;
    }
}

impl LowPass {
    /// Filter with -3 dB at `cutoff_hz`; 0 switches it off.
    ///
    /// # Errors
    /// A sample rate that is not positive, or a cut-off outside of 0 to 0.45 of it.
    pub fn new(cutoff_hz: f64, sample_rate_hz: f64) -> Result<Self, SensingError> {
        SensingError::unless(
            sample_rate_hz.is_finite() && sample_rate_hz > 0.0,
            "sample_rate_hz",
            sample_rate_hz,
            "positive",
        )?;
        let max = CUTOFF_SHARE_MAX * sample_rate_hz;
        SensingError::unless(
            (0.0..=max).contains(&cutoff_hz),
            "filter_cutoff_hz",
            cutoff_hz,
            format!("from 0 (off) to {max} (0.45 of the sample rate of {sample_rate_hz} Hz)"),
        )?;
        let g = (std::f64::consts::PI * cutoff_hz / sample_rate_hz).tan();
        let a1 = 1.0 / (1.0 + g * (g + INVERSE_Q));
        let a2 = g * a1;
        Ok(Self {
            sample_rate_hz,
            cutoff_hz,
            a1,
            a2,
            a3: g * a2,
            // H(s) = 1 - s √2/ω + ..., and the bilinear transform has s/ω = (z-1)/(z+1)/g, jωT/2/g
            // at low frequency.
            delay_s: if cutoff_hz > 0.0 {
                INVERSE_Q / (2.0 * g * sample_rate_hz)
            } else {
                0.0
            },
        })
    }

    /// Delay of slow signals (phase and group delay at zero frequency), s:
    /// `√2 / (2 f_s tan(π f_c / f_s))`, which is `0.2251 / f_c` for a cut-off far below the sample
    /// rate.
    pub fn delay_s(&self) -> f64 {
        self.delay_s
    }

    /// Cut-off (-3 dB), Hz; 0 if the filter is off.
    pub fn cutoff_hz(&self) -> f64 {
        self.cutoff_hz
    }

    /// Sample rate, Hz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Number of samples after which a step is followed to within a thousandth.
    pub fn settling_samples(&self) -> u32 {
        if self.cutoff_hz == 0.0 {
            return 1;
        }
        // The poles' radius: (1+s)/(1-s) of s = -g (1 ± j)/√2.
        let g = INVERSE_Q / (2.0 * self.delay_s * self.sample_rate_hz);
        let (h, square) = (g / INVERSE_Q, g * g / 2.0);
        let radius = (((1.0 - h).powi(2) + square) / ((1.0 + h).powi(2) + square)).sqrt();
        (-7.5 / radius.ln()).ceil() as u32 + 1
    }

    /// Filters one sample. A sample that is not finite does not change the state, and the present
    /// output is returned.
    pub fn update<const N: usize>(
        &self,
        state: &mut LowPassState<N>,
        input: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        if !input.iter().all(|x| x.is_finite()) {
            return state.second;
        }
        if self.cutoff_hz == 0.0 || !state.started {
            *state = LowPassState {
                first: SVector::zeros(),
                second: *input,
                started: true,
            };
            return *input;
        }
        let mut output = SVector::zeros();
        for i in 0..N {
            let difference = input[i] - state.second[i];
            let band = self.a1 * state.first[i] + self.a2 * difference;
            let low = state.second[i] + self.a2 * state.first[i] + self.a3 * difference;
            state.first[i] = 2.0 * band - state.first[i];
            state.second[i] = 2.0 * low - state.second[i];
            output[i] = low;
        }
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type State = LowPassState<1>;

    /// Amplitude and delay (s) of a steady sine.
    fn response(filter: &LowPass, frequency_hz: f64) -> (f64, f64) {
        let rate = filter.sample_rate_hz();
        let mut state = State::default();
        let (mut s, mut c, mut n) = (0.0, 0.0, 0.0);
        let settled = 3 * filter.settling_samples() as usize;
        let period = (rate / frequency_hz).round() as usize;
        // An exact number of samples in a period makes the sums over whole periods exact.
        let frequency = rate / period as f64;
        for i in 0..settled + 4 * period {
            let phase = std::f64::consts::TAU * frequency * i as f64 / rate;
            let y = filter.update(&mut state, &SVector::from([phase.sin()]))[0];
            if i >= settled {
                s += y * phase.sin();
                c += y * phase.cos();
                n += 0.5;
            }
        }
        let (s, c) = (s / n, c / n);
        (
            s.hypot(c),
            -c.atan2(s) / (std::f64::consts::TAU * frequency),
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn slow_signals_come_late_by_the_stated_delay(rate in 100.0f64..7000.0, share in 0.002f64..0.4) {
            let filter = LowPass::new(share * rate, rate).unwrap();
            // A ramp comes out as itself, shifted.
            let mut state = State::default();
            let mut shift = 0.0;
            for i in 0..4 * filter.settling_samples() + 10 {
                let x = f64::from(i);
                shift = x - filter.update(&mut state, &SVector::from([x]))[0];
            }
            let delay = shift / rate;
            prop_assert!((delay / filter.delay_s() - 1.0).abs() < 1e-6, "{delay} s, stated {} s", filter.delay_s());
        }

        #[test]
        fn the_cut_off_is_where_it_is_asked_for(rate in 500.0f64..7000.0, share in 0.01f64..0.1) {
            let rate = rate.round();
            let filter = LowPass::new(rate / (1.0 / share).round(), rate).unwrap();
            let (amplitude, _) = response(&filter, filter.cutoff_hz());
            prop_assert!((amplitude - std::f64::consts::FRAC_1_SQRT_2).abs() < 1e-3, "{amplitude}");
        }

        #[test]
        fn a_constant_passes_unchanged_whatever_the_cut_off_does(value in -100.0f64..100.0,
                                                                 cutoffs in prop::collection::vec(0.0f64..400.0, 1..60)) {
            let mut state = State::default();
            for cutoff in cutoffs {
                let y = LowPass::new(cutoff, 1000.0).unwrap().update(&mut state, &SVector::from([value]))[0];
                prop_assert!((y - value).abs() <= 1e-12 * value.abs());
            }
        }

        #[test]
        fn what_is_not_finite_never_enters(bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]),
                                           at in 0usize..50) {
            let filter = LowPass::new(30.0, 1000.0).unwrap();
            let (mut state, mut clean) = (State::default(), State::default());
            for i in 0..50 {
                if i == at {
                    let y = filter.update(&mut state, &SVector::from([bad]))[0];
                    prop_assert!(y.is_finite());
                }
                let x = SVector::from([(i as f64 * 0.1).sin()]);
                prop_assert_eq!(filter.update(&mut state, &x), filter.update(&mut clean, &x));
            }
        }
    }

    #[test]
    fn well_below_the_cut_off_the_delay_of_a_sine_is_the_stated_one_too() {
        let filter = LowPass::new(30.0, 7000.0).unwrap();
        let (amplitude, delay) = response(&filter, 1.0);
        assert!((amplitude - 1.0).abs() < 1e-5);
        assert!((delay - filter.delay_s()).abs() < 1e-5, "{delay}");
        assert!((filter.delay_s() - 0.2251 / 30.0).abs() < 1e-5);
    }

    #[test]
    fn it_falls_by_40_db_per_decade() {
        let filter = LowPass::new(10.0, 7000.0).unwrap();
        let (amplitude, _) = response(&filter, 100.0);
        assert!((amplitude - 0.01).abs() < 1e-4, "{amplitude}");
    }

    #[test]
    fn a_step_is_followed_to_a_thousandth_after_the_settling_samples() {
        for cutoff in [1.0, 30.0, 400.0] {
            let filter = LowPass::new(cutoff, 1000.0).unwrap();
            let mut state = State::default();
            filter.update(&mut state, &SVector::from([0.0]));
            let mut y = 0.0;
            for _ in 0..filter.settling_samples() {
                y = filter.update(&mut state, &SVector::from([1.0]))[0];
            }
            assert!((y - 1.0).abs() < 2e-3, "{cutoff} Hz: {y}");
        }
    }

    #[test]
    fn bad_numbers_are_refused_by_name() {
        let error = LowPass::new(500.0, 1000.0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "`filter_cutoff_hz` is 500, but must be from 0 (off) to 450 (0.45 of the sample rate of 1000 Hz)"
        );
        assert!(LowPass::new(f64::NAN, 1000.0).is_err());
        assert!(LowPass::new(10.0, f64::NAN).is_err());
        assert!(LowPass::new(-1.0, 1000.0).is_err());
    }
}

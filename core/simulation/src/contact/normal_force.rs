//! Normal force of one pad point: a spring whose damping grows with depth, so that contact starts
//! and ends without a jump.

/// Law of Hunt and Crossley (1975): `F = k x^e (1 + 1.5 a x')`; never negative.
///
/// ```
/// use tangent_simulation::contact::HuntCrossley;
///
/// let law = HuntCrossley { stiffness: 1e4, exponent: 1.0, dissipation_s_per_m: 4.0 };
/// assert_eq!(law.force(0.001, 0.0).force, 10.0);
/// // Going in, the point is pushed harder; leaving fast, it is not pulled back.
/// assert!(law.force(0.001, 0.05).force > 10.0);
/// assert_eq!(law.force(0.001, -1.0).force, 0.0);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct HuntCrossley {
    /// `k`, N/m^e.
    pub stiffness: f64,
    /// `e`
    pub exponent: f64,
    /// `a`, s/m.
    pub dissipation_s_per_m: f64,
}

/// Force of one point, with its derivatives for an implicit step.
#[derive(Clone, Copy, Debug, Default)]
pub struct NormalForce {
    /// Force out of the material, N.
    pub force: f64,
    /// dF/dx, N/m.
    pub stiffness: f64,
    /// dF/dx', Ns/m.
    pub damping: f64,
}

impl HuntCrossley {
    /// Normal force; `depth` in m (positive inside), `depth_rate` in m/s.
    pub fn force(&self, depth: f64, depth_rate: f64) -> NormalForce {
        if depth <= 0.0 {
            return NormalForce::default();
        }
        let spring = if self.exponent == 1.0 {
            self.stiffness * depth
        } else {
            self.stiffness * depth.powf(self.exponent)
        };
        let factor = 1.0 + 1.5 * self.dissipation_s_per_m * depth_rate;
        if factor <= 0.0 {
            return NormalForce::default();
        }
        NormalForce {
            force: spring * factor,
            stiffness: self.exponent * spring / depth * factor,
            damping: 1.5 * self.dissipation_s_per_m * spring,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_outside_is_free_and_one_that_leaves_fast_is_not_pulled() {
        let law = HuntCrossley {
            stiffness: 1e4,
            exponent: 1.0,
            dissipation_s_per_m: 4.0,
        };
        assert_eq!(law.force(-1e-6, 1.0).force, 0.0);
        assert_eq!(law.force(1e-3, -1.0).force, 0.0);
        assert!(law.force(1e-3, 0.0).force == 10.0);
    }

    #[test]
    fn its_derivatives_are_those_of_the_force() {
        let law = HuntCrossley {
            stiffness: 3e5,
            exponent: 1.5,
            dissipation_s_per_m: 2.0,
        };
        let (x, v, h) = (4e-4, 0.02, 1e-9);
        let at = law.force(x, v);
        let by_depth = (law.force(x + h, v).force - law.force(x - h, v).force) / (2.0 * h);
        let by_rate = (law.force(x, v + h).force - law.force(x, v - h).force) / (2.0 * h);
        assert!((at.stiffness - by_depth).abs() < 1e-4 * by_depth);
        assert!((at.damping - by_rate).abs() < 1e-4 * by_rate);
    }

    #[test]
    fn the_energy_lost_in_a_cycle_is_the_closed_form() {
        // x = A sin(w t) for half a period: the elastic work is zero, the dissipated work is 1.5 a
        // k ∫ x x'² dt = 1.5 a k w A³ 2/3.
        let law = HuntCrossley {
            stiffness: 5e3,
            exponent: 1.0,
            dissipation_s_per_m: 3.0,
        };
        let (amplitude, w, n) = (1e-3, 20.0, 20_000);
        let dt = std::f64::consts::PI / w / f64::from(n);
        let work: f64 = (0..n)
            .map(|i| {
                let t = (f64::from(i) + 0.5) * dt;
                let (x, v) = (amplitude * (w * t).sin(), amplitude * w * (w * t).cos());
                law.force(x, v).force * v * dt
            })
            .sum();
        let closed = 1.5 * 3.0 * 5e3 * w * amplitude.powi(3) * 2.0 / 3.0;
        assert!((work - closed).abs() < 1e-6 * closed, "{work} {closed}");
    }
}

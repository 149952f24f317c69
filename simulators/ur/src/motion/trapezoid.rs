//! Speed profile of a planned motion.

/// A share of the way, 0 to 1, over time: constant acceleration, constant speed, constant
/// deceleration.
#[derive(Clone, Copy, Debug)]
pub struct Trapezoid {
    /// 1/s²
    a: f64,
    /// s
    ramp: f64,
    /// s
    total: f64,
}

impl Trapezoid {
    /// Profile over `distance`, m or rad, at most at speed `v` with acceleration `a`; with `t` > 0
    /// in that time, s.
    pub fn new(distance: f64, v: f64, a: f64, t: f64) -> Self {
        if distance < 1e-9 {
            return Self {
                a: 0.0,
                ramp: 0.0,
                total: 0.0,
            };
        }
        let (v, a) = (v / distance, a / distance);
        if t > 0.0 {
            // A third up, a third down.
            let ramp = t / 3.0;
            return Self {
                a: 1.0 / (ramp * (t - ramp)),
                ramp,
                total: t,
            };
        }
        let ramp = (v / a).min((1.0 / a).sqrt());
        Self {
            a,
            ramp,
            total: ramp + 1.0 / (a * ramp),
        }
    }

    /// Time for the whole way, s.
    pub fn duration(&self) -> f64 {
        self.total
    }

    /// Share of the way and its rate, 1/s.
    pub fn at(&self, time: f64) -> (f64, f64) {
        if time >= self.total {
            (1.0, 0.0)
        } else if time < self.ramp {
            (0.5 * self.a * time * time, self.a * time)
        } else if time <= self.total - self.ramp {
            let v = self.a * self.ramp;
            (v * (time - 0.5 * self.ramp), v)
        } else {
            let left = self.total - time;
            (1.0 - 0.5 * self.a * left * left, self.a * left)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trapezoid_goes_all_the_way_within_its_bounds() {
        for (distance, v, a, t) in [
            (2.0, 1.0, 1.4, 0.0),
            (0.01, 1.0, 1.4, 0.0),
            (1.0, 0.0, 0.0, 2.0),
        ] {
            let p = Trapezoid::new(distance, v, a, t);
            let n = 1000;
            let dt = p.duration() / f64::from(n);
            let mut way = 0.0;
            for i in 0..n {
                let (_, rate) = p.at((f64::from(i) + 0.5) * dt);
                way += rate * dt;
                assert!(t > 0.0 || rate * distance <= v * (1.0 + 1e-9));
            }
            assert!((way - 1.0).abs() < 1e-3, "{way}");
            assert_eq!(p.at(p.duration()), (1.0, 0.0));
        }
        assert_eq!(Trapezoid::new(0.0, 1.0, 1.0, 0.0).duration(), 0.0);
    }
}

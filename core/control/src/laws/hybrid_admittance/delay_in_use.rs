//! Bounds of the loop's delay in use, from its mean and standard deviation in the configuration in
//! effect: the controller writes the delay measured in free space there.
//!
//! Called by the force law and by the touchdown. Each uses the bound on its safe side: a gain and
//! an approach that assume too long a delay are only slow, and a recoil that assumes too short a
//! delay only leaves more force.

use super::config::ForceConfig;

/// Shortest delay in use as a share of the mean.
const SHORTEST_SHARE: f64 = 0.25;

/// Delay that the loop hardly exceeds, s: for gains, and for speeds towards a contact.
pub(crate) fn delay_longest_s(force: &ForceConfig) -> f64 {
    force.loop_delay_s + force.loop_delay_sd_s
}

/// Delay that the loop has at least, s: for a motion back from a contact.
pub(crate) fn delay_shortest_s(force: &ForceConfig) -> f64 {
    let mean_s = force.loop_delay_s;
    (mean_s - force.loop_delay_sd_s).max(SHORTEST_SHARE * mean_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_uncertain_delay_is_longer_for_gains_and_shorter_for_the_recoil() {
        let mut force = ForceConfig {
            loop_delay_s: 0.04,
            loop_delay_sd_s: 0.01,
            ..ForceConfig::default()
        };
        assert!((delay_longest_s(&force) - 0.05).abs() < 1e-12);
        assert!((delay_shortest_s(&force) - 0.03).abs() < 1e-12);
        force.loop_delay_sd_s = 0.1;
        assert!((delay_shortest_s(&force) - 0.01).abs() < 1e-12);
        force.loop_delay_sd_s = 0.0;
        assert_eq!(delay_longest_s(&force), delay_shortest_s(&force));
    }
}

//! Force that the arm itself feels.

use nalgebra::Vector3;
use tangent_runtime::Latest;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::tangent::ArmState;

/// Largest age of the reading relative to the arm's state, ns. Both come from the same packet of
/// the robot, and both stamps are of the same clock.
const AGE_MAX_NS: i64 = 50_000_000;

/// Reads the arm's own wrench, if a bridge publishes it.
pub struct ArmForceReader(Latest<WrenchStamped>);

impl ArmForceReader {
    /// Reader of this topic.
    pub fn new(wrench: Latest<WrenchStamped>) -> Self {
        Self(wrench)
    }

    /// While held, no other publisher replaces the present one.
    pub fn hold(&self, held: bool) {
        self.0.hold(held);
    }

    /// The force that came with this state, flange axes, N.
    pub fn with(&mut self, state: &ArmState) -> Option<Vector3<f64>> {
        self.0.refresh();
        let reading = self.0.get()?;
        is_with(&reading.message, state).then(|| Vector3::from(&reading.message.wrench.force))
    }
}

fn is_with(reading: &WrenchStamped, state: &ArmState) -> bool {
    let (read, at) = (reading.header.stamp.to_ns(), state.header.stamp.to_ns());
    (0..=AGE_MAX_NS).contains(&at.saturating_sub(read))
}

#[cfg(test)]
mod tests {
    use tangent_schemas::standard::Time;

    use super::*;

    #[test]
    fn a_force_of_another_packet_is_not_used() {
        let mut state = ArmState::default();
        state.header.stamp = Time::from_ns(2_000_000_000);
        let mut reading = WrenchStamped::default();
        for (ns, used) in [
            (2_000_000_000, true),
            (1_960_000_000, true),
            (1_900_000_000, false),
            (2_000_000_001, false),
        ] {
            reading.header.stamp = Time::from_ns(ns);
            assert_eq!(is_with(&reading, &state), used, "{ns}");
        }
    }
}

//! Reads where the arm of a running cell stands.

use std::time::{Duration, Instant};

use tangent_mechanics::{Base, Pose, Tool};
use tangent_runtime::Bus;
use tangent_runtime::bus::Subscription;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

use crate::error::TeachError;
use crate::lesson::Shown;

/// Age up to which a state shows where the arm stands.
const FRESH: Duration = Duration::from_millis(500);
/// Timeout of the first state.
const FIRST: Duration = Duration::from_secs(3);
/// States that wait at most: more than a second of the fastest arm.
const STATES_MAX: usize = 2048;

/// Reads `arm/state`.
pub struct ArmReader {
    states: Subscription<ArmState>,
    newest: Option<(Instant, Result<Shown, TeachError>)>,
}

impl ArmReader {
    /// Waits for the first state.
    ///
    /// # Errors
    /// None arrives.
    pub fn open(bus: &Bus) -> Result<Self, TeachError> {
        let mut reader = Self {
            states: bus.subscribe(&topics::ARM_STATE, STATES_MAX)?,
            newest: None,
        };
        let Some(first) = reader.states.recv_timeout(FIRST) else {
            return Err(TeachError::NoArm);
        };
        reader.newest = Some((first.received, shown(&first.message)));
        Ok(reader)
    }

    /// Passes every state that has arrived since the last call to `take`.
    pub fn drain(&mut self, mut take: impl FnMut(&Shown)) {
        while let Some(state) = self.states.try_recv() {
            let shown = shown(&state.message);
            if let Ok(shown) = &shown {
                take(shown);
            }
            self.newest = Some((state.received, shown));
        }
    }

    /// Where the arm stands now.
    ///
    /// # Errors
    /// The bridge publishes nothing, or no usable pose.
    pub fn now(&self) -> Result<&Shown, TeachError> {
        match &self.newest {
            Some((at, _)) if at.elapsed() > FRESH => Err(TeachError::NoArm),
            Some((_, Ok(shown))) => Ok(shown),
            Some((_, Err(error))) => Err(TeachError::NoPose(error.to_string())),
            None => Err(TeachError::NoArm),
        }
    }
}

fn shown(state: &ArmState) -> Result<Shown, TeachError> {
    let base_from_tool = Pose::<Base, Tool>::try_from(&state.tool_pose)
        .map_err(|error| TeachError::NoPose(error.to_string()))?;
    Ok(Shown {
        joints_rad: state.q.as_slice().to_vec(),
        base_from_tool,
    })
}

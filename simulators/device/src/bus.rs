//! The simulator's messages on the bus: ground truth out, fault requests in.

use std::fmt::Display;

use tangent_mechanics::Base;
use tangent_runtime::clock;
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::{Answer, ContactTruth};
use tangent_simulation::Truth;

/// Key of the query that injects a fault: the action is the fault's name, the argument its value.
pub const FAULT_KEY: &str = "simulator/fault";

/// Answer to a fault request: the injected fault in words, or the reason of the refusal.
pub fn fault_answer(injected: Result<impl Display, impl Display>) -> Answer {
    let (done, message) = match injected {
        Ok(fault) => (true, fault.to_string()),
        Err(error) => (false, error.to_string()),
    };
    Answer {
        done,
        message,
        ..Answer::default()
    }
}

/// Message of the ground truth of a contact, stamped with the present time.
pub fn truth_message(truth: &Truth) -> ContactTruth {
    ContactTruth {
        header: Header::in_frame::<Base>(clock::now_ns()),
        point: (&truth.point).into(),
        normal: (&truth.normal).into(),
        in_contact: truth.in_contact,
        penetration_m: truth.penetration_m,
        wrench: (&truth.wrench).into(),
        tool_pose: (&truth.base_from_tool).into(),
        tool_twist: (&truth.twist).into(),
        sliding_speed_m_per_s: truth.sliding_speed_m_per_s,
        friction: truth.friction_coefficient,
    }
}

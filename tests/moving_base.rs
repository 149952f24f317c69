//! `tangent up` with a platform that oscillates at 2 cm/s under the working arm: real services,
//! `base/pose` on the bus.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;

use common::{number, up};
use serde_json::Value;
use tangent_live::live_beside_others;
use tangent_recorder::Recording;
use tangent_schemas::cdr;
use tangent_schemas::standard::TFMessage;

const SCENARIO: &str = "pipe_moving_base";
/// Largest relative deviation of the force while the base moves: RMS, and for 95 % of the time.
const SHARES: [f64; 2] = [0.15, 0.18];

/// Figures of a live run that are beyond their bounds.
fn beyond(live: &Value) -> Vec<String> {
    let reference = number(live, "/force/reference_n");
    [
        ("/force/rmse_n", SHARES[0] * reference),
        ("/force/p95_abs_error_n", SHARES[1] * reference),
        ("/contact/lost_count", 0.0),
        ("/normal_error_settled_deg/rmse", 3.0),
        ("/path/rmse_m", 1e-3),
    ]
    .into_iter()
    .map(|(figure, bound)| (figure, number(live, figure), bound))
    .filter(|(_, value, bound)| value > bound)
    .map(|(figure, value, bound)| format!("{figure}: {value}, at most {bound}"))
    .collect()
}

#[test]
fn up_holds_the_force_from_a_moving_platform() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let beyond = beyond(&up(SCENARIO, folder.path()));
        assert!(beyond.is_empty(), "{beyond:?}");

        // The recording contains the platform's poses, and the viewers' frames are attached to the
        // world.
        let path = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .find(|path| path.extension().is_some_and(|e| e == "mcap"))
            .expect("a recording");
        let recording = Recording::open(&path).unwrap();
        let (mut poses, mut hangs) = (0, false);
        for message in recording.messages() {
            match message.topic.as_str() {
                "/base/pose" => poses += 1,
                "/tf" => {
                    let frames: TFMessage = cdr::decode(&message.bytes).unwrap();
                    hangs |= frames.transforms.iter().any(|t| {
                        t.header.frame_id.as_str() == "world"
                            && t.child_frame_id.as_str() == "base"
                            && (t.transform.translation.x - 12.3).abs() < 0.2
                    });
                }
                _ => {}
            }
        }
        assert!(poses > 1000, "{poses} poses");
        assert!(hangs, "no world -> base on tf");
    });
}

//! `tangent up` from a platform that swings by 2 cm/s under the working arm: real services, `base/pose` on the bus.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;

use common::{number, up};
use tangent_recorder::Recording;
use tangent_schemas::cdr;
use tangent_schemas::standard::TFMessage;

const SCENARIO: &str = "pipe_moving_base";
/// What the force may be off by while the base moves.
const SHARE: f64 = 0.15;

#[test]
fn up_holds_the_force_from_a_moving_platform() {
    let folder = tempfile::tempdir().unwrap();
    let live = up(SCENARIO, folder.path());
    let reference = number(&live, "/force/reference_n");
    for figure in ["/force/rmse_n", "/force/p95_abs_error_n"] {
        let share = number(&live, figure) / reference;
        assert!(share < SHARE, "{figure}: {share} of the reference");
    }
    assert_eq!(number(&live, "/contact/lost_count"), 0.0);
    assert!(number(&live, "/normal_error_settled_deg/rmse") < 3.0);
    assert!(number(&live, "/path/rmse_m") < 1e-3);

    // The recording has the platform's poses, and the viewers' frames hang on the world.
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
}

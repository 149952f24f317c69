//! What a task learns of a part, kept by the controller.

use std::fs;

use serde_json::Value;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::wait_for;
use tangent_live::live_beside_others;

const PROCESSES: [&str; 2] = ["router simulator netft rtde estimator", "controller"];

/// The memory of a part grows with each pass, over a restart of the controller too; one that is
/// damaged refuses the task with its file.
#[test]
fn a_part_is_learnt_over_passes_and_a_restart() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let task = cell.task(
            true,
            "kind = \"line\"\nto_m = [0.02, 0.0]\nspeed_m_per_s = 0.02",
        );
        let text = fs::read_to_string(&task).unwrap();
        fs::write(&task, format!("learning.part = \"lid\"\n{text}")).unwrap();
        let state = cell.file().parent().unwrap().join("state");
        let mut file = None;
        for passes in 1..=2 {
            Observer::join(&cell).wipe(&cell, &task);
            let found = wait_for("the pass is stored", PATIENCE, || {
                let name = fs::read_dir(&state).ok()?.next()?.ok()?.path();
                let path = name.join("learnt-lid.json");
                let memory: Value = serde_json::from_slice(&fs::read(&path).ok()?).ok()?;
                (memory["passes"] == passes).then_some(path)
            });
            file = Some(found);
            if passes == 1 {
                assert_eq!(cell.process("controller").terminate(PATIENCE), Some(0));
                cell.start("controller");
            }
        }
        let file = file.unwrap();
        fs::write(&file, "{\"version\": 1").unwrap();
        let output = cell.cli(&["task", "start", task.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("learnt-lid.json"), "{said}");
    });
}

//! `tangent teach` on a cell of processes: a hand guides the simulated arm, keys take what it
//! shows, and the task that is written runs from another pose.

use std::process::Output;

use nalgebra::Vector3;
use tangent_control::Task;
use tangent_mechanics::{Base, Pose, Tool};
use tangent_runtime::clock;
use tangent_schemas::tangent::ArmState;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::{json, stderr, wait_for};
use crate::terminal::Terminal;
use tangent_live::live_beside_others;

/// A person who guides the arm with one hand and presses keys with the other.
struct Person<'a> {
    cell: &'a Cell,
    observer: &'a Observer,
    terminal: Terminal,
}

impl<'a> Person<'a> {
    fn start(cell: &'a Cell, observer: &'a Observer, args: &[&str]) -> Self {
        Self {
            cell,
            observer,
            terminal: Terminal::start(cell, &["teach"], args),
        }
    }

    /// Waits for these words of the command.
    fn hears(&self, words: &str) {
        wait_for(words, PATIENCE, || {
            self.terminal.said().contains(words).then_some(())
        });
    }

    fn key(&mut self, key: &str, answer: &str) {
        self.terminal.enter(key);
        self.hears(answer);
    }

    fn tool(&self) -> Pose<Base, Tool> {
        let arm = self.observer.arm().unwrap();
        Pose::try_from(&arm.tool_pose).unwrap()
    }

    /// Pushes the tool along an axis of its own until it has moved by `way_m`.
    fn push(&self, axis: Vector3<f64>, way_m: f64) {
        let from = self.tool();
        let force = from.rotate(&axis) * 8.0;
        let text = format!("{},{},{}", force.x, force.y, force.z);
        self.cell.provoke("push", &text);
        wait_for("the tool follows the hand", PATIENCE, || {
            let moved = (self.tool().translation() - from.translation()).norm();
            (moved > way_m).then_some(())
        });
        self.cell.provoke("push", "0,0,0");
        wait_for("the arm rests", PATIENCE, || {
            let arm = self.observer.arm()?;
            arm.qd.iter().all(|v| v.abs() < 1e-3).then_some(())
        });
    }

    fn ended(self) -> (Output, String) {
        self.terminal.ended()
    }
}

fn until(observer: &Observer, what: &str, holds: impl Fn(&ArmState) -> bool) -> ArmState {
    wait_for(what, PATIENCE, || observer.arm().filter(&holds))
}

/// `ArmState.program_state` while a hand guides the arm.
const GUIDED: u8 = 5;

#[test]
fn a_task_that_a_hand_has_shown_runs_from_another_pose() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&["router simulator netft rtde controller", "estimator"]);
        let observer = Observer::join(&cell);
        until(&observer, "the arm is ready", |arm| arm.ready);
        let file = cell.file().with_file_name("shown.toml");
        let file = file.to_str().unwrap();

        let args = [
            "shown",
            "--force-n",
            "4",
            "--clearance-m",
            "0.01",
            "--output",
            file,
        ];
        let mut person = Person::start(&cell, &observer, &args);
        person.hears("the arm is FREE");
        let free = until(&observer, "free", |arm| arm.program_state == GUIDED);
        assert!(!free.ready && free.not_ready_reason.contains("a hand guides"));
        // No task starts meanwhile.
        let task = cell.long_task();
        let refused = cell.cli(&["task", "start", task.to_str().unwrap()]);
        assert_eq!(refused.status.code(), Some(1));
        let words = format!(
            "{}{}",
            String::from_utf8_lossy(&refused.stdout),
            stderr(&refused)
        );
        assert!(words.contains("a hand guides the arm"), "{words}");

        person.key("", "point 1");
        let first = person.tool();
        person.push(Vector3::x(), 0.02);
        person.key("", "point 2");
        person.key("", "point 3");
        person.key("u", "forgotten; 2 points");
        person.key("s", "a stroke begins");
        person.push(-Vector3::x(), 0.01);
        person.key("s", "stroke 1:");
        // Away from the surface, and home.
        person.push(-Vector3::z(), 0.05);
        person.push(Vector3::y(), 0.04);
        person.key("h", "home is here");
        person.key("d", "");
        let (output, said) = person.ended();
        assert_eq!(output.status.code(), Some(0), "{said}");
        let written = json(&output);
        assert_eq!(written["good"], true, "{written}");
        until(&observer, "the arm holds itself", |arm| arm.ready);

        let text = std::fs::read_to_string(file).unwrap();
        let task: Task = text.parse().unwrap();
        let start = task.start.clone().unwrap();
        assert!(task.home.is_some(), "{text}");
        let checked = cell.cli(&["check", file]);
        assert_eq!(checked.status.code(), Some(0), "{}", stderr(&checked));
        // A file that exists is kept.
        assert_eq!(
            cell.cli(&["teach", "shown", "--output", file])
                .status
                .code(),
            Some(2)
        );

        // It runs from where the hand left the arm, to its end.
        let begun = clock::now_ns();
        let ran = cell.cli(&["task", "start", file, "--wait-s", "20", "--follow"]);
        let said = stderr(&ran);
        assert_eq!(ran.status.code(), Some(0), "{said}");
        let seen = observer.controls(begun);
        let phase = |name: &'static str| {
            seen.iter()
                .filter(move |s| s.message.phase_text.as_str() == name)
        };
        assert!(phase("travel").count() > 10 && phase("slide").count() > 10);
        let arrived = phase("tare").next().or(phase("approach").next()).unwrap();
        let at = &arrived.message.path_reference;
        let above = first.unrotate(&(Vector3::new(at.x, at.y, at.z) - first.translation()));
        assert!((above + Vector3::z() * 0.01).norm() < 2e-3, "{above}");
        // Home is where the hand left it.
        let home = task.home.unwrap();
        let rests = observer.arm().unwrap();
        for (is, wanted) in rests.q.iter().zip(&home.joints_rad) {
            assert!((is - wanted).abs() < 5e-3, "{:?} {:?}", rests.q, home);
        }
        assert_eq!(start.joints_rad.len(), 6);
    });
}

#[test]
fn a_teacher_who_disappears_leaves_an_arm_that_holds_itself() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&["router simulator netft rtde"]);
        let observer = Observer::join(&cell);
        until(&observer, "the arm is ready", |arm| arm.ready);
        let mut person = Person::start(&cell, &observer, &["lost"]);
        person.hears("the arm is FREE");
        until(&observer, "free", |arm| arm.program_state == GUIDED);
        // A second one is told who guides it.
        let second = cell.cli(&["teach", "second"]);
        assert_eq!(second.status.code(), Some(1));
        assert!(
            stderr(&second).contains("guides the arm"),
            "{}",
            stderr(&second)
        );
        person.terminal.child.kill().unwrap();
        until(&observer, "held", |arm| arm.ready);
        drop(person.terminal.child.wait());
    });
}

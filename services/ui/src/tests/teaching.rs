//! Teaching from a page, with a teacher in place of an arm.

use super::*;
use crate::{TaskWish, TaughtMark, TaughtTask, TeachState, TeachStep, Teacher};

/// Counts the points that one person takes.
#[derive(Default)]
pub struct Pupil(Mutex<TeachState>);

impl Teacher for Pupil {
    fn step(&self, who: &str, step: TeachStep) -> Result<String, String> {
        let mut state = lock(&self.0);
        match step {
            TeachStep::Begin => {
                state.who = who.to_owned();
                state.free = true;
            }
            TeachStep::Point => state.points += 1,
            TeachStep::Hold => state.free = false,
            TeachStep::Discard => *state = TeachState::default(),
            TeachStep::Keep => {}
            _ => return Err("the arm has not moved".to_owned()),
        }
        state.revision += 1;
        Ok(String::new())
    }

    fn draft(&self, _: &str, wish: &TaskWish) -> Result<TaughtTask, String> {
        if lock(&self.0).points < 2 {
            return Err("a path needs two places".to_owned());
        }
        Ok(TaughtTask {
            text: format!(
                "name = '{}'\nforce.reference_n = {}\n[path]\nkind = 'stay'\nduration_s = 1.0\n",
                wish.name, wish.force_n
            ),
            places: 2,
            length_m: 0.04,
            notes: vec!["uneven".to_owned()],
        })
    }

    fn state(&self) -> Option<TeachState> {
        let state = lock(&self.0).clone();
        (!state.who.is_empty()).then_some(state)
    }

    fn marks(&self) -> Vec<TaughtMark> {
        let mark = TaughtMark {
            kind: "point",
            places_m: vec![[0.4, 0.0, 0.1]],
        };
        vec![mark; lock(&self.0).points]
    }
}

fn wish(name: &str, replace: bool) -> Value {
    json!({ "save": {
        "name": name, "shape": "open", "force_n": 4.0, "speed_m_per_s": 0.02,
        "clearance_m": 0.03, "tolerance_m": 0.002, "replace": replace,
    } })
}

#[test]
fn an_engineer_teaches_a_task_that_can_then_be_started() {
    let page = Page::start(|_| {});
    let records = page
        .bus
        .subscribe(&tangent_schemas::topics::OPERATOR_COMMAND, 64)
        .unwrap();
    let step = |token: &str, step: &str| page.post("/api/teach", token, &json!({ "step": step }));
    for token in ["", &page.operator] {
        assert_eq!(step(token, "begin").0, 401);
        assert_eq!(page.post("/api/teach", token, &wish("lid", false)).0, 401);
    }
    let odd = json!({ "step": "fly" });
    assert_eq!(page.post("/api/teach", &page.engineer, &odd).0, 400);
    assert_eq!(page.get_json("/api/about")["can_teach"], true);
    for name in ["begin", "keep", "point"] {
        assert_eq!(step(&page.engineer, name).1["done"], true, "{name}");
    }
    let save = |name: &str, replace| {
        let (status, answer) = page.post("/api/teach", &page.engineer, &wish(name, replace));
        assert_eq!(status, 200, "{answer}");
        answer
    };
    assert_eq!(save("lid", false)["done"], false, "one place is no path");
    assert_eq!(step(&page.engineer, "point").1["done"], true);
    assert_eq!(
        step(&page.engineer, "home").1["message"],
        "the arm has not moved"
    );
    let shown = page.stream().find(|s| s["teach"]["points"] == 2).unwrap();
    assert_eq!(shown["teach"]["who"], "ben");
    let marks = page.get_json("/api/teach");
    assert_eq!(marks["marks"][1]["places_mm"], json!([[400.0, 0.0, 100.0]]));
    assert_eq!(marks["revision"], shown["teach"]["revision"]);

    assert_eq!(save("../lid", false)["done"], false);
    let exists = save("wipe", false);
    assert_eq!(
        (&exists["done"], &exists["exists"]),
        (&json!(false), &json!(true))
    );
    let free = page.stream().next().unwrap();
    assert_eq!(free["teach"]["free"], true, "asking first changes nothing");
    let saved = save("lid", false);
    assert_eq!(saved["file"], "lid.toml", "{saved}");
    assert_eq!(saved["notes"], json!(["uneven"]));
    let tasks = page.get_json("/api/tasks");
    let files: Vec<&str> = tasks["tasks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|task| task["file"].as_str().unwrap())
        .collect();
    assert_eq!(files, ["lid.toml", "wipe.toml"]);
    assert!(page.stream().any(|s| s["teach"].is_null()));

    let (_task, tasks) = page.cell(queries::CONTROL_TASK);
    let start = json!({ "action": "start", "task": "lid.toml" });
    assert_eq!(
        page.post("/api/command", &page.operator, &start).1["done"],
        true
    );
    assert!(
        tasks
            .recv_timeout(PATIENCE)
            .unwrap()
            .argument
            .contains("'lid'")
    );

    let said: Vec<(String, bool)> = std::iter::from_fn(|| records.try_recv())
        .map(|record| record.message)
        .filter(|record| record.action.as_str() == "teach")
        .map(|record| (record.argument.to_string(), record.done))
        .collect();
    let said: Vec<(&str, bool)> = said
        .iter()
        .map(|(what, done)| (what.as_str(), *done))
        .collect();
    assert_eq!(
        said,
        [
            ("begin", true),
            ("point", true),
            ("save lid.toml", false),
            ("point", true),
            ("home", false),
            ("save ../lid.toml", false),
            ("save wipe.toml", false),
            ("save lid.toml", true),
        ]
    );
}

#[test]
fn nothing_is_saved_into_the_folder_of_the_tasks_that_ship() {
    let page = Page::start(|config| config.missing_tasks = Some("tasks".into()));
    for step in ["begin", "point", "point"] {
        page.post("/api/teach", &page.engineer, &json!({ "step": step }));
    }
    let (_, answer) = page.post("/api/teach", &page.engineer, &wish("lid", false));
    let why = answer["message"].as_str().unwrap();
    assert!(
        why.contains("ui.tasks") && why.contains("make it"),
        "{answer}"
    );
}

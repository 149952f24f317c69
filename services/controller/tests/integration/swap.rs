//! Switches of estimators while the tool slides: on request, and because the one in use became
//! invalid.

use crate::common::{Cell, Mood, PERIOD_S, long_task};
use tangent_live::timed;
use tangent_schemas::topics::queries;

/// Timeout of an estimate in the law, s.
const PATIENCE_S: f64 = 0.1;

/// `blend` in use, `quadratic` beside it; both in the task's list.
fn cell(keys: &str) -> Cell {
    let mut cell = Cell::new();
    cell.add("quadratic");
    let list = format!("estimators = [\"blend\", \"quadratic\"]\n{keys}");
    cell.slide(&long_task().replace("estimators = [\"blend\"]", &list));
    for _ in 0..100 {
        cell.packet(true);
    }
    cell
}

#[test]
fn a_switch_is_refused_with_a_reason_or_there_within_a_cycle() {
    timed(|| {
        let mut cell = cell("switching.disagreement_max_rad = 0.1");
        let mut ask = |mood: Mood, action: &str, name: &str| {
            cell.speakers[1].mood = mood;
            for _ in 0..50 {
                cell.packet(true);
            }
            let answer = cell.ask(queries::CONTROL_SELECT, action, name).unwrap();
            cell.packet(true);
            let said = cell.said();
            (answer, said)
        };
        for (mood, action, name, word) in [
            (Mood::Dead, "select", "quadratic", "no fresh estimate"),
            (Mood::Dead, "force", "quadratic", "no fresh estimate"),
            (Mood::Invalid, "select", "quadratic", "no normal now"),
            (
                Mood::Leaning(8.0),
                "select",
                "quadratic",
                "8.0 deg from the one in use, and 5.7 is allowed",
            ),
            (Mood::Well, "select", "nobody", "no fresh estimate"),
        ] {
            let (answer, said) = ask(mood, action, name);
            assert!(
                !answer.done && answer.message.contains(word),
                "{mood:?}: {}",
                answer.message
            );
            assert_eq!(
                (said.estimator.as_str(), said.estimator_switches),
                ("blend", 0)
            );
        }
        let (answer, said) = ask(Mood::Well, "select", "quadratic");
        assert!(answer.done, "{}", answer.message);
        assert_eq!(said.estimator.as_str(), "quadratic");
        assert_eq!(said.estimator_cause.as_str(), "asked for");
        assert!((said.force_n - 3.0).abs() < 0.3, "{}", said.force_n);
        let (answer, said) = ask(Mood::Leaning(8.0), "force", "quadratic");
        assert!(answer.done, "{}", answer.message);
        assert_eq!(said.estimator_cause.as_str(), "forced");
        cell.end();
    });
}

#[test]
fn whenever_the_estimator_in_use_fails_the_next_takes_over_with_the_force_held() {
    timed(|| {
        for mood in [
            Mood::Dead,
            Mood::Frozen,
            Mood::Stuck,
            Mood::NotANumber,
            Mood::Garbage,
            Mood::WrongType,
            Mood::Leaning(120.0),
        ] {
            let mut cell = cell("");
            cell.speakers[0].mood = mood;
            let mut cycles = 0;
            loop {
                cell.packet(true);
                cycles += 1;
                let said = cell.said();
                assert_eq!(
                    said.phase_text.as_str(),
                    "slide",
                    "{mood:?}: {}",
                    said.fault
                );
                assert!(
                    (said.force_n - 3.0).abs() < 0.3,
                    "{mood:?}: {}",
                    said.force_n
                );
                if said.estimator.as_str() == "quadratic" {
                    assert!(
                        said.estimator_cause.starts_with("fell back"),
                        "{}",
                        said.estimator_cause
                    );
                    break;
                }
                let since_s = f64::from(cycles) * PERIOD_S;
                assert!(
                    since_s < PATIENCE_S + 3.0 * PERIOD_S,
                    "{mood:?}: not after {since_s} s"
                );
            }
            // Valid again, it is used again only on request.
            cell.speakers[0].mood = Mood::Well;
            for _ in 0..500 {
                cell.packet(true);
            }
            assert_eq!(cell.said().estimator.as_str(), "quadratic", "{mood:?}");
            let answer = cell
                .ask(queries::CONTROL_SELECT, "select", "blend")
                .unwrap();
            assert!(answer.done, "{mood:?}: {}", answer.message);
            cell.packet(true);
            assert_eq!(cell.said().estimator.as_str(), "blend", "{mood:?}");
            cell.end();
        }
    });
}

#[test]
fn the_first_returns_by_the_tasks_rule() {
    timed(|| {
        let mut cell = cell("switching.return_after_good_s = 0.8");
        cell.speakers[0].mood = Mood::Dead;
        for _ in 0..40 {
            cell.packet(true);
        }
        assert_eq!(cell.said().estimator.as_str(), "quadratic");
        cell.speakers[0].mood = Mood::Well;
        let mut cycles = 0;
        while cell.said().estimator.as_str() != "blend" {
            cell.packet(true);
            cycles += 1;
            assert!(cycles < 200);
        }
        assert!(f64::from(cycles) * PERIOD_S > 0.75, "{cycles}");
        assert!(cell.said().estimator_cause.starts_with("returned"));
        cell.end();
    });
}

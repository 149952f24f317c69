//! What was drawn for a run, and the groups of runs that the second table of a suite compares.

use std::ops::RangeBounds;

use serde::Serialize;

/// What was drawn for a run, of what the second table tells apart. Values that were overridden are
/// those of the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Conditions {
    /// Pressing force of the task, N.
    pub reference_n: f64,
    /// Stiffness of the contact as seen from the flange, kN/m. A soft tip is in series with it.
    pub stiffness_kn_per_m: f64,
    /// Shape of the true tip: `round`, `flat`, `ring` or `soft`; `pad` for a tool without a tip.
    pub tip: &'static str,
    /// Shape of the tip as the estimators are told, or `unknown`.
    pub stated_tip: &'static str,
    /// Angle of the tool off the normal at touchdown, degrees.
    pub landed_deg: f64,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// Speed that the task asks for along its path, mm/s.
    pub speed_mm_per_s: f64,
    /// Model of the robot: `ur5`, at 125 Hz, or `ur5e`, at 500 Hz.
    pub robot: String,
}

/// Runs that have something drawn in common: a row of the second table.
pub(super) struct Group {
    /// What was drawn, with its unit.
    pub kind: &'static str,
    /// Range or name, in nine columns with a space before it.
    pub name: &'static str,
    /// Whether a run is of the group.
    pub holds: fn(&Conditions) -> bool,
}

/// Landing angle from which a tool counts as landed off the normal, degrees.
pub(super) const LANDED_OFF_DEG: f64 = 10.0;

const ALL: &str = "all";
const FORCE: &str = "force, N";
const STIFFNESS: &str = "stiffness of hard tips, kN/m";
const TIP: &str = "tip";
const STATED_TIP: &str = "tip as stated";
const LANDED: &str = "landed off, deg";
const FRICTION: &str = "friction";
const SPEED: &str = "speed, mm/s";
const ROBOT: &str = "robot";

/// All groups, in the order of the table. A range is without its upper end, so that a draw is in
/// one group of a kind; the last range of a kind has its upper end too, for a run with just that
/// value.
pub(super) const GROUPS: &[Group] = &[
    group(ALL, "all", |_| true),
    group(FORCE, "1-2", |c| (1.0..2.0).contains(&c.reference_n)),
    group(FORCE, "2-5", |c| (2.0..5.0).contains(&c.reference_n)),
    group(FORCE, "5-10", |c| (5.0..10.0).contains(&c.reference_n)),
    group(FORCE, "10-30", |c| (10.0..=30.0).contains(&c.reference_n)),
    group(STIFFNESS, "1-5", |c| is_hard(c, 1.0..5.0)),
    group(STIFFNESS, "5-15", |c| is_hard(c, 5.0..15.0)),
    group(STIFFNESS, "15-50", |c| is_hard(c, 15.0..50.0)),
    group(STIFFNESS, "50-100", |c| is_hard(c, 50.0..=100.0)),
    group(TIP, "round", |c| c.tip == "round"),
    group(TIP, "flat", |c| c.tip == "flat"),
    group(TIP, "ring", |c| c.tip == "ring"),
    group(TIP, "soft", is_soft),
    group(STATED_TIP, "unknown", |c| c.stated_tip == "unknown"),
    group(LANDED, "0-10", |c| {
        (0.0..LANDED_OFF_DEG).contains(&c.landed_deg)
    }),
    group(LANDED, "10-25", |c| {
        (LANDED_OFF_DEG..=25.0).contains(&c.landed_deg)
    }),
    group(FRICTION, "0.05-0.3", |c| (0.05..0.3).contains(&c.friction)),
    group(FRICTION, "0.3-0.6", |c| (0.3..0.6).contains(&c.friction)),
    group(FRICTION, "0.6-0.9", |c| (0.6..=0.9).contains(&c.friction)),
    group(SPEED, "5-30", |c| (5.0..30.0).contains(&c.speed_mm_per_s)),
    group(SPEED, "30-80", |c| {
        (30.0..=80.0).contains(&c.speed_mm_per_s)
    }),
    group(ROBOT, "ur5", |c| c.robot == "ur5"),
    group(ROBOT, "ur5e", |c| c.robot == "ur5e"),
];

const fn group(kind: &'static str, name: &'static str, holds: fn(&Conditions) -> bool) -> Group {
    Group { kind, name, holds }
}

fn is_soft(conditions: &Conditions) -> bool {
    conditions.tip == "soft"
}

/// Whether the tip is not soft, and the stiffness, kN/m, lies in a range.
fn is_hard(conditions: &Conditions, range: impl RangeBounds<f64>) -> bool {
    !is_soft(conditions) && range.contains(&conditions.stiffness_kn_per_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suite::{SurfaceKind, draw};

    /// Number of groups of a kind that a run is in.
    fn groups_of(conditions: &Conditions, kind: &str) -> usize {
        let of_kind = GROUPS.iter().filter(|group| group.kind == kind);
        of_kind.filter(|group| (group.holds)(conditions)).count()
    }

    #[test]
    fn every_draw_is_in_one_group_of_a_kind() {
        let numbers = |surface| (0..20).map(move |number| draw(surface, number, 1));
        let mut members = vec![0; GROUPS.len()];
        for draw in SurfaceKind::ALL.into_iter().flat_map(numbers) {
            let conditions = draw.conditions();
            for kind in [ALL, FORCE, TIP, LANDED, FRICTION, SPEED, ROBOT] {
                assert_eq!(groups_of(&conditions, kind), 1, "{kind}: {draw}");
            }
            let hard = usize::from(!is_soft(&conditions));
            assert_eq!(groups_of(&conditions, STIFFNESS), hard, "{draw}");
            for (count, group) in members.iter_mut().zip(GROUPS) {
                *count += usize::from((group.holds)(&conditions));
            }
        }
        assert!(members.iter().all(|&count| count > 0), "{members:?}");
    }

    #[test]
    fn the_ranges_of_a_kind_follow_one_another_and_are_those_of_their_names() {
        let some = || draw(SurfaceKind::Plane, 0, 1).conditions();
        type Set = fn(&mut Conditions, f64);
        let kinds: [(&str, Set); 5] = [
            (FORCE, |c, x| c.reference_n = x),
            (STIFFNESS, |c, x| {
                (c.stiffness_kn_per_m, c.tip) = (x, "flat");
            }),
            (LANDED, |c, x| c.landed_deg = x),
            (FRICTION, |c, x| c.friction = x),
            (SPEED, |c, x| c.speed_mm_per_s = x),
        ];
        for (kind, set) in kinds {
            let mut end = None;
            for group in GROUPS.iter().filter(|group| group.kind == kind) {
                let (low, high) = group.name.split_once('-').unwrap();
                let (low, high): (f64, f64) = (low.parse().unwrap(), high.parse().unwrap());
                assert!(end.is_none_or(|end| end == low), "{kind} {}", group.name);
                end = Some(high);
                for value in [low, 0.5 * (low + high), high - 1e-9] {
                    let mut conditions = some();
                    set(&mut conditions, value);
                    assert!((group.holds)(&conditions), "{kind} {}: {value}", group.name);
                    assert_eq!(groups_of(&conditions, kind), 1, "{kind}: {value}");
                }
            }
            let mut conditions = some();
            set(&mut conditions, end.unwrap());
            assert_eq!(groups_of(&conditions, kind), 1, "{kind}: upper end");
            set(&mut conditions, end.unwrap() + 1e-9);
            assert_eq!(groups_of(&conditions, kind), 0, "{kind}: beyond");
        }
    }
}

//! Valid ranges of the numbers among a law's parameters: one kind of table for all laws, compared
//! with the parameters as they are written in a file.

use serde::Serialize;
use toml::{Table, Value};

use crate::error::{ControlError, check_range};

/// A key with its minimum and maximum; for a list, those of each entry.
pub(crate) type Range = (&'static str, f64, f64);

/// Numbers of each table of a configuration: the table's name, such as `force` or `force.tank`, and
/// the ranges of its keys.
pub(crate) type Ranges = &'static [(&'static str, &'static [Range])];

/// Timeouts of missing and of invalid input, in every law. They determine when an arm stops: the
/// longest are needed by a simulated cell on a busy laptop.
pub(crate) const PATIENCE: &[Range] = &[
    ("wrench_cycles", 1.0, 20.0),
    ("wrench_jitter_s", 0.0, 0.1),
    ("wrench_bad_cycles", 1.0, 10.0),
    ("wrench_retract_s", 0.0, 2.0),
    ("estimate_s", 0.01, 2.0),
    ("estimate_retract_s", 0.0, 10.0),
    ("base_retract_s", 0.0, 10.0),
];

/// Path profile and clock, in the torque laws.
pub(crate) const PATH_PROFILE: &[Range] = &[
    ("acceleration_m_per_s2", 0.005, 5.0),
    ("jerk_m_per_s3", 0.01, 100.0),
    ("clock_ramp_s", 0.01, 5.0),
];

/// How a tool leaves a surface, in every law.
pub(crate) const LEAVE: &[Range] = &[
    ("speed_m_per_s", 0.001, 0.05),
    ("free_m", 0.001, 0.05),
    ("steady_n", 0.01, 20.0),
    ("distance_max_m", 0.005, 0.2),
    ("grow_n", 0.1, 50.0),
    ("opposed_n", 0.1, 100.0),
    ("opposed_nm", 0.01, 50.0),
    ("blind_speed_m_per_s", 0.001, 0.1),
    ("near_m", 0.001, 0.1),
    ("touch_at_once_m", 0.0, 0.01),
];

/// Joint friction that a law compensates.
pub(crate) const FRICTION: &[Range] = &[
    ("viscous_nm_s_per_rad", 0.0, 1e4),
    ("coulomb_nm", 0.0, 1e4),
    ("coulomb_speed_rad_per_s", 1e-6, 10.0),
];

/// An energy tank; `EnergyTank::check` compares its numbers with each other.
pub(crate) const TANK: &[Range] = &[
    ("initial_j", 0.0, 10_000.0),
    ("lower_j", 0.0, 1000.0),
    ("upper_j", 1e-3, 10_000.0),
    ("band_j", 1e-3, 5000.0),
    ("reserve_j", 0.0, 5000.0),
];

/// Checks that every number of `config` is within its range; a number without a range is refused
/// too, so that none can be forgotten.
///
/// # Errors
/// [`ControlError::Range`] with the key, its value and the allowed range.
pub(crate) fn check_all(config: &impl Serialize, ranges: Ranges) -> Result<(), ControlError> {
    let table = Table::try_from(config).map_err(|e| ControlError::Syntax(e.to_string()))?;
    check_table("", &table, ranges)
}

fn check_table(name: &str, table: &Table, ranges: Ranges) -> Result<(), ControlError> {
    let known = ranges.iter().find(|(section, _)| *section == name);
    for (key, value) in table {
        let path = if name.is_empty() {
            key.clone()
        } else {
            format!("{name}.{key}")
        };
        if let Value::Table(inner) = value {
            check_table(&path, inner, ranges)?;
            continue;
        }
        let range = known.and_then(|(_, keys)| keys.iter().find(|(known, ..)| known == key));
        for number in numbers(value) {
            match range {
                Some((_, lower, upper)) => check_range(&path, number, *lower, *upper)?,
                None => {
                    return Err(ControlError::range(
                        path,
                        number,
                        "nothing: no range is known for it; this is a defect",
                    ));
                }
            }
        }
    }
    Ok(())
}

/// The numbers in a value: one, those of a list, or none.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Float(x) => vec![*x],
        Value::Integer(n) => vec![*n as f64],
        Value::Array(list) => list.iter().flat_map(numbers).collect(),
        _ => Vec::new(),
    }
}

/// Checks of the ranges of every law.
#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::parameters::PatienceConfig;
    use crate::parameters::law_config::LawConfig;
    use crate::parameters::overlay::with_changes;
    use serde::de::DeserializeOwned;

    /// Paths of all numbers of a table.
    fn keys(name: &str, table: &Table, found: &mut Vec<String>) {
        for (key, value) in table {
            let path = if name.is_empty() {
                key.clone()
            } else {
                format!("{name}.{key}")
            };
            match value {
                Value::Table(inner) => keys(&path, inner, found),
                other if !numbers(other).is_empty() => found.push(path),
                _ => {}
            }
        }
    }

    /// The change of one key, as in a file.
    fn change(path: &str, value: Value) -> Table {
        let (key, sections) = {
            let mut parts: Vec<&str> = path.split('.').collect();
            (parts.pop().unwrap_or_default(), parts)
        };
        let mut table = Table::from_iter([(key.to_owned(), value)]);
        for section in sections.into_iter().rev() {
            table = Table::from_iter([(section.to_owned(), Value::Table(table))]);
        }
        table
    }

    /// Checks that every number of `config` has a range and every range a number, and that `check`
    /// refuses each value outside: NaN, infinities, and values beyond either end. All optional
    /// parts of `config` must be present.
    pub(crate) fn every_number_has_a_range_that_holds<T>(
        config: &T,
        ranges: Ranges,
        check: impl Fn(&T) -> Result<(), ControlError>,
    ) where
        T: Clone + Serialize + DeserializeOwned,
    {
        check(config).unwrap();
        let mut found = Vec::new();
        keys("", &Table::try_from(config).unwrap(), &mut found);
        let mut known: Vec<String> = ranges
            .iter()
            .flat_map(|(section, keys)| {
                keys.iter().map(move |(key, ..)| format!("{section}.{key}"))
            })
            .collect();
        found.sort_unstable();
        known.sort_unstable();
        assert_eq!(found, known, "numbers of the parameters, and ranges");

        for (section, keys) in ranges {
            for (key, lower, upper) in *keys {
                let path = format!("{section}.{key}");
                let beyond = [
                    f64::NAN,
                    f64::INFINITY,
                    f64::NEG_INFINITY,
                    1e300,
                    upper + upper.abs().max(1.0),
                    lower - lower.abs().max(1.0),
                ];
                for bad in beyond {
                    for value in spellings(config, &path, bad) {
                        // A value that cannot be read as its type is refused earlier.
                        if let Ok(changed) = with_changes(config.clone(), &change(&path, value)) {
                            let error = check(&changed).unwrap_err().to_string();
                            assert!(error.contains(&path), "{path} = {bad}: {error}");
                        }
                    }
                }
            }
        }
    }

    /// Checks that `config` refuses a timeout of the wrench that is too long, or no number.
    pub(crate) fn patience_ends<T: Clone + LawConfig>(
        config: &T,
        patience: impl Fn(&mut T) -> &mut PatienceConfig,
    ) {
        for (cycles, retract_s) in [(1e5, 0.1), (2.0, f64::INFINITY), (2.0, f64::NAN)] {
            let mut config = config.clone();
            patience(&mut config).wrench_cycles = cycles;
            patience(&mut config).wrench_retract_s = retract_s;
            let error = config.check().unwrap_err().to_string();
            assert!(error.contains("patience.wrench_"), "{error}");
        }
    }

    /// `config` with `bad` in place of the number at `path`, or of each entry of the list there.
    fn spellings(config: &impl Serialize, path: &str, bad: f64) -> Vec<Value> {
        let table = Table::try_from(config).unwrap();
        let mut value = &Value::Table(table);
        for part in path.split('.') {
            value = value.get(part).unwrap();
        }
        let same_type = |old: &Value| match old {
            Value::Integer(_) => Value::Integer(bad as i64),
            _ => Value::Float(bad),
        };
        match value {
            Value::Array(list) => (0..list.len())
                .map(|i| {
                    let mut list = list.clone();
                    list[i] = same_type(&list[i]);
                    Value::Array(list)
                })
                .collect(),
            // As an integer, NaN would become zero, which may be valid.
            Value::Integer(_) if bad.is_nan() => Vec::new(),
            other => vec![same_type(other)],
        }
    }

    #[test]
    fn a_number_without_a_range_is_refused_by_name() {
        let table: Table = toml::from_str("[a]\nb = 1.0\n[a.c]\nd = [1, 2]").unwrap();
        let error = check_all(&table, &[("a", &[("b", 0.0, 1.0)])]).unwrap_err();
        assert!(error.to_string().contains("a.c.d"), "{error}");
        let ranges: Ranges = &[("a", &[("b", 0.0, 1.0)]), ("a.c", &[("d", 0.0, 1.0)])];
        let error = check_all(&table, ranges).unwrap_err();
        assert_eq!(error.to_string(), "`a.c.d` is 2: allowed is 0 to 1");
    }
}

//! A force that varies along a way: places with a force each, linear between them.

use crate::error::{ControlError, check_range};

/// Most places of one profile.
const PLACES_MAX: usize = 10_000;
/// Lowest and highest pressing force, N.
pub(crate) const FORCE_N: (f64, f64) = (0.5, 100.0);

/// Checks a profile: `[way in m, force in N]` each, the ways from 0 upwards.
pub(crate) fn check_force_profile(key: &str, profile: &[[f64; 2]]) -> Result<(), ControlError> {
    if profile.is_empty() || profile.len() > PLACES_MAX {
        let allowed = format!("1 to {PLACES_MAX} pairs of a way in m and a force in N");
        let value = format!("{} pairs", profile.len());
        return Err(ControlError::range(key, value, &allowed));
    }
    let mut before = None;
    for (index, [way_m, force_n]) in profile.iter().enumerate() {
        let key = format!("{key}[{index}]");
        check_range(&format!("{key}: way, m"), *way_m, 0.0, 1e4)?;
        check_range(&format!("{key}: force, N"), *force_n, FORCE_N.0, FORCE_N.1)?;
        if before.is_some_and(|before| *way_m <= before) {
            let allowed = "ways that increase from pair to pair";
            return Err(ControlError::range(key, format!("{way_m} m"), allowed));
        }
        before = Some(*way_m);
    }
    Ok(())
}

/// Force at a way, N: linear between the places of the profile, constant beyond its ends.
pub(super) fn force_at(profile: &[[f64; 2]], way_m: f64) -> Option<f64> {
    let next = profile.partition_point(|[at_m, _]| *at_m <= way_m);
    match (
        next.checked_sub(1).and_then(|i| profile.get(i)),
        profile.get(next),
    ) {
        (Some([from_m, from_n]), Some([to_m, to_n])) => {
            Some(from_n + (to_n - from_n) * (way_m - from_m) / (to_m - from_m))
        }
        (Some([_, only_n]), None) | (None, Some([_, only_n])) => Some(*only_n),
        (None, None) => None,
    }
}

/// Steepest change of a profile, N per m.
pub(super) fn steepest_n_per_m(profile: &[[f64; 2]]) -> f64 {
    let slope = |ends: &[[f64; 2]]| ((ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0])).abs();
    profile.windows(2).map(slope).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_linear_between_its_places_and_constant_beyond() {
        let profile = [[0.01, 3.0], [0.05, 8.0], [0.06, 4.0]];
        check_force_profile("p", &profile).unwrap();
        for (way_m, force_n) in [
            (0.0, 3.0),
            (0.01, 3.0),
            (0.03, 5.5),
            (0.055, 6.0),
            (1.0, 4.0),
        ] {
            let found = force_at(&profile, way_m).unwrap();
            assert!((found - force_n).abs() < 1e-9, "{way_m}: {found}");
        }
        assert!((steepest_n_per_m(&profile) - 400.0).abs() < 1e-6);
        assert_eq!(force_at(&[], 0.1), None);
    }

    #[test]
    fn bad_profiles_are_refused_with_the_pair() {
        for (profile, word) in [
            (vec![], "0 pairs"),
            (vec![[0.0, 3.0], [0.0, 4.0]], "p[1]"),
            (vec![[0.0, 0.1]], "force"),
            (vec![[f64::NAN, 3.0]], "way"),
            (vec![[0.0, 3.0], [0.1, 200.0]], "p[1]: force"),
        ] {
            let error = check_force_profile("p", &profile).unwrap_err().to_string();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}

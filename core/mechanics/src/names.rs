//! Suggestions for misspelt names in error messages.
//!
//! Used for every name that a user enters: models, scenarios, estimators, presets, parameters and
//! configuration keys.

/// The candidate nearest to `word`; `None` if no candidate is near.
///
/// The distance counts insertions, deletions, replacements and swapped neighbours (Damerau 1964),
/// without regard to case. A third of the word's letters may be wrong. A candidate that begins with
/// `word` counts as near.
///
/// ```
/// use tangent_mechanics::names::nearest;
/// assert_eq!(nearest("quadratik", ["reactive", "quadratic"]), Some("quadratic"));
/// assert_eq!(nearest("kalman", ["reactive", "quadratic"]), None);
/// ```
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase();
    let most = (word.chars().count() / 3).max(1);
    candidates
        .into_iter()
        .map(|candidate| {
            let lower = candidate.to_lowercase();
            let begins = !word.is_empty() && lower.starts_with(&word);
            (
                strsim::damerau_levenshtein(&word, &lower),
                begins,
                candidate,
            )
        })
        .filter(|(distance, begins, _)| *distance <= most || *begins)
        .min_by_key(|(distance, _, _)| *distance)
        .map(|(_, _, candidate)| candidate)
}

/// End of an error message: `, did you mean NAME?`, or nothing if no candidate is near.
///
/// ```
/// use tangent_mechanics::names::did_you_mean;
/// assert_eq!(did_you_mean("blned", ["blend"]), ", did you mean `blend`?");
/// ```
pub fn did_you_mean<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> String {
    nearest(word, candidates).map_or_else(String::new, |near| format!(", did you mean `{near}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 4] = ["reactive", "quadratic", "gaussian_process", "blend"];

    #[test]
    fn a_misspelt_name_is_recognised() {
        for (word, meant) in [
            ("reactiv", "reactive"),
            ("blned", "blend"),
            ("Blend", "blend"),
            ("quadratik", "quadratic"),
            ("gaussian", "gaussian_process"),
        ] {
            assert_eq!(nearest(word, NAMES), Some(meant), "{word}");
        }
    }

    #[test]
    fn an_unrelated_word_is_not_recognised() {
        for word in ["kalman", "", "x"] {
            assert_eq!(nearest(word, NAMES), None, "{word}");
        }
        assert_eq!(did_you_mean("kalman", NAMES), "");
        assert_eq!(did_you_mean("blent", NAMES), ", did you mean `blend`?");
    }
}

//! The known name that a misspelt one is nearest to, for error messages. Called wherever a user
//! names something: models, scenarios, estimators, presets, parameters, configuration keys.

/// The candidate that a few typing errors turn into `word`; none where no candidate is near.
///
/// The distance counts insertions, deletions, replacements and swapped neighbours (Damerau 1964),
/// without regard to case. A third of the word's letters may be wrong. A candidate that begins with
/// `word` is near too.
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

/// `, did you mean NAME?`, or nothing where no candidate is near: completes an error message.
pub fn did_you_mean<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> String {
    nearest(word, candidates).map_or_else(String::new, |near| format!(", did you mean `{near}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 4] = ["reactive", "quadratic", "gaussian_process", "blend"];

    #[test]
    fn a_slip_of_the_finger_is_understood() {
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
    fn another_word_is_not() {
        for word in ["kalman", "", "x"] {
            assert_eq!(nearest(word, NAMES), None, "{word}");
        }
        assert_eq!(did_you_mean("kalman", NAMES), "");
        assert_eq!(did_you_mean("blent", NAMES), ", did you mean `blend`?");
    }
}

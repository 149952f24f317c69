//! Key patterns of `[recorder] include`: `*` stands for one part of a key, `**` for any number of
//! parts.

/// Whether any of the patterns matches the key: in a pattern, `*` is one part of a key, `**` any
/// number of parts.
pub fn matches_any(patterns: &[String], key: &str) -> bool {
    patterns.iter().any(|pattern| matches(pattern, key))
}

fn matches(pattern: &str, key: &str) -> bool {
    let pattern: Vec<&str> = pattern.split('/').collect();
    let key: Vec<&str> = key.split('/').collect();
    parts_match(&pattern, &key)
}

fn parts_match(pattern: &[&str], key: &[&str]) -> bool {
    match (pattern, key) {
        ([], []) => true,
        (["**", rest @ ..], _) => (0..=key.len()).any(|skip| parts_match(rest, &key[skip..])),
        ([first, rest @ ..], [part, more @ ..]) => {
            (*first == "*" || first == part) && parts_match(rest, more)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_match_parts_and_double_stars_any_number() {
        for (pattern, key, expected) in [
            ("**", "arm/state", true),
            ("arm/*", "arm/state", true),
            ("arm/*", "arm/state/more", false),
            ("estimate/*/normal", "estimate/blend/normal", true),
            ("estimate/**", "estimate", true),
            ("**/normal", "estimate/blend/normal", true),
            ("arm/state", "arm/command", false),
            ("*", "arm/state", false),
        ] {
            assert_eq!(matches(pattern, key), expected, "{pattern} {key}");
        }
    }
}

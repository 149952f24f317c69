//! Removes places in source code from texts of Zenoh: its errors end with ` at FILE.rs:LINE.`, with
//! a path of the machine that built the program, which means nothing to a user.

use std::borrow::Cow;

/// The text without such places.
///
/// ```
/// use tangent_runtime::places::without_places;
/// let text = "Can not connect at /home/me/zenoh/src/unicast.rs:12. - Caused by refused";
/// assert_eq!(without_places(text), "Can not connect - Caused by refused");
/// ```
pub fn without_places(text: &str) -> Cow<'_, str> {
    let mut kept = String::new();
    let mut rest = text;
    while let Some((before, place)) = next(rest) {
        kept.push_str(before);
        rest = &rest[before.len() + place..];
    }
    if kept.is_empty() && rest.len() == text.len() {
        return Cow::Borrowed(text);
    }
    kept.push_str(rest);
    Cow::Owned(kept)
}

/// Text before the next place, and the length of the place.
fn next(text: &str) -> Option<(&str, usize)> {
    const AT: &str = " at ";
    let mut from = 0;
    while let Some(found) = text[from..].find(AT) {
        let start = from + found;
        let word = &text[start + AT.len()..];
        let end = word.find(char::is_whitespace).unwrap_or(word.len());
        if let Some(length) = place(&word[..end]) {
            return Some((&text[..start], AT.len() + length));
        }
        from = start + AT.len();
    }
    None
}

/// Length of `FILE.rs:LINE` at the start of a word, with the full stop that may follow.
fn place(word: &str) -> Option<usize> {
    const SOURCE: &str = ".rs:";
    let line = word.find(SOURCE)? + SOURCE.len();
    let digits = word[line..].bytes().take_while(u8::is_ascii_digit).count();
    if digits == 0 {
        return None;
    }
    let end = line + digits;
    Some(end + usize::from(word[end..].starts_with('.')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_place_is_removed_and_nothing_else() {
        for (text, plain) in [
            ("all is well at home", "all is well at home"),
            ("read main.rs: 3 lines", "read main.rs: 3 lines"),
            (
                "Unable to connect to tcp/1.2.3.4:7447! Can not create a new TCP link at \
                 /build/registry/zenoh-link-tcp-1.10.2/src/unicast.rs:360.",
                "Unable to connect to tcp/1.2.3.4:7447! Can not create a new TCP link",
            ),
            (
                "a at x/y.rs:1. - Caused by b at /z.rs:22. - Caused by c",
                "a - Caused by b - Caused by c",
            ),
            ("(closed at z.rs:7)\n", "(closed)\n"),
        ] {
            assert_eq!(without_places(text), plain);
        }
    }
}

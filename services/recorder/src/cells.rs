//! Cells that are recorded: the bus's own, or several of one network, whose names are then part of
//! every key and topic.

/// Names of the cells; empty for the bus's own.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells(Vec<String>);

impl Cells {
    pub(crate) fn new(names: Vec<String>) -> Self {
        Self(names)
    }

    /// Prefix of each cell's keys: `CELL/`, or empty for the bus's own.
    pub(crate) fn prefixes(&self) -> Vec<String> {
        if self.0.is_empty() {
            return vec![String::new()];
        }
        self.0.iter().map(|name| format!("{name}/")).collect()
    }

    /// Splits a key into its prefix and the rest, which is relative to its cell.
    pub(crate) fn split<'k>(&self, key: &'k str) -> (&'k str, &'k str) {
        let named = || {
            let at = key.find('/')? + 1;
            let known = self.0.iter().any(|name| *name == key[..at - 1]);
            known.then(|| key.split_at(at))
        };
        named().unwrap_or(("", key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_distinguished_by_cell() {
        let own = Cells::default();
        assert_eq!(own.prefixes(), [""]);
        assert_eq!(own.split("arm/state"), ("", "arm/state"));
        let two = Cells::new(vec!["a".into(), "b".into()]);
        assert_eq!(two.prefixes(), ["a/", "b/"]);
        assert_eq!(two.split("b/arm/state"), ("b/", "arm/state"));
    }
}

//! A hash of a whole trajectory: equal for equal input, in debug and release builds and in every
//! run.

use sha2::{Digest, Sha256};

/// SHA-256 over the little-endian bits of all numbers added.
///
/// ```
/// use tangent_simulation::TrajectoryDigest;
///
/// let digest = |values: &[f64]| {
///     let mut digest = TrajectoryDigest::default();
///     digest.add(values);
///     digest.finish()
/// };
/// assert_eq!(digest(&[1.0, 2.0]), digest(&[1.0, 2.0]));
/// assert_ne!(digest(&[1.0, 2.0]), digest(&[2.0, 1.0]));
/// ```
#[derive(Clone, Default)]
pub struct TrajectoryDigest {
    hash: Sha256,
}

impl TrajectoryDigest {
    /// Adds numbers; their order matters.
    pub fn add(&mut self, values: &[f64]) {
        for value in values {
            self.hash.update(value.to_bits().to_le_bytes());
        }
    }

    /// Hash as 64 hexadecimal digits.
    pub fn finish(self) -> String {
        hexadecimal(self.hash)
    }
}

/// SHA-256 over texts, one line each.
#[derive(Clone, Default)]
pub(crate) struct TextDigest {
    hash: Sha256,
}

impl TextDigest {
    /// Adds a line; the order matters.
    pub fn add(&mut self, line: &str) {
        self.hash.update(line.as_bytes());
        self.hash.update(b"\n");
    }

    /// Hash as 64 hexadecimal digits.
    pub fn finish(self) -> String {
        hexadecimal(self.hash)
    }
}

fn hexadecimal(hash: Sha256) -> String {
    use std::fmt::Write;
    let mut text = String::with_capacity(64);
    for byte in hash.finalize() {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_sha_256_of_the_bits() {
        let empty = TrajectoryDigest::default().finish();
        assert!(empty.starts_with("e3b0c44298fc1c14"));
        let of = |values: &[f64]| {
            let mut digest = TrajectoryDigest::default();
            digest.add(values);
            digest.finish()
        };
        assert_eq!(of(&[1.0, 2.0]), of(&[1.0, 2.0]));
        assert_ne!(of(&[0.0]), of(&[-0.0]), "one bit is enough");
    }
}

//! The stored form of a memory: versioned, and checked when it is read.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::memory::{BINS_MAX, Memory, Stroke, VERSION};
use super::pass::CORRECTION_MAX;
use crate::task::path::Path;

/// Why a stored memory cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MemoryError {
    /// The memory is of another version of this program.
    #[error(
        "the learnt memory has version {found}, this program reads version {VERSION}; delete it, \
         and the next pass learns anew"
    )]
    Version {
        /// Version found.
        found: u32,
    },
    /// A value of it is not possible.
    #[error(
        "the learnt memory is damaged: stroke {stroke}, bin {bin}: `{key}` is {value}: allowed is \
         {allowed}; delete it, and the next pass learns anew"
    )]
    Value {
        /// Index of the stroke.
        stroke: usize,
        /// Index of the bin.
        bin: usize,
        /// Key.
        key: &'static str,
        /// Value found.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The path of the task is not that of the memory.
    #[error(
        "the learnt memory is of another path; give the part another name in `learning.part`, or \
         delete the memory"
    )]
    OtherPath,
}

/// A memory as read, before it is checked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    version: u32,
    passes: u32,
    strokes: Vec<Stroke>,
}

impl<'de> Deserialize<'de> for Memory {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::try_from(Stored::deserialize(from)?).map_err(D::Error::custom)
    }
}

impl TryFrom<Stored> for Memory {
    type Error = MemoryError;

    fn try_from(stored: Stored) -> Result<Self, MemoryError> {
        if stored.version != VERSION {
            return Err(MemoryError::Version {
                found: stored.version,
            });
        }
        let memory = Self {
            version: stored.version,
            passes: stored.passes,
            strokes: stored.strokes,
        };
        memory.check()?;
        Ok(memory)
    }
}

impl Memory {
    /// Checks that the memory is of `path`.
    ///
    /// # Errors
    /// The strokes differ in number or length.
    pub fn check_path(&self, path: &Path) -> Result<(), MemoryError> {
        let fits = self.strokes.len() == path.stroke_lengths_m().count()
            && (self.strokes.iter().zip(path.stroke_lengths_m()))
                .all(|(stroke, length_m)| (stroke.length_m - length_m).abs() < 1e-3);
        if fits {
            Ok(())
        } else {
            Err(MemoryError::OtherPath)
        }
    }

    fn check(&self) -> Result<(), MemoryError> {
        let mut bins = 0;
        for (stroke, s) in self.strokes.iter().enumerate() {
            let wrong = |bin, key, value: String, allowed| MemoryError::Value {
                stroke,
                bin,
                key,
                value,
                allowed,
            };
            let is_length = |x: f64| x.is_finite() && (0.0..=1e4).contains(&x);
            if !is_length(s.length_m) {
                return Err(wrong(0, "length_m", s.length_m.to_string(), "0 to 1e4 m"));
            }
            if !is_length(s.error_without_n) {
                let value = s.error_without_n.to_string();
                return Err(wrong(0, "error_without_n", value, "0 to 1e4 N"));
            }
            bins += s.bins.len();
            if s.bins.is_empty() || bins > 2 * BINS_MAX {
                return Err(wrong(
                    0,
                    "bins",
                    s.bins.len().to_string(),
                    "1 to 8192 in all",
                ));
            }
            for (i, bin) in s.bins.iter().enumerate() {
                if !(0.0..=1.0).contains(&bin.weight) {
                    return Err(wrong(i, "weight", bin.weight.to_string(), "0 to 1"));
                }
                if !(-CORRECTION_MAX..=CORRECTION_MAX).contains(&bin.correction) {
                    let value = bin.correction.to_string();
                    return Err(wrong(i, "correction", value, "-0.1 to 0.1"));
                }
                if !bin.position.iter().all(|x| x.abs() <= 1e3) {
                    let value = format!("{:?}", bin.position);
                    return Err(wrong(i, "position", value, "within 1 km"));
                }
                for (key, v) in [("tangent", &bin.tangent), ("normal", &bin.normal)] {
                    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
                    if bin.passes > 0 && !(0.999..=1.001).contains(&norm) {
                        return Err(wrong(i, key, format!("{v:?}"), "a unit vector"));
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::path::PathSpec;

    fn memory() -> Memory {
        let text = "kind = \"line\"\nto_m = [0.01, 0.0]\nspeed_m_per_s = 0.02";
        let spec: PathSpec = toml::from_str(text).unwrap();
        Memory::new(&Path::new(&spec, 0.1, 1.0).unwrap())
    }

    #[test]
    fn what_is_written_is_read() {
        let text = toml::to_string(&memory()).unwrap();
        assert_eq!(toml::from_str::<Memory>(&text).unwrap(), memory());
    }

    #[test]
    fn damage_is_refused_with_its_reason() {
        let text = toml::to_string(&memory()).unwrap();
        for (from, to, reason) in [
            ("version = 1", "version = 7", "version 7"),
            ("version = 1", "", "version"),
            ("weight = 0.0", "weight = 2.0", "`weight` is 2"),
            ("weight = 0.0", "weight = nan", "`weight` is NaN"),
            ("passes = 0\nweight", "passes = 1\nweight", "a unit vector"),
            (
                "correction = 0.0",
                "correction = 0.5",
                "`correction` is 0.5",
            ),
            ("length_m = ", "length_m = -", "`length_m` is -"),
            ("position = [0.0", "position = [inf", "`position`"),
            ("weight = 0.0", "wait = 0.0", "wait"),
        ] {
            let damaged = text.replacen(from, to, 1);
            assert_ne!(damaged, text, "{from}");
            let error = toml::from_str::<Memory>(&damaged).unwrap_err().to_string();
            assert!(error.contains(reason), "{reason}: {error}");
        }
        assert!(toml::from_str::<Memory>(&text[..text.len() / 2 + 3]).is_err());
    }

    #[test]
    fn another_path_is_refused() {
        let text = "kind = \"line\"\nto_m = [0.02, 0.0]\nspeed_m_per_s = 0.02";
        let spec: PathSpec = toml::from_str(text).unwrap();
        let longer = Path::new(&spec, 0.1, 1.0).unwrap();
        assert_eq!(memory().check_path(&longer), Err(MemoryError::OtherPath));
    }
}

//! Values of a running program. Copies are cheap, and sizes are bounded.

mod operators;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::error::ScriptError;
use crate::limits::{LIST_DEPTH_MAX, LIST_ITEMS_MAX, LIVE_ITEMS_MAX, TEXT_BYTES_MAX};

/// Elements of all lists alive in this process.
static LIVE_ITEMS: AtomicUsize = AtomicUsize::new(0);

/// Value of a variable.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// No value: an omitted argument, or the result of a function without `return`.
    None,
    /// True or False.
    Bool(bool),
    /// 32 bits, as on the controller.
    Integer(i32),
    /// 64 bits.
    Float(f64),
    /// A text.
    Text(Arc<str>),
    /// A list; copied when it is assigned.
    List(List),
    /// Position (m) and rotation vector (rad).
    Pose([f64; 6]),
}

/// Elements of a list, with its size.
#[derive(Clone, Debug, PartialEq)]
pub struct List {
    items: Arc<Items>,
    weight: usize,
    depth: u8,
}

/// Counts itself in [`LIVE_ITEMS`].
#[derive(Debug, PartialEq)]
struct Items(Box<[Value]>);

impl Items {
    fn new(items: Vec<Value>) -> Arc<Self> {
        LIVE_ITEMS.fetch_add(items.len(), Ordering::Relaxed);
        Arc::new(Self(items.into()))
    }
}

impl Drop for Items {
    fn drop(&mut self) {
        LIVE_ITEMS.fetch_sub(self.0.len(), Ordering::Relaxed);
    }
}

impl std::ops::Deref for Items {
    type Target = [Value];
    fn deref(&self) -> &[Value] {
        &self.0
    }
}

impl Value {
    pub(super) fn list(items: Vec<Value>) -> Result<Self, ScriptError> {
        let weight = items.iter().map(Value::weight).sum::<usize>();
        let depth = 1 + items.iter().map(Value::depth).max().unwrap_or(0);
        if weight > LIST_ITEMS_MAX || depth > LIST_DEPTH_MAX {
            return Err(ScriptError::ListTooLarge {
                elements: weight,
                depth,
            });
        }
        if LIVE_ITEMS.load(Ordering::Relaxed) > LIVE_ITEMS_MAX {
            return Err(ScriptError::OutOfListMemory);
        }
        Ok(Self::List(List {
            items: Items::new(items),
            weight,
            depth,
        }))
    }

    pub(super) fn text(text: String) -> Result<Self, ScriptError> {
        if text.len() > TEXT_BYTES_MAX {
            return Err(ScriptError::TextTooLong { bytes: text.len() });
        }
        Ok(Self::Text(text.into()))
    }

    pub(super) fn joints(q: &[f64; 6]) -> Self {
        let items: Vec<Value> = q.iter().map(|x| Self::Float(*x)).collect();
        Self::List(List {
            items: Items::new(items),
            weight: 6,
            depth: 1,
        })
    }

    /// Size as a measure of the cost of an operation.
    pub(super) fn weight(&self) -> usize {
        match self {
            Self::List(list) => 1 + list.weight,
            Self::Text(text) => 1 + text.len() / 16,
            _ => 1,
        }
    }

    fn depth(&self) -> u8 {
        match self {
            Self::List(list) => list.depth,
            _ => 0,
        }
    }

    /// The type's name, for messages.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::None => "nothing",
            Self::Bool(_) => "a bool",
            Self::Integer(_) => "an int",
            Self::Float(_) => "a float",
            Self::Text(_) => "a text",
            Self::List(_) => "a list",
            Self::Pose(_) => "a pose",
        }
    }

    fn is_not(&self, needed: &'static str) -> ScriptError {
        ScriptError::Kind {
            needed,
            found: self.kind(),
        }
    }

    /// Clients use numbers as conditions: all but 0 are true.
    pub(super) fn truth(&self) -> Result<bool, ScriptError> {
        match self {
            Self::Bool(b) => Ok(*b),
            Self::Integer(n) => Ok(*n != 0),
            Self::Float(x) => Ok(*x != 0.0),
            other => Err(other.is_not("a bool")),
        }
    }

    pub(super) fn float(&self) -> Result<f64, ScriptError> {
        match self {
            Self::Integer(n) => Ok(f64::from(*n)),
            Self::Float(x) => Ok(*x),
            other => Err(other.is_not("a number")),
        }
    }

    pub(super) fn integer(&self) -> Result<i32, ScriptError> {
        match self {
            Self::Integer(n) => Ok(*n),
            Self::Float(x) if x.is_finite() && x.abs() < 2e9 => Ok(*x as i32),
            Self::Bool(b) => Ok(i32::from(*b)),
            other => Err(other.is_not("an int")),
        }
    }

    /// Six numbers, of a list or of a pose.
    pub(super) fn six(&self) -> Result<[f64; 6], ScriptError> {
        match self {
            Self::Pose(p) => Ok(*p),
            Self::List(list) if list.items.len() == 6 => {
                let mut out = [0.0; 6];
                for (x, item) in out.iter_mut().zip(list.items.iter()) {
                    *x = item.float()?;
                }
                Ok(out)
            }
            Self::List(list) => Err(ScriptError::NotSix {
                count: list.items.len(),
            }),
            other => Err(ScriptError::NoSixNumbers {
                found: other.kind(),
            }),
        }
    }

    pub(super) fn numbers(&self) -> Result<Vec<f64>, ScriptError> {
        match self {
            Self::Pose(p) => Ok(p.to_vec()),
            Self::List(list) => list.items.iter().map(Value::float).collect(),
            other => Ok(vec![other.float()?]),
        }
    }

    fn is_matrix(&self) -> bool {
        self.rows().is_some_and(|rows| !rows.is_empty())
    }

    /// Elements of a list.
    pub(super) fn items(&self) -> Result<&[Value], ScriptError> {
        match self {
            Self::List(list) => Ok(&list.items),
            other => Err(other.is_not("a list")),
        }
    }

    /// Rows of a matrix: a list of lists of the same length.
    pub(super) fn rows(&self) -> Option<Vec<&[Value]>> {
        let rows: Vec<&[Value]> = self
            .items()
            .ok()?
            .iter()
            .map(|row| row.items().ok())
            .collect::<Option<_>>()?;
        rows.windows(2)
            .all(|pair| pair[0].len() == pair[1].len())
            .then_some(rows)
    }

    pub(super) fn length(&self) -> Result<i32, ScriptError> {
        match self {
            Self::Pose(_) => Ok(6),
            Self::List(list) => Ok(list.items.len() as i32),
            Self::Text(text) => Ok(text.len() as i32),
            other => Err(ScriptError::NoLength { kind: other.kind() }),
        }
    }

    pub(super) fn element(&self, index: &Value) -> Result<Value, ScriptError> {
        let n = index.integer()?;
        let found = match self {
            Self::List(list) => usize::try_from(n)
                .ok()
                .and_then(|n| list.items.get(n).cloned()),
            Self::Pose(p) => usize::try_from(n)
                .ok()
                .and_then(|n| p.get(n))
                .map(|x| Self::Float(*x)),
            other => return Err(ScriptError::NoElements { kind: other.kind() }),
        };
        found.ok_or(ScriptError::IndexOutOfRange { index: n })
    }

    pub(super) fn with_element(
        &self,
        indices: &[Value],
        value: Value,
    ) -> Result<Value, ScriptError> {
        let Some((first, rest)) = indices.split_first() else {
            return Ok(value);
        };
        let index = first.integer()?;
        let n = usize::try_from(index).unwrap_or(usize::MAX);
        match self {
            Self::List(list) => {
                let mut items = list.items.to_vec();
                let Some(item) = items.get_mut(n) else {
                    return Err(ScriptError::IndexOutOfRange { index });
                };
                *item = item.with_element(rest, value)?;
                Self::list(items)
            }
            Self::Pose(p) => {
                let mut p = *p;
                match p.get_mut(n) {
                    Some(x) if rest.is_empty() => *x = value.float()?,
                    _ => return Err(ScriptError::IndexOutOfRange { index }),
                }
                Ok(Self::Pose(p))
            }
            other => Err(ScriptError::NoElements { kind: other.kind() }),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("None"),
            Self::Bool(true) => f.write_str("True"),
            Self::Bool(false) => f.write_str("False"),
            Self::Integer(n) => write!(f, "{n}"),
            Self::Float(x) => write!(f, "{x}"),
            Self::Text(text) => f.write_str(text),
            Self::Pose(p) => write!(
                f,
                "p[{}, {}, {}, {}, {}, {}]",
                p[0], p[1], p[2], p[3], p[4], p[5]
            ),
            Self::List(list) => {
                f.write_str("[")?;
                for (i, item) in list.items.iter().enumerate() {
                    let comma = if i > 0 { ", " } else { "" };
                    write!(f, "{comma}{item}")?;
                }
                f.write_str("]")
            }
        }
    }
}

//! Golden comparison.

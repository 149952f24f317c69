//! x
pub mod fci;

//! The three systems, one per paper: cell, scenario, closed loop and the paper's tables.

pub mod admittance;
pub mod object;
pub mod visuo_tactile;

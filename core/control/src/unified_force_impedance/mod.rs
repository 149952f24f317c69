//! `unified_force_impedance`
mod interface;
pub use interface::{JOINTS, TankBooks, UnifiedInput, UnifiedOutput, VisualNormal};

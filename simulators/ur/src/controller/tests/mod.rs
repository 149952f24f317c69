mod bridge_program;
mod compliance;
mod modes;
mod programs;

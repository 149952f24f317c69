mod bridge_program;
mod modes;
mod programs;

mod bridge_program;
mod compliance;
mod functions;
mod modes;
mod programs;

//! Control laws, phases, tasks and paths, limits and guards.

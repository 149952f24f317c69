//! Bounds on the memory and depth of a running program.

/// Instructions that all threads together may take in one frame. A real controller has a time slice
/// instead.
pub const INSTRUCTIONS_PER_FRAME: u32 = 50_000;
/// Most threads at once, the main program included.
pub const THREADS_MAX: usize = 16;
/// Deepest call of a function in a function.
pub const CALLS_MAX: usize = 60;
/// Most values that a thread's expressions and calls hold at once.
pub const STACK_MAX: usize = 2_000;
/// Elements of all lists alive in this process: about 100 MB.
pub const LIVE_ITEMS_MAX: usize = 4_000_000;
/// Most elements in a list, those of lists inside counted.
pub const LIST_ITEMS_MAX: usize = 10_000;
/// Deepest list in a list.
pub const LIST_DEPTH_MAX: u8 = 4;
/// Longest text, bytes.
pub const TEXT_BYTES_MAX: usize = 1024;

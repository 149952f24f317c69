//! The `tangent` command.

fn main() {}

//! Controller service: one step of the law per robot packet.

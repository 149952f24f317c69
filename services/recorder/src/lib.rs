//! Recorder service: every topic of the cell to MCAP, and reading recordings back.

//! How the services of a private cell are spread over processes.

/// Distribution of the services over processes, and the surface on which the tool slides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layout {
    /// The hard loop in one process, as recommended.
    Composed,
    /// Bridge and controller in separate processes.
    Apart,
    /// As composed, with each process on a host whose clock can be set: its messages pass through
    /// this process.
    Relayed,
    /// Composed, with a surface that has an edge.
    Ledge,
}

impl Layout {
    /// Processes, each given by the services that it runs, in the order in which they are started.
    pub fn processes(self) -> &'static [&'static str] {
        match self {
            Self::Composed | Self::Relayed | Self::Ledge => &[
                "router",
                "recorder",
                "netft",
                "rtde controller",
                "estimator",
            ],
            Self::Apart => &[
                "router",
                "recorder",
                "netft",
                "rtde",
                "controller",
                "estimator",
            ],
        }
    }

    /// Name of the hard loop's process, or of the bridge's.
    pub fn bridge(self) -> &'static str {
        match self {
            Self::Composed | Self::Relayed | Self::Ledge => "rtde controller",
            Self::Apart => "rtde",
        }
    }
}

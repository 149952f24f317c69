//! One function per decoder of bytes or text from outside the program: each takes arbitrary bytes,
//! and panics if a property of the decoder does not hold.
//!
//! The fuzz targets in `fuzz/fuzz_targets` and the test that replays the stored corpus call these
//! functions. A function that returns has found no failure: refusing an input with an error is as
//! correct as accepting it.

mod cell;
mod depth;
mod fci;
mod messages;
mod netft;
mod recording;
mod rtde;
mod script;

pub use cell::{cell_file, model_file, scenario_file, task_file};
pub use depth::depth_image;
pub use fci::{fci_datagrams, fci_stream};
pub use messages::cdr;
pub use netft::{box_xml, rdt_records};
pub use recording::recording;
pub use rtde::{dashboard_lines, primary_stream, rtde_bridge, rtde_packages};
pub use script::urscript;

/// A fuzz target: its name, which is also the folder of its corpus, and its entry function.
#[derive(Clone, Copy)]
pub struct Target {
    /// Name of the target and of its folder in `fuzz/corpus`.
    pub name: &'static str,
    /// The entry function.
    pub run: fn(&[u8]),
}

/// All targets except [`DEPTH_TARGET`].
pub const TARGETS: [Target; 15] = [
    Target {
        name: "rtde_packages",
        run: rtde_packages,
    },
    Target {
        name: "rtde_bridge",
        run: rtde_bridge,
    },
    Target {
        name: "dashboard_lines",
        run: dashboard_lines,
    },
    Target {
        name: "primary_stream",
        run: primary_stream,
    },
    Target {
        name: "rdt_records",
        run: rdt_records,
    },
    Target {
        name: "box_xml",
        run: box_xml,
    },
    Target {
        name: "fci_stream",
        run: fci_stream,
    },
    Target {
        name: "fci_datagrams",
        run: fci_datagrams,
    },
    Target {
        name: "cdr",
        run: cdr,
    },
    Target {
        name: "recording",
        run: recording,
    },
    Target {
        name: "cell_file",
        run: cell_file,
    },
    Target {
        name: "task_file",
        run: task_file,
    },
    Target {
        name: "scenario_file",
        run: scenario_file,
    },
    Target {
        name: "model_file",
        run: model_file,
    },
    Target {
        name: "urscript",
        run: urscript,
    },
];

/// The target of depth images. It is separate from [`TARGETS`], because one frame takes a thousand
/// times as long as a package.
pub const DEPTH_TARGET: Target = Target {
    name: "depth_image",
    run: depth_image,
};

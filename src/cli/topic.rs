//! `tangent topic`.

use clap::{Args, Subcommand};

use super::seconds::{measuring_time, waiting_time};

/// What to do with topics.
#[derive(Debug, Subcommand)]
pub enum TopicCommand {
    /// List the topics on which something is published, with type, publishers and rate.
    List {
        /// Seconds for which to observe the bus.
        #[arg(long, default_value_t = 2.0, value_parser = measuring_time)]
        seconds: f64,
    },
    /// Print the messages of a topic, until Ctrl-C.
    Echo(Echo),
    /// Measure the rate of a topic: intervals, losses, sizes.
    Hz(Hz),
}

/// Options of `tangent topic echo`.
#[derive(Debug, Args)]
pub struct Echo {
    /// Topic, as in `tangent topic list`; may contain `*`.
    pub topic: String,
    /// Stop after this many messages.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// Print only these fields, with a dot between levels, such as `header.stamp`; separated by
    /// commas.
    #[arg(long, value_name = "FIELDS", value_delimiter = ',')]
    pub fields: Vec<String>,
    /// Print lists in full; otherwise, they are cut after 16 elements.
    #[arg(long)]
    pub full: bool,
    /// Seconds to wait for the first message.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = waiting_time)]
    pub wait_s: f64,
}

/// Options of `tangent topic hz`.
#[derive(Debug, Args)]
pub struct Hz {
    /// Topic, as in `tangent topic list`.
    pub topic: String,
    /// Length of the measurement, s.
    #[arg(long, default_value_t = 5.0, value_parser = measuring_time)]
    pub seconds: f64,
}

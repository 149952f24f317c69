//! `tangent ui`.

use std::net::SocketAddr;

use clap::{Args, ValueEnum};

/// Options of `tangent ui`.
#[derive(Debug, Args)]
pub struct Ui {
    /// Address and port at which browsers connect, in place of ui.address in the cell file.
    #[arg(long, value_name = "ADDRESS")]
    pub address: Option<SocketAddr>,
    /// Open the page in this desktop's browser.
    #[arg(long)]
    pub open: bool,
    /// Give this person a token, and end: print the token, and add its digest to the file that
    /// ui.tokens names.
    #[arg(long, value_name = "NAME")]
    pub new_token: Option<String>,
    /// What the person may do.
    #[arg(long, value_enum, default_value = "operator", requires = "new_token")]
    pub role: UiRole,
}

/// Roles of people.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum UiRole {
    /// Tasks, stop and tare.
    Operator,
    /// The choice of the estimator too.
    Engineer,
}

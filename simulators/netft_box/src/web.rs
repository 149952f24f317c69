//! The box's web server: identification and calibration, and the settings of rate and buffer size.

use std::collections::HashMap;
use std::net::TcpListener;
use std::sync::Arc;
use std::thread::JoinHandle;

use axum::Router;
use axum::extract::{Query, State};
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use tokio::sync::oneshot;

use crate::rdt::RdtBox;
use crate::{Shared, lock};

pub(crate) struct WebServer {
    stop: oneshot::Sender<()>,
    thread: JoinHandle<()>,
}

impl WebServer {
    pub(crate) fn start(listener: TcpListener, shared: Arc<Shared>) -> std::io::Result<Self> {
        listener.set_nonblocking(true)?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("netb-http")
            .enable_all()
            .build()?;
        let router = Router::new()
            .route("/", get(index))
            .route("/netftapi2.xml", get(describe))
            .route("/comm.cgi", get(configure))
            .with_state(shared);
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = std::thread::Builder::new()
            .name("netb-web".into())
            .spawn(move || {
                let served = runtime.block_on(async {
                    let listener = tokio::net::TcpListener::from_std(listener)?;
                    tokio::select! {
                        served = axum::serve(listener, router) => served,
                        _ = stopped => Ok(()),
                    }
                });
                if let Err(error) = served {
                    tracing::error!("the web server of the simulated box ended: {error}");
                }
                // Connections that a client keeps open must not keep the box alive.
                runtime.shutdown_background();
            })?;
        Ok(Self { stop, thread })
    }

    pub(crate) fn stop(self) {
        let _ = self.stop.send(());
        if self.thread.join().is_err() {
            tracing::error!("the web server of the simulated box panicked");
        }
    }
}

async fn index() -> impl IntoResponse {
    (
        [(header::CONTENT_TYPE, "text/html")],
        "<html><title>Net F/T (simulated)</title><a href=\"/netftapi2.xml\">configuration</a></html>",
    )
}

async fn describe(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let settings = *lock(&shared.settings);
    let config = &shared.config;
    // The supported rate that is nearest to the requested one.
    let rate = (7000.0 / f64::from(RdtBox::step(settings.rate_hz))).round();
    let fields = [
        ("prodname", "Net F/T (simulated)".to_owned()),
        ("setserial", config.serial.clone()),
        ("runstat", "0".to_owned()),
        ("setuserfilter", config.filter.to_string()),
        ("cfgcpf", config.counts_per_force.to_string()),
        ("cfgcpt", config.counts_per_torque.to_string()),
        ("scfgfu", config.force_unit.clone()),
        ("scfgtu", config.torque_unit.clone()),
        ("cfgtfx", "0".to_owned()),
        ("cfgtfy", "0".to_owned()),
        ("cfgtfz", "0".to_owned()),
        ("comrdte", "Enabled".to_owned()),
        ("comrdtrate", rate.to_string()),
        ("comrdtbsiz", settings.buffer_records.to_string()),
    ];
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<netft>\n");
    for (tag, text) in fields {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        xml.push_str(&format!("<{tag}>{text}</{tag}>\n"));
    }
    xml.push_str("</netft>\n");
    ([(header::CONTENT_TYPE, "text/xml")], xml)
}

/// `/comm.cgi?comrdtrate=7000&comrdtbsiz=7`; unknown parameters are ignored, as by a real box.
async fn configure(
    State(shared): State<Arc<Shared>>,
    Query(values): Query<HashMap<String, String>>,
) -> impl IntoResponse {
    let number = |key: &str, max: u32| match values.get(key).map(|text| text.parse::<u32>()) {
        None => Ok(None),
        Some(Ok(value)) if (1..=max).contains(&value) => Ok(Some(value)),
        Some(_) => Err((
            StatusCode::BAD_REQUEST,
            format!("{key} must be a whole number from 1 to {max}"),
        )),
    };
    let (rate, records) = match (number("comrdtrate", 7000), number("comrdtbsiz", 40)) {
        (Ok(rate), Ok(records)) => (rate, records),
        (Err(refusal), _) | (_, Err(refusal)) => return refusal,
    };
    let mut settings = lock(&shared.settings);
    settings.rate_hz = rate.unwrap_or(settings.rate_hz);
    settings.buffer_records = records.unwrap_or(settings.buffer_records);
    (StatusCode::OK, "done".to_owned())
}

//! The HTTP side: files of the page, the stream of snapshots, the dose map, and commands.
//!
//! Every request passes [`guard`] first.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use axum::body::{Body, Bytes};
use axum::extract::{ConnectInfo, DefaultBodyLimit, Path, Query, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router};
use futures_util::stream;
use serde::Deserialize;
use serde_json::{Value, json};
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::clock;
use tangent_runtime::config::OnLostPage;
use tokio::sync::{OwnedSemaphorePermit, watch};

use crate::access::{Role, is_own_host, is_own_origin};
use crate::commands::{Command, Who};
use crate::config::Config;
use crate::connection::{Bounded, Peer};
use crate::shared::Shared;
use crate::teacher::{TaskWish, TeachStep};
use crate::tools::CalibrationStep;
use crate::{export, lock, page, recordings, tasks, teach};
use tangent_scene::dose::{DoseMap, Judgement};

/// Largest body of a request, bytes.
const BODY_MAX: usize = 4096;
/// What the page may load and do: only what this host serves.
const POLICY: &str = "default-src 'self'; img-src 'self' blob: data:; style-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// What a report may do: nothing in the name of this page.
const REPORT_POLICY: &str = "sandbox allow-scripts allow-popups; default-src 'none'; \
    style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";

/// Serves until the future is dropped.
pub async fn serve(listener: tokio::net::TcpListener, shared: Arc<Shared>) -> std::io::Result<()> {
    let router = router(shared);
    let service = router.into_make_service_with_connect_info::<Peer>();
    axum::serve(Bounded::new(listener), service).await
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/api/about", get(about))
        .route("/api/stream", get(snapshots))
        .route("/api/here", post(here))
        .route("/api/command", post(command))
        .route("/api/dose", get(dose))
        .route("/api/dose.csv", get(dose_csv))
        .route("/api/dose.ply", get(dose_ply))
        .route("/api/recordings", get(list_recordings))
        .route("/api/report", post(report))
        .route("/api/calibrate", post(calibrate))
        .route("/api/tasks", get(list_tasks))
        .route("/api/teach", get(taught).post(teach_step))
        .route("/recordings/{file}", get(recording))
        .fallback(get(page_file))
        .layer(DefaultBodyLimit::max(BODY_MAX))
        .layer(from_fn_with_state(Arc::clone(&shared), guard))
        .with_state(shared)
}

/// Why a request is refused.
fn refuse(status: StatusCode, why: &str) -> Response {
    let body = json!({ "done": false, "message": why }).to_string();
    (status, [(header::CONTENT_TYPE, "application/json")], body).into_response()
}

fn text(headers: &HeaderMap, name: impl header::AsHeaderName) -> Option<&str> {
    headers.get(name).map(|value| value.to_str().unwrap_or(""))
}

/// Keeps other sites out, and finds out who sends the request.
async fn guard(
    State(shared): State<Arc<Shared>>,
    ConnectInfo(Peer(peer)): ConnectInfo<Peer>,
    mut request: Request,
    next: Next,
) -> Response {
    match admit(&shared.config, peer, &request) {
        Ok(who) => request.extensions_mut().insert(who),
        Err((status, why)) => return refuse(status, &why),
    };
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let set = |headers: &mut HeaderMap, name, value| {
        headers
            .entry(name)
            .or_insert(HeaderValue::from_static(value));
    };
    set(headers, header::CONTENT_SECURITY_POLICY, POLICY);
    set(headers, header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(headers, header::REFERRER_POLICY, "no-referrer");
    set(headers, header::CACHE_CONTROL, "no-store");
    response
}

/// Who sends a request that may be answered; or the status and the reason of the refusal.
fn admit(
    config: &Config,
    peer: SocketAddr,
    request: &Request,
) -> Result<Who, (StatusCode, String)> {
    let headers = request.headers();
    let host = text(headers, header::HOST).unwrap_or("");
    if !is_own_host(host, &config.hosts) {
        return Err((
            StatusCode::MISDIRECTED_REQUEST,
            format!(
                "host \"{host}\" is not one of this page's: use an IP address or localhost, or add the name to ui.hosts \
                 in the cell file"
            ),
        ));
    }
    let path = request.uri().path();
    let is_data = path.starts_with("/api/") || path.starts_with("/recordings/");
    let origin = text(headers, header::ORIGIN);
    let site = text(headers, "sec-fetch-site").unwrap_or("none");
    if !is_own_origin(origin, host) || (is_data && !matches!(site, "none" | "same-origin")) {
        return Err((
            StatusCode::FORBIDDEN,
            "requests of other sites are refused".to_owned(),
        ));
    }
    if request.method() == Method::POST {
        let kind = text(headers, header::CONTENT_TYPE).unwrap_or("");
        if kind.split(';').next().unwrap_or("").trim() != "application/json" {
            return Err((
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "the content type is not application/json".to_owned(),
            ));
        }
    }
    let address = peer.ip().to_canonical();
    let who = |name: &str, role| Who {
        name: name.to_owned(),
        role,
        address: address.to_string(),
    };
    let token =
        text(headers, header::AUTHORIZATION).map(|t| t.trim_start_matches("Bearer ").trim());
    match token {
        Some(token) => match config.tokens.holder(token) {
            Some(person) => Ok(who(&person.name, Some(person.role))),
            None => Err((
                StatusCode::UNAUTHORIZED,
                "this token is not known: it may be of an earlier run, or its entry was removed"
                    .to_owned(),
            )),
        },
        None if is_data && !address.is_loopback() => Err((
            StatusCode::UNAUTHORIZED,
            "from another host, a token is needed to read, too".to_owned(),
        )),
        None => Ok(who("anyone", None)),
    }
}

async fn page_file(request: Request) -> Response {
    match page::file(request.uri().path()) {
        Some((kind, content)) => ([(header::CONTENT_TYPE, kind)], content).into_response(),
        None => refuse(StatusCode::NOT_FOUND, "there is no such page"),
    }
}

fn answer(value: &Value) -> Response {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, value.to_string()).into_response()
}

async fn about(State(shared): State<Arc<Shared>>, Extension(who): Extension<Who>) -> Response {
    let config = &shared.config;
    let on_lost_page = match config.on_lost_page {
        OnLostPage::Nothing => "nothing",
        OnLostPage::Pause => "pause",
        OnLostPage::Stop => "stop",
    };
    let folder = config.tasks.clone();
    let listed = waiting(move || tasks::list(&folder)).await;
    answer(&json!({
        "cell": config.cell,
        "version": env!("CARGO_PKG_VERSION"),
        "tasks": listed.unwrap_or_default(),
        "estimators": config.scene.estimators,
        "force_max_n": config.force_max_n,
        "tip_radius_mm": config.scene.mounted.tip.radius_m().map(|r| r * 1e3),
        "on_lost_page": on_lost_page,
        "lost_page_after_s": config.lost_page_after.as_secs_f64(),
        "has_tokens": !config.tokens.is_empty(),
        "can_report": shared.tools.report.is_some(),
        "can_calibrate": shared.tools.calibrate.is_some(),
        "can_teach": shared.tools.teach.is_some(),
        "you": { "name": who.name, "role": who.role },
    }))
}

async fn list_tasks(State(shared): State<Arc<Shared>>) -> Response {
    let folder = shared.config.tasks.clone();
    let listed = waiting(move || tasks::list(&folder)).await;
    answer(&json!({ "tasks": listed.unwrap_or_default() }))
}

/// Runs what may wait in a thread of its own; `None` if it panicked.
async fn waiting<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    tokio::task::spawn_blocking(work).await.ok()
}

/// The newest snapshot, again and again. A slow browser misses those in between.
async fn snapshots(State(shared): State<Arc<Shared>>) -> Response {
    let Ok(place) = Arc::clone(&shared.streams).try_acquire_owned() else {
        return refuse(
            StatusCode::SERVICE_UNAVAILABLE,
            "too many pages are open: close one, and load this one again",
        );
    };
    type Following = (watch::Receiver<Bytes>, OwnedSemaphorePermit);
    let start: Following = (shared.snapshots.subscribe(), place);
    let frames = stream::unfold(start, |(mut newest, place)| async {
        newest.changed().await.ok()?;
        let frame = newest.borrow_and_update().clone();
        Some((Ok::<_, std::convert::Infallible>(frame), (newest, place)))
    });
    let kind = [(header::CONTENT_TYPE, "text/event-stream")];
    (kind, Body::from_stream(frames)).into_response()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Here {
    page: String,
}

/// The sign of life of a page that receives the stream.
async fn here(
    State(shared): State<Arc<Shared>>,
    Extension(who): Extension<Who>,
    body: Bytes,
) -> Response {
    match serde_json::from_slice::<Here>(&body) {
        Ok(here) if here.page.len() <= 64 => {
            lock(&shared.pages).here(&here.page, who.role.is_some(), Instant::now());
            StatusCode::NO_CONTENT.into_response()
        }
        _ => refuse(StatusCode::BAD_REQUEST, "not {\"page\": NAME}"),
    }
}

async fn command(
    State(shared): State<Arc<Shared>>,
    Extension(who): Extension<Who>,
    body: Bytes,
) -> Response {
    let command: Command = match serde_json::from_slice(&body) {
        Ok(command) => command,
        Err(error) => {
            let why = format!("not a command: {error}");
            return refuse(StatusCode::BAD_REQUEST, &why);
        }
    };
    if let Some(needed) = command.role()
        && who.role.is_none()
    {
        let why = format!(
            "{} needs a token with the role {needed}: open the page with the address that `tangent ui` prints, or enter \
             your token",
            command.action()
        );
        return refuse(StatusCode::UNAUTHORIZED, &why);
    }
    let lane = match command {
        Command::Stop => &shared.stops,
        _ => &shared.commands,
    };
    let Ok(_place) = lane.try_acquire() else {
        let why = "too many commands wait for the cell: nothing was done";
        return refuse(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    let carrying = Arc::clone(&shared);
    match waiting(move || carrying.command(&who, &command)).await {
        Some(value) => answer(&value),
        None => refuse(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the outcome is unknown: look at the phase",
        ),
    }
}

#[derive(Deserialize)]
struct Since {
    #[serde(default)]
    epoch: u64,
    #[serde(default)]
    revision: u64,
}

async fn dose(State(shared): State<Arc<Shared>>, Query(since): Query<Since>) -> Response {
    let map = lock(&shared.dose);
    let judged = map.judge(shared.dose_band());
    answer(&export::json(&map, &judged, since.epoch, since.revision))
}

async fn dose_csv(State(shared): State<Arc<Shared>>) -> Response {
    exported(&shared, "csv", "text/csv", export::csv)
}

async fn dose_ply(State(shared): State<Arc<Shared>>) -> Response {
    exported(&shared, "ply", "application/octet-stream", export::ply)
}

fn exported(
    shared: &Shared,
    ending: &str,
    kind: &'static str,
    write: impl Fn(&DoseMap, &Judgement) -> String,
) -> Response {
    let map = lock(&shared.dose);
    let text = write(&map, &map.judge(shared.dose_band()));
    drop(map);
    let name = format!(
        "attachment; filename=\"dose-{}.{ending}\"",
        shared.config.cell
    );
    let headers = [
        (header::CONTENT_TYPE, kind.to_owned()),
        (header::CONTENT_DISPOSITION, name),
    ];
    (headers, text).into_response()
}

async fn list_recordings(State(shared): State<Arc<Shared>>) -> Response {
    let folder = shared.config.recordings.clone();
    let listed = waiting(move || recordings::list(&folder)).await;
    answer(&json!({ "recordings": listed.unwrap_or_default() }))
}

/// A report. Recordings themselves are too large for a browser.
async fn recording(State(shared): State<Arc<Shared>>, Path(file): Path<String>) -> Response {
    let folder = shared.config.recordings.clone();
    let read = waiting(move || {
        let path = recordings::path(&folder, &file).filter(|_| file.ends_with(".html"))?;
        std::fs::read(path).ok()
    });
    match read.await.flatten() {
        Some(content) => {
            let headers = [
                (header::CONTENT_TYPE, "text/html; charset=utf-8"),
                (header::CONTENT_SECURITY_POLICY, REPORT_POLICY),
            ];
            (headers, content).into_response()
        }
        None => refuse(StatusCode::NOT_FOUND, "there is no such report"),
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StepOf {
    step: CalibrationStep,
}

/// Carries out a step of the payload's calibration.
async fn calibrate(
    State(shared): State<Arc<Shared>>,
    Extension(who): Extension<Who>,
    body: Bytes,
) -> Response {
    let Ok(StepOf { step }) = serde_json::from_slice(&body) else {
        let why = "not {\"step\": \"begin\"} or {\"step\": \"pose\"}";
        return refuse(StatusCode::BAD_REQUEST, why);
    };
    if !who.may(Role::Engineer) {
        let why = "a calibration needs the role engineer";
        return refuse(StatusCode::UNAUTHORIZED, why);
    }
    let Some(calibrator) = shared.tools.calibrate.clone() else {
        let why = "this page does not calibrate: use `tangent calibrate payload`";
        return refuse(StatusCode::NOT_FOUND, why);
    };
    let Ok(_place) = shared.calibrations.try_acquire() else {
        let why = "another pose is being taken: try again in a moment";
        return refuse(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    let began = (clock::now_ns(), Instant::now());
    let Some(state) = waiting(move || calibrator(step)).await else {
        return refuse(StatusCode::INTERNAL_SERVER_ERROR, "the calibration failed");
    };
    let outcome = if state.done {
        done(&state.message)
    } else {
        refused(state.message.clone())
    };
    let asked = ("calibrate", step.name());
    shared.desk.record(&who, asked, &outcome, began);
    answer(&json!(state))
}

/// What a person who teaches wants.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
enum Lesson {
    Step(TeachStep),
    Save(TaskWish),
}

/// Carries out a step of teaching by hand, or writes the task.
async fn teach_step(
    State(shared): State<Arc<Shared>>,
    Extension(who): Extension<Who>,
    body: Bytes,
) -> Response {
    let wanted = match serde_json::from_slice::<Lesson>(&body) {
        Ok(wanted) => wanted,
        Err(error) => {
            let why = format!("not {{\"step\": STEP}} or {{\"save\": TASK}}: {error}");
            return refuse(StatusCode::BAD_REQUEST, &why);
        }
    };
    if !who.may(Role::Engineer) {
        return refuse(StatusCode::UNAUTHORIZED, "teaching needs the role engineer");
    }
    let Some(teacher) = shared.tools.teach.clone() else {
        let why = "this page does not teach: use `tangent teach`";
        return refuse(StatusCode::NOT_FOUND, why);
    };
    // A sign of life does not wait for a step.
    let lane = match wanted {
        Lesson::Step(TeachStep::Keep) => &shared.signs,
        _ => &shared.lessons,
    };
    let Ok(_place) = lane.try_acquire() else {
        let why = "another step is being carried out: try again in a moment";
        return refuse(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    let working = Arc::clone(&shared);
    let carried_out = waiting(move || match wanted {
        Lesson::Step(step) => teach::step(&working, &teacher, &who, step),
        Lesson::Save(wish) => teach::save(&working, &teacher, &who, &wish),
    });
    match carried_out.await {
        Some(value) => answer(&value),
        None => refuse(StatusCode::INTERNAL_SERVER_ERROR, "teaching failed"),
    }
}

/// What is being taught, in space.
async fn taught(State(shared): State<Arc<Shared>>) -> Response {
    let Some(teacher) = shared.tools.teach.clone() else {
        return answer(&json!({ "revision": 0, "marks": [] }));
    };
    let reading = Arc::clone(&shared);
    match waiting(move || teach::marks(&reading, &teacher)).await {
        Some(value) => answer(&value),
        None => refuse(StatusCode::INTERNAL_SERVER_ERROR, "teaching failed"),
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReportOf {
    recording: String,
}

/// Writes the report of a recording.
async fn report(
    State(shared): State<Arc<Shared>>,
    Extension(who): Extension<Who>,
    body: Bytes,
) -> Response {
    let Ok(wanted) = serde_json::from_slice::<ReportOf>(&body) else {
        return refuse(StatusCode::BAD_REQUEST, "not {\"recording\": FILE}");
    };
    if who.role.is_none() {
        return refuse(StatusCode::UNAUTHORIZED, "a report needs a token");
    }
    let path = recordings::path(&shared.config.recordings, &wanted.recording)
        .filter(|_| wanted.recording.ends_with(".mcap"));
    let (Some(path), Some(reporter)) = (path, shared.tools.report.clone()) else {
        return refuse(StatusCode::NOT_FOUND, "there is no such recording");
    };
    let Ok(_place) = shared.reports.try_acquire() else {
        let why = "another report is being written: try again in a moment";
        return refuse(StatusCode::SERVICE_UNAVAILABLE, why);
    };
    match waiting(move || reporter(&path)).await {
        Some(Ok(page)) => {
            let name = page.file_name().unwrap_or_default().to_string_lossy();
            answer(&json!({ "done": true, "message": "", "report": name }))
        }
        Some(Err(why)) => answer(&json!({ "done": false, "message": why })),
        None => refuse(StatusCode::INTERNAL_SERVER_ERROR, "the report failed"),
    }
}

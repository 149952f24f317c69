// The operator's page: what it shows, and what its buttons do.

import { follow, get, hasToken, post, setToken } from "./link.js";
import { ForcePlot } from "./plot.js";
import { Teaching } from "./teach.js";
import { load, say } from "./texts.js";

const OLD_MS = 1000;
const WORDS_MS = 200;
const STOP_TRIES_MS = 6000;
const LEVELS = { good: "", warn: "warn", bad: "bad" };

const $ = (id) => document.getElementById(id);
const number = (value, digits, unit) => (value == null ? "–" : `${value.toFixed(digits)} ${unit}`);

let about = null;
let plot = null;
let scene = null;
let teaching = null;
let newest = null;
let newest_at = -Infinity;
let worded_at = -Infinity;
let refused = "";
let last_command = null;
let dose = { epoch: 0, revision: 0, asking: false, at: 0 };

await load();
await begin();

async function begin() {
  $("stop").addEventListener("click", stop);
  $("start").addEventListener("click", () => command({ action: "start", task: $("tasks").value }));
  for (const action of ["pause", "resume", "tare"]) {
    $(action).addEventListener("click", () => command({ action }));
  }
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && newest?.task?.active) stop();
  });
  $("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    setToken($("token").value);
    $("token").value = "";
    location.reload();
  });
  $("view-arm").addEventListener("click", () => scene?.view_arm());
  $("view-surface").addEventListener("click", () => scene?.view_surface());
  for (const ending of ["csv", "ply"]) {
    $(`dose-${ending}`).addEventListener("click", () => save(`/api/dose.${ending}`, `dose.${ending}`));
  }
  for (const step of ["begin", "pose"]) {
    $(`calibration-${step}`).addEventListener("click", () => calibrate(step));
  }
  $("list-recordings").addEventListener("click", list_recordings);
  setInterval(watch_age, 250);
  watch_age();
  await learn();
  follow(take, (why) => { refused = why; });
}

// What does not change while the service runs.
async function learn() {
  for (;;) {
    try {
      const answer = await get("/api/about");
      const read = await answer.json();
      if (answer.ok) {
        about = read;
        break;
      }
      refused = read.message;
      $("sign-in").open = true;
    } catch {
      refused = "";
    }
    await new Promise((again) => setTimeout(again, 1000));
  }
  refused = "";
  $("cell").textContent = about.cell;
  document.title = `${about.cell} – tangent`;
  $("version").textContent = `tangent ${about.version}`;
  const { name, role } = about.you;
  $("you").textContent = role ? say("you", { name, role: say(`role.${role}`) }) : say("you.nobody");
  $("sign-in").open = !role && about.has_tokens;
  list_tasks(about.tasks);
  $("force-limit").textContent = number(about.force_max_n, 0, "N");
  $("dose-note").textContent = about.tip_radius_mm
    ? say("dose.note", { radius: about.tip_radius_mm })
    : say("dose.note.unknown");
  plot = new ForcePlot($("plot"), about.force_max_n);
  try {
    const { ArmScene } = await import("./scene.js");
    scene = new ArmScene($("scene"));
  } catch (error) {
    console.warn(error);
    $("scene").hidden = true;
    $("no-scene").hidden = false;
  }
  if (about.can_teach && role === "engineer") {
    const show = (marks) => scene?.taught(marks);
    teaching = new Teaching(name, { saved: read_tasks, show });
  }
  $("calibration-panel").hidden = !(about.can_calibrate && role === "engineer");
  list_recordings();
}

function list_tasks(tasks) {
  about.tasks = tasks;
  const options = tasks.map((task) => {
    const text = say("task.file", { file: task.file, name: task.name, force: task.force_n });
    return new Option(text, task.file);
  });
  if (!options.length) options.push(new Option(say("task.none"), ""));
  $("tasks").replaceChildren(...options);
}

// Lists the tasks again, and chooses one of them.
async function read_tasks(file) {
  try {
    const { tasks } = await (await get("/api/tasks")).json();
    list_tasks(tasks);
    $("tasks").value = file;
  } catch {
    // The banner says that there is no connection.
  }
}

function take(snapshot) {
  refused = "";
  newest = snapshot;
  newest_at = performance.now();
  show_task(snapshot);
  show_force(snapshot);
  scene?.show(snapshot.space);
  ask_dose(snapshot.dose);
  teaching?.take(snapshot.teach);
  // Words need not change more often than they can be read. Not every fifth snapshot: a slow browser
  // sees few of them.
  if (newest_at - worded_at > WORDS_MS) {
    worded_at = newest_at;
    show_lights(snapshot.lights);
    show_estimators(snapshot.estimators, snapshot.task);
  }
  const last = snapshot.last_command;
  if (last && last.number !== last_command) {
    last_command = last.number;
    show_answer(last.done, say("answer", {
      who: last.who,
      action: say(`action.${last.action}`),
      outcome: say(last.done ? "answer.done" : "answer.refused"),
      message: last.message,
    }));
  }
  watch_age();
}

function show_task({ task }) {
  const known = task != null;
  const phase = !known ? "unknown" : task.paused ? "paused" : task.phase;
  set($("phase"), known && task.active ? say("phase.of_task", { task: task.name, phase: say(`phase.${phase}`) }) : say(`phase.${phase}`));
  $("progress").value = task?.progress ?? 0;
  set($("percent"), `${Math.round(100 * (task?.progress ?? 0))} %`);
  $("fault").hidden = !task?.fault;
  set($("fault"), task?.fault ?? "");
  set($("path-error"), number(task?.path_error_mm, 1, "mm"));
  set($("tilt"), number(task?.tilt_deg, 1, "°"));
  const may = about?.you.role != null;
  $("start").disabled = !may || !known || task.active || !about.tasks.length;
  $("pause").disabled = !may || !task?.active || task.paused;
  $("resume").disabled = !may || !task?.active || !task.paused;
  $("tare").disabled = !may || !known || task.active;
}

function show_force({ force, time_s, task }) {
  set($("force-now"), number(force.now, 2, "N"));
  set($("force-reference"), task?.active ? number(force.reference, 2, "N") : "–");
  set($("force-peak"), number(peak(force.most, task), 2, "N"));
  plot?.add(time_s, force, task?.active);
}

// Most force of the present task.
let most = { activation: null, n: null };
function peak(n, task) {
  if (task && task.activation !== most.activation) most = { activation: task.activation, n: null };
  if (n != null && task?.active) most.n = Math.max(most.n ?? n, n);
  return most.n;
}

function show_lights(lights) {
  for (const [id, of_services] of [["lights", false], ["services", true]]) {
    const shown = lights.filter((light) => light.is_service === of_services);
    const rows = shown.map((light) => {
      const row = document.createElement("li");
      row.className = LEVELS[light.level];
      const [lamp, name, text] = ["span", "b", "span"].map((kind) => document.createElement(kind));
      lamp.className = "lamp";
      lamp.setAttribute("role", "img");
      lamp.setAttribute("aria-label", say(`light.${light.level}`));
      name.textContent = of_services ? light.part : say(`part.${light.part}`);
      text.textContent = say(`light.${light.code}`, light.values);
      row.append(lamp, name, text);
      return row;
    });
    $(id).replaceChildren(...rows);
  }
}

function show_estimators(estimators, task) {
  const may = about?.you.role === "engineer";
  const rows = $("estimators").children;
  estimators.forEach((one, i) => {
    const row = rows[i] ?? $("estimators").insertRow();
    if (!row.childElementCount) {
      for (let k = 0; k < 5; k += 1) row.insertCell();
      const use = document.createElement("button");
      use.type = "button";
      use.addEventListener("click", () => command({ action: "estimator", name: row.dataset.name }));
      row.cells[4].append(use);
    }
    row.dataset.name = one.name;
    row.className = one.in_use ? "in-use" : "";
    const [name, angle, sd, age, use] = row.cells;
    set(name, one.name);
    set(angle, one.valid ? number(one.angle_deg, 2, "°") : "–");
    set(sd, one.valid ? number(one.sd_deg, 2, "°") : "–");
    const state = one.age_ms == null ? say("estimator.never")
      : one.valid ? number(one.age_ms, 0, "ms") : one.reason || say("estimator.invalid");
    set(age, state);
    const button = use.firstChild;
    set(button, say(one.in_use ? "estimator.in_use" : "estimator.do_use"));
    button.setAttribute("aria-label", `${button.textContent}: ${one.name}`);
    button.disabled = one.in_use || !may || !task;
  });
  while (rows.length > estimators.length) $("estimators").deleteRow(-1);
}

// Reads the changed part of the dose map, at most twice a second.
async function ask_dose([epoch, revision]) {
  const now = performance.now();
  const same = epoch === dose.epoch && revision === dose.revision && dose.at > 0;
  if (same || dose.asking || now - dose.at < 500) return;
  dose.asking = true;
  dose.at = now;
  try {
    const answer = await get(`/api/dose?epoch=${dose.epoch}&revision=${dose.revision}`);
    const map = await answer.json();
    [dose.epoch, dose.revision] = [map.epoch, map.revision];
    scene?.dose(map);
    show_dose(map);
  } catch {
    // The next snapshot asks again.
  }
  dose.asking = false;
}

function show_dose(map) {
  const [least, most] = map.band.map((x) => x.toPrecision(3));
  set($("band"), say(map.band_is_default ? "dose.band.default" : "dose.band", { least, most }));
  const round = (x) => x.toFixed(1);
  set($("dose-words"), map.area_cm2 > 0 ? say("dose.words", {
    area: round(map.area_cm2),
    percent: Math.round((100 * map.good_cm2) / map.area_cm2),
    over: round(map.over_cm2),
    hole: round(map.hole_cm2),
    impulse: round(map.impulse_n_s),
  }) : say("dose.nothing"));
  $("dose-missed").hidden = !(map.missed_s > 0);
  set($("dose-missed"), say("dose.missed", { s: map.missed_s }));
}

// Says whether what is shown is the present.
function watch_age() {
  const age = performance.now() - newest_at;
  const live = age < OLD_MS;
  const badge = $("link");
  badge.className = live ? "badge good" : "badge bad";
  set(badge, live ? say("link.live") : say("link.lost"));
  const banner = $("banner");
  banner.hidden = live;
  if (live) return;
  const seconds = Number.isFinite(age) ? Math.round(age / 1000) : null;
  const after = !about ? "" : about.on_lost_page === "pause" ? say("lost.pause", { s: about.lost_page_after_s })
    : about.on_lost_page === "stop" ? say("lost.stop", { s: about.lost_page_after_s }) : say("lost.nothing");
  if (refused) set(banner, refused);
  else if (seconds == null) set(banner, say("lost.never"));
  else set(banner, `${say("lost.since", { s: seconds })} ${after}`);
}

async function command(body) {
  show_answer(true, say("answer.sent"));
  try {
    const answer = await post("/api/command", body);
    // The stream tells every page of it; a refusal before the cell only this one.
    if (!answer.done) show_answer(false, answer.message);
  } catch {
    show_answer(false, say("answer.lost"));
  }
}

// Sends the stop again until it has arrived.
async function stop() {
  const button = $("stop");
  button.classList.add("sent");
  const until = performance.now() + STOP_TRIES_MS;
  let why = say("answer.lost");
  for (;;) {
    try {
      const answer = await post("/api/command", { action: "stop" }, 3000);
      if (answer.done) {
        show_answer(true, say("stop.done"));
        break;
      }
      why = answer.message;
      if (answer.status < 500) {
        show_answer(false, why);
        break;
      }
    } catch {
      // Again, until the time is up.
    }
    if (performance.now() > until) {
      show_answer(false, say("stop.lost", { why }));
      break;
    }
    await new Promise((again) => setTimeout(again, 250));
  }
  button.classList.remove("sent");
}

function show_answer(good, text) {
  $("answer").className = good ? "answer" : "answer bad";
  set($("answer"), text);
}

async function save(path, name) {
  try {
    const answer = await get(path);
    if (!answer.ok) throw new Error(answer.statusText);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = `${about.cell}-${name}`;
    link.click();
    URL.revokeObjectURL(link.href);
  } catch {
    show_answer(false, say("answer.lost"));
  }
}

async function calibrate(step) {
  const buttons = [$("calibration-begin"), $("calibration-pose")];
  buttons.forEach((button) => { button.disabled = true; });
  set($("calibration-state"), say("calibration.working"));
  const answer = await post("/api/calibrate", { step }, 15000).catch(() => null);
  buttons.forEach((button) => { button.disabled = false; });
  const good = answer?.done === true;
  $("calibration-state").className = good ? "answer" : "answer bad";
  if (answer?.poses == null) {
    set($("calibration-state"), answer?.message ?? say("answer.lost"));
    return;
  }
  set($("calibration-state"), say("calibration.state", { poses: answer.poses, wanted: answer.wanted, why: answer.message }));
  $("calibration-warnings").replaceChildren(...answer.warnings.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
  $("calibration-lines").hidden = !answer.cell_file;
  set($("calibration-lines"), answer.cell_file ?? "");
}

async function list_recordings() {
  try {
    const { recordings } = await (await get("/api/recordings")).json();
    const rows = recordings.map(recording_row);
    if (!rows.length) {
      const none = document.createElement("li");
      none.textContent = say("recordings.none");
      rows.push(none);
    }
    $("recordings").replaceChildren(...rows);
  } catch {
    // The banner says that there is no connection.
  }
}

function recording_row(one) {
  const row = document.createElement("li");
  const name = document.createElement("span");
  name.className = "grow";
  const when = new Date(one.changed_s * 1000).toLocaleString();
  name.textContent = say("recording", { file: one.file, mb: (one.bytes / 1e6).toFixed(1), when });
  row.append(name);
  if (one.result) {
    const result = document.createElement("span");
    result.className = "grow";
    result.textContent = one.result;
    row.append(result);
  }
  if (one.report) {
    const link = document.createElement("a");
    link.href = `/recordings/${one.report}`;
    link.target = "_blank";
    link.rel = "noopener";
    link.textContent = say("report.open");
    row.append(link);
  }
  if (about?.can_report) {
    const make = document.createElement("button");
    make.type = "button";
    make.textContent = say(one.report ? "report.again" : "report.make");
    make.disabled = !hasToken();
    make.addEventListener("click", async () => {
      make.disabled = true;
      make.textContent = say("report.making");
      const answer = await post("/api/report", { recording: one.file }, 120000).catch(() => null);
      if (!answer?.done) show_answer(false, answer?.message ?? say("answer.lost"));
      list_recordings();
    });
    row.append(make);
  }
  return row;
}

// Changes a text only where it differs: a reader of the screen is not disturbed.
function set(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Teaching by hand: the arm is made free, places are taken, and a task file is saved.

import { get, post } from "./link.js";
import { say } from "./texts.js";

const SIGN_OF_LIFE_MS = 400;
const ASK_MS = 500;
const STEPS = ["begin", "hold", "point", "stroke", "home", "undo", "discard"];

const $ = (id) => document.getElementById(id);

// `person` teaches on this page; `saved` is called with the name of a new file, and `show` with the
// places that were taken.
export class Teaching {
  constructor(person, { saved, show }) {
    this.person = person;
    this.saved = saved;
    this.show_marks = show;
    this.state = null;
    // Only the page on which the arm was made free keeps it so, and not another one of this person.
    this.guides = false;
    this.lived = 0;
    this.asked = { revision: null, at: 0, busy: false };
    for (const step of STEPS) {
      $(`teach-${step}`).addEventListener("click", () => this.step(step));
    }
    $("teach-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.save(false);
    });
    $("teach-replace").addEventListener("click", () => this.save(true));
    $("teach-name").addEventListener("input", () => { $("teach-replace").hidden = true; });
    $("teach-shape").addEventListener("change", () => this.show_spacing());
    this.show_spacing();
    $("teach-panel").hidden = false;
    this.show(null);
  }

  // Takes the part of a snapshot in; null if nothing is taught.
  take(state) {
    const changed = JSON.stringify(state) !== JSON.stringify(this.state);
    this.state = state;
    if (changed) this.show(state);
    // Only while snapshots come in: what is not seen is not guided.
    const now = performance.now();
    if (state?.free && this.guides && now - this.lived > SIGN_OF_LIFE_MS) {
      this.lived = now;
      post("/api/teach", { step: "keep" }, 1500).catch(() => {});
    }
    this.ask(state?.revision ?? 0, now);
  }

  show(state) {
    const own = state?.who === this.person;
    const free = state?.free === true;
    const may = state == null || own || !(free || state.points || state.strokes);
    $("teach-free").hidden = !free;
    $("teach-free").textContent = say("teach.free", { who: state?.who });
    $("teach-state").textContent = this.words(state, own);
    $("teach-begin").disabled = !may || (free && this.guides);
    $("teach-own").disabled = !may || free;
    $("teach-hold").disabled = !own || !free;
    for (const step of ["point", "stroke", "home", "undo", "discard"]) {
      $(`teach-${step}`).disabled = !own;
    }
    $("teach-point").disabled = !own || state.stroking;
    $("teach-home").disabled = !own || state.stroking;
    $("teach-save").disabled = !own || state.stroking || !(state.points || state.strokes);
    $("teach-stroke").textContent = say(state?.stroking ? "teach.stroke.end" : "teach.stroke.begin");
  }

  words(state, own) {
    if (!state) return say("teach.nothing");
    const counts = say("teach.counts", { points: state.points, strokes: state.strokes });
    const parts = [own ? counts : say("teach.other", { who: state.who, counts })];
    if (state.stroking) parts.push(say("teach.stroking"));
    if (state.home) parts.push(say("teach.has_home"));
    if (!state.free) parts.push(state.held_because ? say("teach.held_because", { why: state.held_because }) : say("teach.held"));
    return parts.join(" ");
  }

  show_spacing() {
    $("teach-spacing").closest("label").hidden = $("teach-shape").value !== "region";
  }

  async step(step) {
    const body = step === "begin" && $("teach-own").checked ? "begin_held" : step;
    if (step === "begin") this.guides = true;
    const answer = await post("/api/teach", { step: body }, 12000).catch(() => null);
    if (step === "hold" || step === "discard") this.guides = false;
    this.show(this.state);
    this.answer(answer?.done === true, answer?.message ?? say("answer.lost"));
  }

  async save(replace) {
    const number = (id) => Number($(`teach-${id}`).value);
    const save = {
      name: $("teach-name").value.trim(),
      shape: $("teach-shape").value,
      spacing_m: number("spacing") / 1000,
      force_n: number("force"),
      speed_m_per_s: number("speed") / 1000,
      clearance_m: number("clearance") / 1000,
      tolerance_m: number("tolerance") / 1000,
      replace,
    };
    const answer = await post("/api/teach", { save }, 12000).catch(() => null);
    $("teach-replace").hidden = answer?.exists !== true;
    const notes = answer?.notes ?? [];
    this.answer(answer?.done === true, [answer?.message ?? say("answer.lost"), ...notes].join(" – "));
    if (answer?.done) this.saved(answer.file);
  }

  answer(good, text) {
    $("teach-answer").className = good ? "answer" : "answer bad";
    $("teach-answer").textContent = text;
  }

  // Reads the places that were taken, at most twice a second.
  async ask(revision, now) {
    const { asked } = this;
    if (revision === asked.revision || asked.busy || now - asked.at < ASK_MS) return;
    asked.busy = true;
    asked.at = now;
    try {
      const read = await (await get("/api/teach")).json();
      asked.revision = read.revision;
      this.show_marks(read.marks);
    } catch {
      // The next snapshot asks again.
    }
    asked.busy = false;
  }
}

// Force against time: measured with its least and most, wanted, and the limit.

import uPlot from "./vendor/uPlot.esm.js";
import { say } from "./texts.js";

const SECONDS = 30;

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class ForcePlot {
  constructor(place, limit) {
    this.place = place;
    this.limit = limit;
    this.data = [[], [], [], [], [], []];
    this.build();
    new ResizeObserver(() => this.plot.setSize(this.size())).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  size() {
    return { width: Math.max(260, this.place.clientWidth), height: 230 };
  }

  build() {
    this.plot?.destroy();
    const axis = { stroke: colour("--ink"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line") } };
    const newton = (u, v) => (v == null ? "–" : `${v.toFixed(2)} N`);
    const band = colour("--plot-band");
    const line = (text, stroke, more = {}) => ({ label: text, stroke, width: 2, points: { show: false }, value: newton, ...more });
    this.plot = new uPlot({
      ...this.size(),
      cursor: { y: false },
      legend: { live: false },
      scales: { x: { time: false, range: [-SECONDS, 0] }, y: { range: (u, low, high) => [Math.min(0, low ?? 0), Math.max(1, (high ?? 0) * 1.15)] } },
      axes: [
        { ...axis, incrs: [1, 5, 10], values: (u, all) => all.map((v) => (v === 0 ? say("plot.now") : `${v} s`)) },
        { ...axis, values: (u, all) => all.map((v) => `${v} N`), size: 58 },
      ],
      bands: [{ series: [1, 2], fill: band }],
      series: [
        { label: say("plot.time"), value: (u, v) => (v == null ? "–" : `${v.toFixed(1)} s`) },
        line(say("plot.most"), band, { width: 1 }),
        line(say("plot.least"), band, { width: 1 }),
        line(say("plot.force"), colour("--plot-force")),
        line(say("plot.reference"), colour("--plot-reference"), { dash: [8, 5] }),
        line(say("plot.limit"), colour("--plot-limit"), { dash: [2, 4] }),
      ],
    }, this.data, this.place);
  }

  add(time, force, active) {
    const data = this.data;
    if (data[0].length && time < data[0].at(-1)) this.data = [[], [], [], [], [], []];
    // The limit would hide the force, unless the force comes near it.
    const near = force.most != null && force.most > 0.4 * this.limit;
    const wanted = active ? force.reference : null;
    [time, force.most, force.least, force.now, wanted, near ? this.limit : null]
      .forEach((value, i) => this.data[i].push(value));
    const old = this.data[0].findIndex((t) => t >= time - SECONDS);
    if (old > 0) this.data.forEach((series) => series.splice(0, old));
    if (document.hidden) return;
    const [times, ...others] = this.data;
    this.plot.setData([times.map((t) => t - time), ...others]);
  }
}

// Plots to zoom into, and the surface in 3D. `uPlot` is the library above.

const dark = matchMedia("(prefers-color-scheme: dark)");
const rgb = ([r, g, b], opacity = 1) => `rgba(${r},${g},${b},${opacity})`;
const lighter = ([r, g, b]) => [r, g, b].map((c) => Math.round(c + (255 - c) * 0.4));
const shown = (value, unit) => (value == null ? "–" : `${Number(value.toPrecision(4))} ${unit}`);

// Shades of the phases behind a plot.
function shade(u, bands) {
  const { left, top, width, height } = u.bbox;
  u.ctx.save();
  u.ctx.beginPath();
  u.ctx.rect(left, top, width, height);
  u.ctx.clip();
  for (const [from, to, colour] of bands) {
    const a = u.valToPos(from, "x", true);
    u.ctx.fillStyle = rgb(colour, dark.matches ? 0.14 : 1);
    u.ctx.fillRect(a, top, u.valToPos(to, "x", true) - a, height);
  }
  u.ctx.restore();
}

function drawPlot(figure, data) {
  const ink = dark.matches ? "#ccc" : "#333";
  const axis = { stroke: ink, grid: { stroke: dark.matches ? "#fff2" : "#0002", width: 1 }, ticks: { show: false } };
  const place = figure.querySelector(".drawn") ?? figure.insertBefore(document.createElement("div"), figure.firstChild);
  place.className = "drawn";
  place.replaceChildren();
  const title = document.createElement("h3");
  title.textContent = `${data.title}, ${data.unit}`;
  place.append(title);
  const size = () => ({ width: Math.max(260, figure.clientWidth - 10), height: 290 });
  const plot = new uPlot({
    ...size(),
    cursor: { sync: { key: "time", scales: ["x", null] }, focus: { prox: 24 } },
    scales: { x: { time: false } },
    axes: [{ ...axis, values: (u, all) => all.map((v) => `${v} s`) }, { ...axis, size: 64 }],
    hooks: { drawClear: [(u) => shade(u, data.bands)] },
    series: [
      { label: "time", value: (u, v) => shown(v, "s") },
      ...data.curves.map((curve) => ({
        label: curve.name,
        stroke: rgb(dark.matches ? lighter(curve.colour) : curve.colour),
        width: 1.2,
        points: { show: false },
        value: (u, v) => shown(v, data.unit),
      })),
    ],
  }, [data.x, ...data.curves.map((curve) => curve.y)], place);
  return () => plot.setSize(size());
}

// Colours from least to most that differ in brightness too, after the map "viridis" of matplotlib.
const MAP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
function colourOf(share) {
  const at = Math.min(0.9999, Math.max(0, share)) * (MAP.length - 1);
  const low = MAP[Math.floor(at)], high = MAP[Math.floor(at) + 1], part = at % 1;
  return rgb(low.map((c, i) => Math.round(c + part * (high[i] - c))));
}

// Range of the values without the outermost hundredths.
function range(values) {
  const sorted = values.filter((v) => v != null).sort((a, b) => a - b);
  const low = sorted[Math.floor(0.01 * (sorted.length - 1))], high = sorted[Math.ceil(0.99 * (sorted.length - 1))];
  return high > low ? [low, high] : [low - 0.5, low + 0.5];
}

function drawSurface(figure, data) {
  const place = figure.insertBefore(document.createElement("div"), figure.firstChild);
  place.className = "drawn";
  const views = [
    ...data.values.map((one) => ({ name: `path: ${one.name}`, unit: one.unit, values: one.v })),
    { name: "dose of pressure", unit: "N s/cm²", values: data.cells.map((cell) => cell[2]), dose: true },
  ];
  const select = document.createElement("select");
  select.setAttribute("aria-label", "what the colour shows");
  select.append(...views.map((view, i) => new Option(view.name, i)));
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "the surface in 3D; turned with the arrow keys");
  const legend = document.createElement("p");
  legend.className = "scale";
  place.append(select, canvas, legend);

  const all = [...data.path, ...data.cells.map((cell) => cell[0])];
  const middle = [0, 1, 2].map((k) => (Math.min(...column(all, k)) + Math.max(...column(all, k))) / 2);
  const reach = Math.max(1, ...all.map((p) => Math.hypot(p[0] - middle[0], p[1] - middle[1], p[2] - middle[2])));
  const home = { turn: -0.6, lift: 0.9, zoom: 1 };
  const eye = { ...home };

  function column(points, k) {
    return points.map((p) => p[k]);
  }

  function draw() {
    const view = views[select.value || 0];
    const width = Math.max(260, figure.clientWidth - 10), height = Math.min(460, Math.round(0.6 * width));
    const sharp = devicePixelRatio || 1;
    canvas.width = width * sharp;
    canvas.height = height * sharp;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    const ctx = canvas.getContext("2d");
    ctx.scale(sharp, sharp);
    const scale = (0.46 * Math.min(width, height) / reach) * eye.zoom;
    const [ct, st, cl, sl] = [Math.cos(eye.turn), Math.sin(eye.turn), Math.cos(eye.lift), Math.sin(eye.lift)];
    const project = (p) => {
      const [x, y, z] = p.map((v, k) => v - middle[k]);
      const across = ct * x - st * y, away = st * x + ct * y;
      return [width / 2 + scale * across, height / 2 - scale * (sl * away + cl * z), cl * away - sl * z];
    };
    const [low, high] = range(view.values);
    const colour = (value) => (value == null ? "#888" : colourOf((value - low) / (high - low)));
    const line = (points, style, thick) => {
      ctx.strokeStyle = style;
      ctx.lineWidth = thick;
      ctx.beginPath();
      points.forEach((p, i) => (i ? ctx.lineTo(...project(p).slice(0, 2)) : ctx.moveTo(...project(p).slice(0, 2))));
      ctx.stroke();
    };
    if (view.dose) {
      const half = Math.max(1, 0.5 * data.cell * scale);
      const cells = data.cells.map((cell) => [project(cell[0]), cell]).sort((a, b) => b[0][2] - a[0][2]);
      for (const [[x, y], cell] of cells) {
        ctx.fillStyle = colour(cell[2]);
        ctx.fillRect(x - half, y - half, 2 * half, 2 * half);
      }
      ctx.strokeStyle = "#d40";
      for (const hole of data.holes) {
        const [x, y] = project(hole);
        ctx.strokeRect(x - half, y - half, 2 * half, 2 * half);
      }
    } else {
      line(data.wanted, dark.matches ? "#fff6" : "#0005", 1);
      ctx.lineWidth = 2.5;
      ctx.lineCap = "round";
      data.path.slice(1).forEach((p, i) => {
        ctx.strokeStyle = colour(view.values[i + 1]);
        ctx.beginPath();
        ctx.moveTo(...project(data.path[i]).slice(0, 2));
        ctx.lineTo(...project(p).slice(0, 2));
        ctx.stroke();
      });
    }
    const steps = Array.from({ length: 11 }, (_, i) => colourOf(i / 10)).join(",");
    const bar = document.createElement("span");
    bar.className = "bar";
    bar.style.background = `linear-gradient(to right,${steps})`;
    legend.replaceChildren(shown(low, view.unit), " ", bar, " ", shown(high, view.unit));
    if (view.dose && data.holes.length) legend.append(" – orange frames: holes");
  }

  const turn = (dx, dy) => {
    eye.turn += dx;
    eye.lift = Math.min(1.57, Math.max(-1.57, eye.lift + dy));
    draw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(-0.008 * event.movementX, 0.008 * event.movementY);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    eye.zoom = Math.min(20, Math.max(0.3, eye.zoom * Math.exp(-0.001 * event.deltaY)));
    draw();
  }, { passive: false });
  canvas.addEventListener("dblclick", () => {
    Object.assign(eye, home);
    draw();
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    turn(...step);
  });
  select.addEventListener("change", draw);
  draw();
  return draw;
}

const resized = [];
function drawAll() {
  resized.length = 0;
  for (const figure of document.querySelectorAll("figure")) {
    const text = figure.querySelector("script")?.textContent;
    if (!text) continue;
    figure.querySelector("svg")?.remove();
    const data = JSON.parse(text);
    const surface = figure.classList.contains("surface");
    if (surface) figure.querySelector(".drawn")?.remove();
    resized.push((surface ? drawSurface : drawPlot)(figure, data));
  }
}
drawAll();
dark.addEventListener("change", drawAll);
let waiting;
const again = () => {
  clearTimeout(waiting);
  waiting = setTimeout(() => resized.forEach((one) => one()), 80);
};
addEventListener("resize", again);
addEventListener("beforeprint", () => resized.forEach((one) => one()));

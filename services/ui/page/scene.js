// The arm, its tool and the dose on the surface, in space. World axes, m, z up.

import * as THREE from "./vendor/three.module.min.js";
import { OrbitControls } from "./vendor/OrbitControls.js";

const CELLS_MAX = 16384;
const HOLES_MAX = 4096;
const METRES_PER_N = 0.02;
// A picture that takes longer is followed by a rest, so many times as long.
const SMOOTH_MS = 20;
const REST = 3;
const UP = new THREE.Vector3(0, 1, 0);
const OUT = new THREE.Vector3(0, 0, 1);

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
const vector = (numbers) => new THREE.Vector3(...numbers);
const colour = (name) => new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());

export class ArmScene {
  constructor(place) {
    this.place = place;
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    place.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.01, 20);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.listenToKeyEvents(place);
    this.controls.addEventListener("change", () => this.ask());
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(1, -2, 3);
    this.scene.add(sun);
    this.links = [];
    this.joints = [];
    this.normal = new THREE.ArrowHelper(OUT, new THREE.Vector3(), 0.08, 0x2b7cff, 0.02, 0.012);
    this.force = new THREE.ArrowHelper(OUT, new THREE.Vector3(), 0.08, 0xff5a1f, 0.02, 0.012);
    this.wanted = new THREE.Mesh(new THREE.SphereGeometry(0.003), new THREE.MeshBasicMaterial({ color: 0xf0b000 }));
    for (const one of [this.normal, this.force, this.wanted]) {
      one.visible = false;
      this.scene.add(one);
    }
    this.cells = this.instances(new THREE.PlaneGeometry(1, 1), CELLS_MAX, { side: THREE.DoubleSide });
    this.holes = this.instances(new THREE.SphereGeometry(0.5, 8, 6), HOLES_MAX, {});
    this.points = new Map();
    this.shown = new THREE.Group();
    this.scene.add(this.shown);
    this.dress();
    this.resize();
    new ResizeObserver(() => this.resize()).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.dress());
  }

  instances(shape, most, look) {
    const mesh = new THREE.InstancedMesh(shape, new THREE.MeshBasicMaterial(look), most);
    mesh.count = 0;
    mesh.frustumCulled = false;
    this.scene.add(mesh);
    return mesh;
  }

  // Colours of light or dark mode.
  dress() {
    this.scene.background = colour("--panel");
    if (this.grid) this.scene.remove(this.grid);
    this.grid = new THREE.GridHelper(2, 20, colour("--dim"), colour("--line"));
    this.grid.rotation.x = Math.PI / 2;
    this.scene.add(this.grid);
    this.colours = { under: colour("--under"), good: colour("--dose-good"), over: colour("--over") };
    this.holes.material.color = colour("--hole");
    this.taught_look = { mark: colour("--mark"), home: colour("--accent") };
    this.paint();
    this.ask();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.ask();
  }

  // Draws soon.
  ask() {
    this.stale = true;
    if (!this.drawing) this.draw();
  }

  // Draws as long as something is new. Without a graphics card, drawing takes a quarter of the time
  // at most.
  async draw() {
    this.drawing = true;
    try {
      while (this.stale) {
        await new Promise(requestAnimationFrame);
        this.stale = false;
        const began = performance.now();
        this.renderer.render(this.scene, this.camera);
        await this.finished();
        const took = performance.now() - began;
        if (took > SMOOTH_MS) await sleep(REST * took);
      }
    } finally {
      // What fails once is tried again with the next snapshot.
      this.drawing = false;
    }
  }

  // Waits until the picture is drawn: `render` only says what is to be drawn.
  async finished() {
    const gl = this.renderer.getContext();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    // A lost context has no fence, or one without a status.
    while (fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED) await sleep(4);
    gl.deleteSync(fence);
  }

  show(space) {
    if (!space) return;
    const joints = space.joints.map(vector);
    this.tool = joints.at(-1);
    this.tool_z = vector(space.tool_z);
    this.draw_links(joints);
    this.arrow(this.normal, space.normal, () => 0.05);
    this.arrow(this.force, space.force, (length) => length * METRES_PER_N);
    this.wanted.visible = space.reference != null;
    if (space.reference) this.wanted.position.copy(vector(space.reference));
    if (!this.viewed) this.view_arm();
    this.ask();
  }

  arrow(arrow, along, length) {
    const v = along && vector(along);
    arrow.visible = v != null && v.length() > 1e-3;
    if (!arrow.visible) return;
    const long = Math.min(0.5, length(v.length()));
    arrow.position.copy(this.tool);
    arrow.setDirection(v.clone().normalize());
    arrow.setLength(Math.max(long, 0.005), Math.min(0.012, long * 0.4), 0.006);
  }

  // A cylinder from each joint to the next, a ball at each joint; the last one is the tool.
  draw_links(joints) {
    const count = joints.length - 1;
    while (this.links.length < count) {
      const is_tool = this.links.length === count - 1;
      const radius = is_tool ? 0.012 : 0.04 - 0.003 * this.links.length;
      const look = new THREE.MeshStandardMaterial({ color: is_tool ? 0x66707a : 0x9fb3c8, roughness: 0.6, transparent: true });
      const link = new THREE.Mesh(new THREE.CylinderGeometry(is_tool ? 0.008 : radius, radius, 1, 20), look);
      const ball = new THREE.Mesh(new THREE.SphereGeometry(radius * 1.15, 20, 14), look);
      this.links.push(link);
      this.joints.push(ball);
      this.scene.add(link, ball);
    }
    this.links.forEach((link, i) => {
      const along = joints[i + 1].clone().sub(joints[i]);
      const length = along.length();
      link.visible = length > 1e-4;
      this.joints[i].position.copy(joints[i]);
      if (!link.visible) return;
      link.scale.y = length;
      link.position.copy(joints[i]).addScaledVector(along, 0.5);
      link.quaternion.setFromUnitVectors(UP, along.divideScalar(length));
    });
  }

  // Draws the places that were taught: balls, and lines along strokes.
  taught(marks) {
    for (const old of this.shown.children) {
      old.geometry.dispose();
      old.material.dispose();
    }
    this.shown.clear();
    for (const { kind, places_mm } of marks) {
      const places = places_mm.map((at) => vector(at).multiplyScalar(0.001));
      if (!places.length) continue;
      const color = kind === "home" ? this.taught_look.home : this.taught_look.mark;
      if (kind === "stroke") {
        const shape = new THREE.BufferGeometry().setFromPoints(places);
        this.shown.add(new THREE.Line(shape, new THREE.LineBasicMaterial({ color })));
      }
      const ball = new THREE.SphereGeometry(kind === "home" ? 0.008 : 0.004, 12, 8);
      const mark = new THREE.Mesh(ball, new THREE.MeshBasicMaterial({ color }));
      mark.position.copy(places[0]);
      this.shown.add(mark);
    }
    this.place.dataset.taught = String(marks.length);
    this.ask();
  }

  // Takes in the answer of /api/dose.
  dose(map) {
    if (this.epoch !== map.epoch) this.points.clear();
    this.epoch = map.epoch;
    for (const [number, x, y, z, nx, ny, nz, dose] of map.cells) {
      this.points.set(number, { at: [x, y, z], normal: [nx, ny, nz], dose });
    }
    this.map = map;
    this.paint();
    this.ask();
  }

  paint() {
    if (!this.map) return;
    const { cell_mm, band, holes } = this.map;
    const frame = new THREE.Matrix4();
    const turn = new THREE.Quaternion();
    const size = new THREE.Vector3(1, 1, 1).multiplyScalar((cell_mm / 1000) * 1.08);
    let count = 0;
    for (const { at, normal, dose } of this.points.values()) {
      if (count === CELLS_MAX) break;
      const n = vector(normal);
      turn.setFromUnitVectors(OUT, n.clone().normalize());
      const place = vector(at).multiplyScalar(0.001).addScaledVector(n, 0.0008);
      this.cells.setMatrixAt(count, frame.compose(place, turn, size));
      this.cells.setColorAt(count, this.shade(dose, band));
      count += 1;
    }
    this.cells.count = count;
    this.cells.instanceMatrix.needsUpdate = true;
    if (this.cells.instanceColor) this.cells.instanceColor.needsUpdate = true;
    const shown = holes.slice(0, HOLES_MAX);
    shown.forEach((at, i) => {
      const place = vector(at).multiplyScalar(0.001);
      this.holes.setMatrixAt(i, frame.compose(place, turn.identity(), size));
    });
    this.holes.count = shown.length;
    this.holes.instanceMatrix.needsUpdate = true;
  }

  // Darker blue to light blue below the band, light to full green in it, red above.
  shade(dose, [least, most]) {
    const { under, good, over } = this.colours;
    const mixed = new THREE.Color();
    if (dose < least) return mixed.copy(under).multiplyScalar(0.55 + 0.45 * (dose / least));
    if (dose <= most) return mixed.copy(good).lerp(new THREE.Color(0xffffff), 0.35 * (1 - (dose - least) / (most - least)));
    return mixed.copy(over).multiplyScalar(Math.max(0.6, Math.min(1, most / dose + 0.4)));
  }

  look(at, from, opacity) {
    this.viewed = true;
    // The arm must not hide the surface that is looked at.
    for (const link of this.links) link.material.opacity = opacity;
    this.controls.target.copy(at);
    this.camera.position.copy(from);
    this.controls.update();
    this.ask();
  }

  view_arm() {
    if (!this.tool) return;
    const middle = this.tool.clone().multiplyScalar(0.55);
    middle.z = Math.max(0.15, middle.z * 0.8);
    const side = new THREE.Vector3(this.tool.y, -this.tool.x, 0).normalize();
    this.look(middle, middle.clone().addScaledVector(side, 1.5).add(new THREE.Vector3(0, 0, 0.7)), 1);
  }

  // The surface that was touched, seen from outside and a little from the side.
  view_surface() {
    if (!this.tool) return;
    const all = [...this.points.values()];
    let [middle, reach, out] = [this.tool.clone(), 0.12, this.tool_z.clone().negate()];
    if (all.length) {
      const box = new THREE.Box3().setFromPoints(all.map(({ at }) => vector(at).multiplyScalar(0.001)));
      box.getCenter(middle);
      reach = Math.max(0.05, box.getSize(new THREE.Vector3()).length() / 2);
      out = all.reduce((sum, { normal }) => sum.add(vector(normal)), new THREE.Vector3()).normalize();
    }
    const side = new THREE.Vector3(middle.y, -middle.x, 0).normalize();
    const from = out.multiplyScalar(0.85).addScaledVector(side, 0.5).normalize();
    this.look(middle, middle.clone().addScaledVector(from, reach * 3.4), 0.25);
  }
}

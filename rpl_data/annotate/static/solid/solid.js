// The 3D view: keypoints, the points around them from every scene, the dense model. Every click updates it.

import { cloud, denseModel, shownScenes } from "./dense.js";
import { element } from "../panels/dom.js";
import { addKeys } from "../panels/keys.js";
import { app, change, keypointTitle, onChange, places } from "../state/store.js";

export const SCENE_COLORS = ["#0a84d6", "#e08a00", "#12a06a", "#d65aa0", "#8f6bf0", "#d9480f", "#5f9e00", "#00a3a3"];
const MM = 1000, STILL_PX = 4;
const section = document.getElementById("solid");
const plot = element("div", { id: "plot", tabIndex: 0, ariaLabel: "3D view: arrow keys turn it, + and - zoom" });
const empty = element("p", { className: "empty", id: "plot-empty" });
export const stage = element("div", { id: "solid-stage" }, plot, empty); // other parts put their controls here
const show = { surfaces: true, around: false, photo: false, dense: true, names: false };
const toggles = []; // of other parts
const extras = []; // functions that give more traces
let drawn = [], library = null, camera = null;

export function setUp() {
  const tools = element("div", { id: "solid-tools", className: "row" },
    toggle("surfaces", "surfaces"), toggle("around", "surroundings"),
    toggle("photo", "photo colours"), toggle("dense", "dense model"), toggle("names", "names"), ...toggles);
  section.append(element("div", { className: "solid-head" }, tools), stage);
  plot.addEventListener("keydown", turn);
  new ResizeObserver(() => plot._fullLayout && !section.hidden && window.Plotly.Plots.resize(plot)).observe(plot);
  addKeys([
    [["v"], "the next view: mark, 3D model, labels", nextView],
    [["arrows", "+", "-"], "in 3D: rotate the model, zoom in, zoom out", null],
  ]);
  onChange(draw);
}

// Other parts add traces: give() is called at every drawing, watch() returns what they depend on.
export function addTraces(give, watch) {
  extras.push({ give, watch });
}

// Another part may show something else instead: give() is null, or all that is to be drawn.
let instead = () => null;
export function insteadOf(give) {
  instead = give;
}

// Called with a point of the drawing that was clicked, metres.
let picked = () => {};
export function onPick(does) {
  picked = does;
}

// Another part's own toggle; returns whether it is on.
export function addToggle(name, text, title) {
  show[name] = false;
  const made = toggle(name, text);
  made.title = title;
  toggles.push(made);
  return () => show[name];
}

function nextView() {
  const views = [...document.querySelectorAll("#views button")].map((tab) => tab.dataset.view);
  change({ view: views[(views.indexOf(app.view) + 1) % views.length] });
}

function toggle(name, text) {
  const box = element("input", { type: "checkbox", checked: show[name], id: `solid-${name}` });
  box.addEventListener("change", () => { show[name] = box.checked; drawn = []; change({}); });
  return element("label", {}, box, ` ${text}`);
}

function loadLibrary() {
  library ||= new Promise((resolve, reject) => {
    const script = element("script", { src: "/plotly.js" });
    script.onload = resolve;
    script.onerror = () => { library = null; reject(new Error("plotly.js could not be loaded; check the connection")); };
    document.head.append(script);
  });
  return library;
}

function say(text) {
  empty.textContent = text;
  empty.hidden = !text;
}

async function draw() {
  if (app.view !== "solid" || !app.state || !app.workspace) return;
  const other = instead(), scenes = other ? [] : shownScenes();
  if (!other && !scenes.length && !denseModel() && !extras.some(({ give }) => give().length))
    return say("Nothing to show yet: mark a keypoint (view Mark), and the surfaces around it appear here.");
  if (!window.Plotly) say("loading the 3D view …");
  try {
    await loadLibrary();
  } catch (error) {
    return say(error.message);
  }
  say("");
  const clouds = scenes.map((scene) => ({ ...scene, cloud: cloud(scene) }));
  const inputs = [app.result, app.state.revision, app.dense, app.keypoint, app.cloudsLoaded, scenes.map((s) => s.name).join(),
    document.documentElement.dataset.theme, ...extras.flatMap(({ watch }) => watch())];
  if (inputs.length === drawn.length && inputs.every((value, i) => value === drawn[i])) return;
  drawn = inputs;
  const traces = other || [...surfaces(clouds), ...dense(), ...skeleton(), keypoints(scenes), ...extras.flatMap(({ give }) => give())];
  await window.Plotly.react(plot, traces, layout(), { displaylogo: false, displayModeBar: false, responsive: true });
  if (plot.dataset.drawn === undefined) listen();
  plot.dataset.drawn = Number(plot.dataset.drawn || 0) + 1;
}

function listen() {
  plot.on("plotly_relayout", (event) => { camera = event["scene.camera"] || camera; });
  // Plotly's own click needs a drawing between press and release, which a quick hand does not wait for.
  let under = null, pressed = null;
  plot.on("plotly_hover", ({ points: [{ x, y, z }] }) => { under = [x / MM, y / MM, z / MM]; });
  plot.on("plotly_unhover", () => { under = null; });
  plot.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY, under]; }, true);
  plot.addEventListener("pointerup", (event) => {
    const [x, y, point] = pressed || [];
    if (point && Math.hypot(event.clientX - x, event.clientY - y) < STILL_PX) picked(point);
  }, true);
}

const axis = (points, i) => points.map((point) => MM * point[i]);
export const xyz = (points) => ({ x: axis(points, 0), y: axis(points, 1), z: axis(points, 2) });
let cut = () => null; // the box [low, high] that another part cuts the points to; null = none
export const cutTo = (box) => { cut = box; };

// The keypoints' box with a margin: what stands around the object hides it. Null while nothing is solved.
export function nearBox(margin = 0.1) {
  const points = (app.result?.points_m || []).filter(Boolean);
  if (points.length < 3) return null;
  const low = [0, 1, 2].map((i) => Math.min(...points.map((p) => p[i]))), high = [0, 1, 2].map((i) => Math.max(...points.map((p) => p[i])));
  const more = Math.max(0.02, margin * Math.hypot(...high.map((x, i) => x - low[i])));
  return [low.map((x) => x - more), high.map((x) => x + more)];
}

const isIn = (box, point) => !box || point.every((x, i) => x > box[0][i] && x < box[1][i]);

function surfaces(clouds) {
  if (!show.surfaces) return [];
  const box = cut() || (show.around ? null : nearBox());
  return clouds.filter((scene) => scene.cloud).map(({ name, cloud: { points, colors } }) => {
    const chosen = points.map((p, i) => [p, i]).filter(([p]) => isIn(box, p));
    const number = places().indexOf(name);
    const photo = () => chosen.map(([, i]) => `rgb(${colors[3 * i]},${colors[3 * i + 1]},${colors[3 * i + 2]})`);
    return {
      type: "scatter3d", mode: "markers", name: `scene ${name}`, ...xyz(chosen.map(([p]) => p)), hoverinfo: "skip",
      marker: { size: 2, color: show.photo ? photo() : SCENE_COLORS[number % SCENE_COLORS.length], opacity: show.photo ? 1 : 0.75 },
    };
  });
}

function dense() {
  const model = denseModel();
  if (!model || !show.dense) return [];
  const corners = (i) => Array.from({ length: model.triangles.length / 3 }, (_, t) => model.triangles[3 * t + i]);
  return [{
    type: "mesh3d", name: "dense model", showlegend: true, ...xyz(model.points), i: corners(0), j: corners(1), k: corners(2),
    color: "#9aa7ae", opacity: show.surfaces ? 0.55 : 1, hoverinfo: "skip", flatshading: false,
    lighting: { ambient: 0.55, diffuse: 0.7, specular: 0.1, roughness: 0.8 },
  }];
}

function skeleton() {
  const points = app.result?.points_m || [];
  const ends = (app.result?.skeleton || []).filter(([a, b]) => points[a] && points[b]);
  if (!ends.length) return [];
  const line = ends.flatMap(([a, b]) => [points[a], points[b], [NaN, NaN, NaN]]);
  return [{ type: "scatter3d", mode: "lines", ...xyz(line), line: { color: "#87919a", width: 3 }, hoverinfo: "skip", showlegend: false }];
}

// The solved keypoints, or while there are none the clicks of the current scene, lifted by their depth.
function keypoints(scenes) {
  const solved = (app.result?.points_m || []).map((point, k) => ({ point, k })).filter(({ point }) => point);
  const lifted = (app.result?.lifted || []).filter((c) => c.scene === scenes[0]?.name).map((c) => ({ point: c.point_m, k: c.keypoint }));
  const shown = (app.result?.points_m ? solved : lifted).filter(({ k }) => k < app.state.keypoints.length);
  const of = (k) => app.state.keypoints[k];
  const knownTo = (k) => (app.result?.known_to_mm?.[k] != null ? ` · known to ± ${app.result.known_to_mm[k].toFixed(1)} mm` : "");
  return {
    type: "scatter3d", mode: "markers+text", showlegend: false, ...xyz(shown.map(({ point }) => point)),
    text: shown.map(({ k }) => (show.names || k === app.keypoint ? escaped(keypointTitle(k)) : String(k))),
    hovertext: shown.map(({ k }) => escaped(`${keypointTitle(k)}${knownTo(k)}`)), hovertemplate: "%{hovertext}<extra></extra>",
    textposition: "top center", textfont: labelFont(),
    marker: {
      size: shown.map(({ k }) => (k === app.keypoint ? 9 : 6)), color: shown.map(({ k }) => of(k).color),
      line: { color: css("--ink"), width: 1 },
    },
  };
}

// Plotly reads a few tags in texts.
const escaped = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const labelFont = () => ({ color: css("--ink"), size: 13 });

function layout() {
  const ink = css("--ink"), line = css("--line");
  const axisLook = { title: "", color: ink, gridcolor: line, zeroline: false, showbackground: false, ticksuffix: " mm", nticks: 4, showspikes: false };
  return {
    uirevision: `${app.state.object}${instead() ? " alone" : ""}`, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: css("--panel"),
    font: { color: ink, size: 12 }, showlegend: true,
    legend: { x: 0, y: 1, bgcolor: "rgba(0,0,0,0)", itemsizing: "constant", font: { color: ink } },
    scene: {
      aspectmode: "data", dragmode: "orbit", xaxis: axisLook, yaxis: axisLook, zaxis: axisLook,
      // The object frame has the axes of the first camera: y down, z away from it.
      camera: { up: { x: 0, y: -1, z: 0 }, eye: { x: 0.6, y: -0.8, z: -1.5 }, center: { x: 0, y: 0, z: 0 } },
    },
  };
}

function turn(event) {
  const now = camera || plot._fullLayout?.scene?.camera, { eye } = now || {};
  const step = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], "+": [0, 0, 0.85], "=": [0, 0, 0.85], "-": [0, 0, 1.18] }[event.key];
  if (!step || !eye) return;
  event.preventDefault();
  event.stopPropagation();
  const [around, up, nearer = 1] = step;
  const radius = Math.hypot(eye.x, eye.y, eye.z) * nearer;
  const azimuth = Math.atan2(eye.x, -eye.z) + 0.15 * around;
  const height = Math.max(-1.45, Math.min(1.45, Math.asin(-eye.y / Math.hypot(eye.x, eye.y, eye.z)) + 0.15 * up));
  const moved = { x: radius * Math.cos(height) * Math.sin(azimuth), y: -radius * Math.sin(height), z: -radius * Math.cos(height) * Math.cos(azimuth) };
  camera = { ...now, eye: moved };
  window.Plotly.relayout(plot, { "scene.camera": camera });
}

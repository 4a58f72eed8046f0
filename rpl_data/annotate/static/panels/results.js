// How good it is: errors a scene and a click, what is wrong, what is missing.

import { element, refill } from "./dom.js";
import { openScene } from "../image/frames.js";
import { looks } from "./looks.js";
import { app, frame, keypointTitle, onChange, residualOf } from "../state/store.js";

const panel = document.getElementById("result");
const STEPS = [
  "Choose keypoints: corners, screws, spouts that you will know again in every scene.",
  "In every scene, click at least four of them, in any frames. Skip what is hidden.",
  "Errors appear here after each click; a bad click turns red and says why.",
  "When every scene is placed: make the dense model and the labels, and look at them.",
];
const DEPTH_WORDS = { agrees: "", "other surface": "other surface", rejected: "depth not used", none: "no depth" };

export function setUp() {
  onChange(draw, () => [app.state, app.result, app.scene, app.row, app.keypoint]);
}

const go = (click) => openScene(click.scene, click.frame, { keypoint: click.keypoint, view: "mark" });

function draw() {
  if (!app.state) return;
  if (!app.result || !app.state.clicks.length) return refill(panel, ...beginning());
  const { result } = app;
  refill(panel, ...badClicks(result), ...ofScenes(result), ...missing(result), ...ofKeypoint(result));
}

const beginning = () => [
  element("h2", { textContent: "How it goes" }),
  element("ol", { className: "steps" }, ...STEPS.map((text) => element("li", { textContent: text }))),
];

function badClicks(result) {
  const bad = result.clicks.filter((click) => click.outlier);
  if (!bad.length) return [];
  return [element("h2", { className: "bad", textContent: bad.length > 1 ? `${bad.length} bad clicks` : "A bad click" }),
    ...bad.map((click) => {
      const where = `${keypointTitle(click.keypoint)} · scene ${click.scene}, frame ${click.frame}`;
      const button = element("button", { className: "fault", title: "show it" },
        element("b", { textContent: where }), element("span", { textContent: click.reason }));
      button.addEventListener("click", () => go(click));
      return button;
    })];
}

function ofScenes(result) {
  const rows = Object.entries(result.scenes).map(([name, s]) =>
    [name, s.clicked, s.error_mm?.toFixed(1) ?? "—", s.error_px?.toFixed(1) ?? "—"]);
  const problem = result.problem ? [element("p", { className: "note bad", textContent: result.problem })] : [];
  return [element("h2", { textContent: "Errors by scene" }), ...problem,
    table(["scene", "keypoints", "mm", "px"], rows, (i) => openScene(rows[i][0], null, { view: "mark" }))];
}

function missing(result) {
  const lines = Object.entries(result.loose).map(([name, text]) => `scene ${name}: ${text}`);
  const all = [...lines, ...result.warnings];
  if (!all.length) return [];
  const rest = all.length > 6 ? [element("p", { className: "note quiet", textContent: `and ${all.length - 6} more` })] : [];
  return [element("h2", { className: "warn", textContent: "Tied too little" }),
    ...all.slice(0, 6).map((text) => element("p", { className: "note", textContent: text })), ...rest];
}

function ofKeypoint(result) {
  const mine = app.state.clicks.filter((click) => click.keypoint === app.keypoint);
  const sigma = result.sigma_mm[app.keypoint];
  const head = element("h2", { textContent: keypointTitle(app.keypoint) },
    element("span", { className: "quiet small", textContent: sigma == null ? "" : `known to ±${sigma.toFixed(1)} mm` }));
  if (!mine.length) return [head, element("p", { className: "note quiet", textContent: "No clicks yet." })];
  const rows = mine.map((click) => {
    const found = residualOf(click);
    const here = click.scene === app.scene && click.frame === frame() ? "• " : "";
    const state = found?.outlier ? "✗ bad" : DEPTH_WORDS[found?.depth_state] ?? "";
    return [`${here}${click.scene} / ${click.frame}`, found?.error_mm?.toFixed(1) ?? "—", found?.error_px.toFixed(1) ?? "—", state];
  });
  return [head, looks(mine, go), table(["scene / frame", "mm", "px", ""], rows, (i) => go(mine[i]))];
}

// A table whose rows lead somewhere, by mouse and by keyboard.
function table(head, rows, click) {
  const body = rows.map(([first, ...cells], i) => {
    const link = element("button", { className: "cell", textContent: first });
    const line = element("tr", { className: "link" }, element("td", {}, link),
      ...cells.map((text) => element("td", { textContent: text })));
    line.addEventListener("click", () => click(i));
    return line;
  });
  return element("table", {}, element("tr", {}, ...head.map((text) => element("th", { textContent: text }))), ...body);
}

// How good the result is: what the clicks contradict, errors per scene and per click, what is missing.

import { element, prose, refill } from "./dom.js";
import { distancesFrom } from "../solid/distances.js";
import { openScene } from "../image/frames.js";
import { looks } from "./looks.js";
import { millimetres } from "./scenes.js";
import { app, frame, keypointTitle, onChange, residualOf } from "../state/store.js";

const panel = document.getElementById("result");
const STEPS = [
  "Choose keypoints: corners, screws, spouts that you will know again in every scene.",
  "In every scene, click four of them or more, in any frames: three place it, the others check. Skip what is hidden.",
  "Expected errors appear here after each click; a wrong click turns red and says why.",
  "When every scene is placed: make the dense model and the labels, and look at them.",
];
const DEPTH_WORDS = { agrees: "", "other surface": "other surface", rejected: "depth not used", none: "no depth" };

const MISSING = ["unchecked", "weak scene", "unjudged"]; // statements about what is missing, not about what is wrong
const OWN_PATH = "No build has checked the camera’s path yet: where it drifts, rings lie beside the object in frames without clicks.";

export function setUp() {
  onChange(draw, () => [app.state, app.result, app.scene, app.row, app.keypoint, app.fresh]);
}

const go = (click) => openScene(click.scene, click.frame, { keypoint: click.keypoint, view: "mark" });

function draw() {
  if (!app.state) return;
  if (!app.result || !app.state.clicks.length) return refill(panel, ...beginning());
  const { result } = app;
  refill(panel, ...statements(result), ...ofScenes(result), ...missing(result), ...ofKeypoint(result), ...distances());
}

const beginning = () => [
  element("h2", { textContent: "How it goes" }),
  element("ol", { className: "steps" }, ...STEPS.map((text) => element("li", { textContent: text }))),
];

// What is said of clicks; a line leads to the first of them.
function statements(result) {
  if (result.checking) return [element("p", { id: "checking", className: "note quiet", textContent: "Checking the clicks …" })];
  const said = result.statements.filter((statement) => !MISSING.includes(statement.kind));
  if (!said.length) return [];
  const wrong = said.some((statement) => statement.blames);
  return [element("h2", { className: wrong ? "bad" : "warn", textContent: wrong ? "Clicks to mend" : "Clicks that disagree" }),
    ...said.map((statement) => {
      const button = element("button", { className: statement.blames ? "fault" : "fault doubt", title: "show it" },
        element("span", { textContent: statement.text }));
      button.addEventListener("click", () => go(statement.clicks[0]));
      return button;
    })];
}

const digits = (value, write = (v) => v.toFixed(1)) => (value == null ? "—" : write(value));

// Two different things: how far off labels should be, and how far the clicks are from what fits all of them.
function ofScenes(result) {
  const rows = Object.entries(result.scenes).map(([name, s]) =>
    [name, s.clicked, digits(s.expected_mm, millimetres), digits(s.expected_px), digits(s.miss_px)]);
  const problem = result.problem ? [element("p", { className: "note bad", textContent: result.problem })] : [];
  const note = "± is how far off labels are expected to be. “Miss” says only how well the clicks agree; few clicks always do.";
  const path = app.fresh?.track === false ? [element("p", { id: "own-path", className: "small quiet", textContent: OWN_PATH })] : [];
  return [element("h2", { textContent: "Expected errors" }), ...problem,
    table(["scene", "clicked", "± mm", "± px", "miss, px"], rows, (i) => openScene(rows[i][0], null, { view: "mark" })),
    element("p", { className: "small quiet", textContent: note }), ...path];
}

function missing(result) {
  const lines = Object.entries(result.loose).map(([name, text]) => `scene ${name}: ${text}`);
  const unchecked = result.statements.filter((statement) => MISSING.includes(statement.kind));
  const all = [...lines, ...result.warnings, ...unchecked.map((statement) => statement.text)];
  if (!all.length) return [];
  const rest = all.length > 6 ? [element("p", { className: "note quiet", textContent: `and ${all.length - 6} more` })] : [];
  return [element("h2", { className: "warn", textContent: result.next.action === "label" ? "More clicks would tell" : "Clicks still needed" }),
    ...all.slice(0, 6).map((text) => element("p", { className: "note" }, ...prose(text))), ...rest];
}

function ofKeypoint(result) {
  const mine = app.state.clicks.filter((click) => click.keypoint === app.keypoint);
  const knownTo = result.known_to_mm[app.keypoint];
  const head = element("h2", { textContent: keypointTitle(app.keypoint) },
    element("span", { className: "quiet small", textContent: knownTo == null ? "" : `known to ± ${millimetres(knownTo)} mm` }));
  if (!mine.length) return [head, element("p", { className: "note quiet", textContent: "No clicks yet." })];
  const rows = mine.map((click) => {
    const found = residualOf(click);
    const here = click.scene === app.scene && click.frame === frame() ? "• " : "";
    const state = found?.outlier ? "✗ wrong" : found?.reason ? "? doubtful" : DEPTH_WORDS[found?.depth_state] ?? "";
    return [`${here}${click.scene} / ${click.frame}`, found?.error_mm?.toFixed(1) ?? "—", found?.error_px.toFixed(1) ?? "—", state];
  });
  return [head, looks(mine, go), table(["scene / frame", "miss, mm", "px", ""], rows, (i) => go(mine[i]))];
}

// One that can be measured on the object gives an error away.
function distances() {
  const rows = distancesFrom(app.keypoint).map(({ k, mm }) =>
    element("tr", {}, element("td", { textContent: `to ${keypointTitle(k)}` }), element("td", { textContent: mm.toFixed(1) })));
  if (!rows.length) return [];
  const head = element("tr", {}, element("th", { textContent: "distance; measure one to check" }), element("th", { textContent: "mm" }));
  return [element("table", { id: "distances" }, head, ...rows)];
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

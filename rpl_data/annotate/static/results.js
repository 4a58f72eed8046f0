// How good it is: errors a scene and a click, what is wrong, what is missing.

import { openScene } from "./frames.js";
import { app, frame, onChange } from "./store.js";
import { element } from "./dom.js";

const panel = document.getElementById("result");

export function setUp() {
  onChange(draw);
}

const go = (click) => openScene(click.scene, click.frame, { keypoint: click.keypoint, view: "mark" });
const keypointName = (k) => app.state.keypoints[k]?.name ?? k;

function draw() {
  if (!app.state) return;
  const result = app.result, parts = [element("h2", { textContent: "Result" })];
  if (!result || !app.state.clicks.length) {
    parts.push(element("p", { className: "note quiet", textContent: "Errors appear here after the first clicks." }));
  } else {
    parts.push(...summary(result), ...badClicks(result), ...missing(result), ...clicksOfKeypoint(result));
  }
  panel.replaceChildren(...parts);
}

function summary(result) {
  const rows = Object.entries(result.scenes).map(([name, s]) => [name, s.clicked, s.error_mm?.toFixed(1) ?? "—", s.error_px?.toFixed(1) ?? "—"]);
  const note = result.problem ? [element("p", { className: "note bad", textContent: result.problem })] : [];
  return [...note, table(["scene", "keypoints", "mm", "px"], rows, (i) => openScene(rows[i][0]))];
}

function badClicks(result) {
  const bad = result.clicks.filter((c) => c.outlier);
  return bad.map((click) => {
    const text = `✗ scene ${click.scene}, frame ${click.frame}: ${click.reason}`;
    const button = element("button", { className: "bad note", textContent: text, title: "show it" });
    button.addEventListener("click", () => go(click));
    return button;
  });
}

function missing(result) {
  const lines = Object.entries(result.loose).map(([name, text]) => `scene ${name} ${text}`);
  const all = [...lines, ...result.warnings];
  if (!all.length) return [];
  return [element("h3", { textContent: "Tied too little" }),
    ...all.slice(0, 6).map((text) => element("p", { className: "note warn", textContent: text }))];
}

function clicksOfKeypoint(result) {
  const mine = app.state.clicks.filter((c) => c.keypoint === app.keypoint);
  const sigma = result.sigma_mm[app.keypoint];
  const title = `${keypointName(app.keypoint)}${sigma != null ? ` · known to ±${sigma.toFixed(1)} mm` : ""}`;
  if (!mine.length) return [element("h3", { textContent: `${title}: no clicks yet` })];
  const rows = mine.map((click) => {
    const found = result.clicks.find((r) => r.keypoint === click.keypoint && r.scene === click.scene && r.frame === click.frame);
    const here = click.scene === app.scene && click.frame === frame() ? "• " : "";
    const depth = { agrees: "", "other surface": "other surface", rejected: "depth not used", none: "no depth" };
    return [`${here}${click.scene} / ${click.frame}`, found?.error_mm?.toFixed(1) ?? "—", found?.error_px.toFixed(1) ?? "—", found?.outlier ? "✗" : depth[found?.depth_state] ?? ""];
  });
  return [element("h3", { textContent: title }),
    table(["scene / frame", "mm", "px", ""], rows, (i) => go(mine[i]))];
}

function table(head, rows, click) {
  const body = rows.map((cells, i) => {
    const line = element("tr", { className: "link" }, ...cells.map((text) => element("td", { textContent: text })));
    line.addEventListener("click", () => click(i));
    return line;
  });
  return element("table", {}, element("tr", {}, ...head.map((text) => element("th", { textContent: text }))), ...body);
}

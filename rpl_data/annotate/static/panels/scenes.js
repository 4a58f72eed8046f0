// The list of scenes: the progress and quality of each.

import { openScene, suggestions } from "../image/frames.js";
import { selectOpen } from "./keypoints.js";
import { app, change, clicksIn, isSkipped, onChange } from "../state/store.js";
import { element, refill } from "./dom.js";

const list = document.getElementById("scenes");
const WORDS = {
  checking: ["quiet", "checking …"], tied: ["good", "placed"], bad: ["bad", "wrong click"],
  doubt: ["warn", "doubtful"], found: ["good", "found without clicks"], loose: ["warn", "not placed"], few: ["warn", "too few"],
};

export function setUp() {
  onChange(draw, () => [app.workspace, app.state, app.result, app.scene]);
  onChange(suggest, () => [app.state, app.result, app.scene]);
}

// Request suggested frames once per scene, and again when the object's pose in it is known.
const asked = new Set();
async function suggest() {
  if (!app.state || !app.result || app.scene === null) return;
  const name = app.scene, object = app.state.object;
  const key = `${object}/${name}/${name in app.result.scene_from_object}`;
  if (asked.has(key)) return;
  asked.add(key);
  if (!(await suggestions(name))) asked.delete(key);
}

export function step(by) {
  const names = app.workspace.scenes, at = names.indexOf(app.scene);
  return open(names[(at + by + names.length) % names.length]);
}

// Open a scene to mark the keypoints that are not marked there yet.
async function open(name) {
  await openScene(name);
  selectOpen();
}

function draw() {
  if (!app.workspace || !app.state) return;
  const tied = app.workspace.scenes.filter((name) => app.result?.scene_from_object?.[name]).length;
  document.getElementById("scene-progress").textContent = `${tied} of ${app.workspace.scenes.length} placed`;
  refill(list, ...app.workspace.scenes.map(row));
}

function row(name) {
  const count = app.state.keypoints.length;
  const done = new Set(clicksIn(name).map((c) => c.keypoint)).size;
  const skipped = app.state.keypoints.filter((_, k) => isSkipped(k, name)).length;
  const found = app.result?.scenes?.[name];
  const [kind, word] = done || found ? WORDS[found?.state] || ["quiet", "…"] : ["quiet", "nothing yet"];
  const error = found?.error_mm != null ? ` ${found.error_mm.toFixed(1)} mm` : "";
  const button = element("button", { title: found?.text || "" },
    element("span", { className: "name", textContent: name }),
    element("span", { className: "small quiet", textContent: `${done}${skipped ? `+${skipped}` : ""}/${count}` }),
    element("span", { className: `small ${kind}`, textContent: word + error }));
  button.addEventListener("click", () => open(name));
  const item = element("li", {}, button);
  item.setAttribute("aria-current", name === app.scene);
  return item;
}

// The list of scenes: how far each one is, and how good.

import { get, objectPath } from "./api.js";
import { openScene } from "./frames.js";
import { app, change, clicksIn, isSkipped, onChange } from "./store.js";
import { element } from "./dom.js";

const list = document.getElementById("scenes");
const WORDS = {
  tied: ["good", "tied"], bad: ["bad", "bad click"], loose: ["warn", "loose"], few: ["warn", "too few"],
};

export function setUp() {
  onChange(draw);
  onChange(suggest);
}

// Ask for frames worth marking, once a scene, and again when the object has a place in it.
const asked = new Set();
async function suggest() {
  if (!app.state || !app.result || app.scene === null) return;
  const name = app.scene, object = app.state.object;
  const key = `${object}/${name}/${name in app.result.scene_from_object}`;
  if (asked.has(key)) return;
  asked.add(key);
  const found = await get(`${objectPath(object)}/suggestions/${encodeURIComponent(name)}`).catch(() => null);
  if (found) change({ suggestions: { ...app.suggestions, [name]: found } }); else asked.delete(key);
}

export function step(by) {
  const names = app.workspace.scenes, at = names.indexOf(app.scene);
  openScene(names[(at + by + names.length) % names.length]);
}

function draw() {
  if (!app.workspace || !app.state) return;
  const tied = app.workspace.scenes.filter((name) => app.result?.scene_from_object?.[name]).length;
  document.getElementById("scene-progress").textContent = `${tied} of ${app.workspace.scenes.length} placed`;
  list.replaceChildren(...app.workspace.scenes.map(row));
}

function row(name) {
  const count = app.state.keypoints.length;
  const done = new Set(clicksIn(name).map((c) => c.keypoint)).size;
  const skipped = app.state.keypoints.filter((_, k) => isSkipped(k, name)).length;
  const found = app.result?.scenes?.[name];
  const [kind, word] = done ? WORDS[found?.state] || ["quiet", "…"] : ["quiet", "nothing yet"];
  const error = found?.error_mm != null ? ` ${found.error_mm.toFixed(1)} mm` : "";
  const button = element("button", { title: found?.text || "" },
    element("span", { className: "name", textContent: name }),
    element("span", { className: "small quiet", textContent: `${done}${skipped ? `+${skipped}` : ""}/${count}` }),
    element("span", { className: `small ${kind}`, textContent: word + error }));
  button.addEventListener("click", () => openScene(name));
  const item = element("li", {}, button);
  item.setAttribute("aria-current", name === app.scene);
  return item;
}

// The line that says what to do next, and the way there.

import { addKeys } from "./keys.js";
import { openScene } from "./frames.js";
import { app, change, frame, onChange } from "./store.js";

const text = document.getElementById("next-text");
const button = document.getElementById("next-go");
const actions = {};

// Parts of the page say what an action of the server's advice does here.
export function onAction(name, does) {
  actions[name] = does;
}

export function setUp() {
  button.addEventListener("click", go);
  addKeys([[["g"], "go to where the next step is", go]]);
  onChange(draw, () => [app.next]);
}

async function go() {
  const step = app.next;
  if (!step) return;
  if (step.action && actions[step.action]) return actions[step.action](step);
  const part = { view: step.view || "mark" };
  if (step.keypoint != null) part.keypoint = step.keypoint;
  if (step.scene != null) await openScene(step.scene, step.frame ?? suggested(step.scene), part); else change(part);
}

// The first suggested frame of another scene; null = where one was in it.
const suggested = (name) => (name === app.scene ? frame() : app.suggestions[name]?.[0]?.frame ?? null);

function draw() {
  if (!app.next) return;
  text.textContent = app.next.text;
  button.hidden = app.next.scene == null && !app.next.action && !app.next.view;
  button.firstChild.textContent = app.next.label || "Take me there ";
}

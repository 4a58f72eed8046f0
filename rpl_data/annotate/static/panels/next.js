// The line that says what to do next, and the way there.

import { addKeys } from "./keys.js";
import { openScene } from "../image/frames.js";
import { app, change, clicksIn, frame, onChange } from "../state/store.js";

const text = document.getElementById("next-text");
const button = document.getElementById("next-go");
const actions = {};

// Parts of the page say what an action of the server's advice does here.
export function onAction(name, does) {
  actions[name] = does;
}

export function setUp() {
  button.addEventListener("click", go);
  addKeys([[["g"], "go to where the next step is, or make what it says", go]]);
  onChange(draw, () => [app.next, app.pendingGrasp]);
}

// While a grasp is being marked, its own next click; a result that arrives meanwhile does not hide it.
const step = () => app.pendingGrasp || app.next;

async function go() {
  const wanted = step();
  if (!wanted) return;
  if (wanted.action && actions[wanted.action]) return actions[wanted.action](wanted);
  if (wanted.scene == null && !wanted.view) return; // there is no place to go to
  const part = { view: wanted.view || "mark" };
  if (wanted.keypoint != null) part.keypoint = wanted.keypoint;
  if (wanted.scene != null) await openScene(wanted.scene, wanted.frame ?? unmarked(wanted.scene, wanted.keypoint), part); else change(part);
}

// The frame that is open, or else the first suggested one, in which the keypoint is not marked yet: another click in a
// frame where it is would move that one. null = where one was in the scene.
function unmarked(name, keypoint) {
  const known = (app.suggestions[name] || []).map((suggestion) => suggestion.frame);
  const taken = new Set(clicksIn(name).filter((c) => c.keypoint === keypoint).map((c) => c.frame));
  return (name === app.scene ? [frame(), ...known] : known).find((index) => !taken.has(index)) ?? (name === app.scene ? frame() : null);
}

function draw() {
  const wanted = step();
  if (!wanted) return;
  text.textContent = text.title = wanted.text; // two lines are shown; of a longer one, the rest by scrolling or pointing
  button.hidden = app.pendingGrasp != null || (wanted.scene == null && !wanted.action && !wanted.view);
  button.firstChild.textContent = wanted.label || "Take me there ";
}

// The queue of actions on their way to the log. The page shows an action at once; it counts as saved
// when the server has it on the disk. What was not saved stays here and is sent again.

import { get, objectPath, post } from "./api.js";
import { app, change, isSkipped } from "./store.js";

const tab = Math.random().toString(36).slice(2, 10);
const queue = []; // {object, action}
let number = 0, sending = false, solving = false;

export const unsaved = () => queue.length;

// Do something to the current object: shown now, saved as soon as the server can be reached.
export function act(action) {
  const object = app.state.object;
  queue.push({ object, action: { ...action, id: `${tab}-${number++}` } });
  showNow(action);
  change({ waiting: queue.length });
  return send();
}

async function send() {
  if (sending) return;
  sending = true;
  while (queue.length) {
    const { object, action } = queue[0];
    try {
      take(await post(objectPath(object), { seen: seenOf(object), actions: [action] }), 1);
    } catch (error) {
      if (!(await failed(error, object))) break;
    }
  }
  sending = false;
  change({ waiting: queue.length });
  if (!queue.length) await solve();
}

const seenOf = (object) => (app.state?.object === object ? app.state.revision : 0);

// Take an answer of the server, with what is still waiting shown on top of it.
function take(state, answered = 0) {
  queue.splice(0, answered);
  if (app.state?.object === state.object) {
    change({ state, offline: false, waiting: queue.length });
    for (const { object, action } of queue) if (object === state.object) showNow(action);
  }
}

// True when the queue may go on.
async function failed(error, object) {
  if (error.status === 507) {
    alertOnce(`Not saved: ${error.message}. ${queue.length} action(s) are kept in this page.`, true);
    return false;
  }
  if (error.status) {
    queue.shift();
    alertOnce(error.status === 409 ? error.message : `Not done: ${error.message}`);
    take(await get(objectPath(object)));
    return true;
  }
  change({ offline: true });
  setTimeout(send, 1000);
  return false;
}

export function alertOnce(text, again = false) {
  change({ alert: { text, again } });
}

export function sendAgain() {
  change({ alert: null });
  return send();
}

// Load an object, or its newer state.
export async function load(name) {
  const state = await get(objectPath(name));
  if (app.state?.object === name && queue.length) return;
  change({ state, keypoint: Math.min(app.keypoint, state.keypoints.length - 1) });
  await solve();
}

// Ask for the result of what is saved; a newer question replaces a waiting one.
async function solve() {
  if (solving) return;
  solving = true;
  try {
    let asked;
    do {
      asked = app.state.revision;
      const object = app.state.object;
      const result = await get(`${objectPath(object)}/result`);
      if (object === app.state.object) change({ result, next: result.next });
    } while (asked !== app.state.revision);
  } catch (error) {
    if (error.status) alertOnce(error.message); else change({ offline: true });
  }
  solving = false;
}

// What an action does to the clicks, before the server has answered.
function showNow(action) {
  const same = (c) => c.keypoint === action.keypoint && c.scene === action.scene && c.frame === action.frame;
  const state = { ...app.state };
  if (action.op === "click" || action.op === "move") {
    const { op, ...mark } = action;
    state.clicks = [...state.clicks.filter((c) => !same(c)), mark];
    state.skipped = state.skipped.filter(([k, s]) => k !== action.keypoint || s !== action.scene);
  } else if (action.op === "delete") {
    state.clicks = state.clicks.filter((c) => !same(c));
  } else if (action.op === "skip" && !isSkipped(action.keypoint, action.scene)) {
    state.skipped = [...state.skipped, [action.keypoint, action.scene]];
  } else if (action.op === "unskip") {
    state.skipped = state.skipped.filter(([k, s]) => k !== action.keypoint || s !== action.scene);
  }
  change({ state });
}

window.addEventListener("beforeunload", (event) => {
  if (queue.length) event.preventDefault();
});

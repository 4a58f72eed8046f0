// The queue of actions on their way to the log. The page shows an action at once; it counts as saved
// when the server has it on the disk. What was not saved stays here, over a reload too, and is sent again.

import { get, objectPath, post } from "./api.js";
import { app, change, isSkipped, keypointTitle } from "./store.js";

const KEPT = "rpl-unsaved"; // in the tab's own storage: {queue, seen}
const kept = JSON.parse(sessionStorage.getItem(KEPT) || "{}");
const queue = kept.queue || []; // {object, action, text}
const seen = kept.seen || {}; // the revision of each object that what is in the queue was done on
let sending = null, solving = false; // sending: the promise that ends when what waited is sent, or is stuck
let wanted = null; // the object that was asked for last: answers about another one come too late

app.waiting = queue.length; // before anything is drawn: a page that was reloaded may not say that all is saved

const waiting = (object) => queue.filter((entry) => entry.object === object);
const newId = () => [0, 0].map(() => Math.random().toString(36).slice(2)).join("");

function queueChanged() {
  sessionStorage.setItem(KEPT, JSON.stringify({ queue, seen: queue.length ? seen : {} }));
  change({ waiting: queue.length });
}

// Do something to the current object: shown now, saved as soon as the server can be reached.
export function act(action) {
  queue.push({ object: app.state.object, action: { ...action, id: newId() }, text: described(action) });
  showNow(action);
  queueChanged();
  return send();
}

function described({ op, keypoint, scene, frame }) {
  if (keypoint === undefined) return op;
  return `${op} ${keypointTitle(keypoint)} in scene ${scene}${frame === undefined ? "" : `, frame ${frame}`}`;
}

// Send the waiting actions, in order.
async function send() {
  if (sending) return;
  sending = sendAll();
  try {
    await sending;
  } finally {
    sending = null;
    queueChanged();
  }
  if (!queue.length) await solve();
}

async function sendAll() {
  while (queue.length && (await sendFirst()));
}

// Returns true when the queue may continue.
async function sendFirst() {
  const { object, action } = queue[0];
  try {
    take(await post(objectPath(object), { seen: seen[object] ?? 0, actions: [action] }), 1);
    return true;
  } catch (error) {
    if (!error.status) return lost();
    if (error.status >= 500) return notSaved(error);
    return refused(error, object);
  }
}

function lost() {
  change({ offline: true });
  setTimeout(send, 1000);
  return false;
}

function notSaved(error) {
  const list = [...new Set(queue.map((entry) => entry.text))].slice(0, 3).join("; ");
  const more = queue.length > 3 ? ` and ${queue.length - 3} more` : "";
  alertOnce(`Not saved: ${error.message}. Kept in this page: ${list}${more}.`, true);
  return false;
}

// Drop actions that the server will never accept. After a conflict, later actions on top of it go too.
async function refused(error, object) {
  const gone = error.status === 409 ? waiting(object) : [queue[0]];
  for (const entry of gone) queue.splice(queue.indexOf(entry), 1);
  const texts = [...new Set(gone.map((entry) => entry.text))].join("; ");
  alertOnce(`Not done (${texts}): ${error.message}`);
  try {
    take(await get(objectPath(object)));
    return true;
  } catch (again) {
    if (!again.status) return lost();
    alertOnce(again.message); // the object is gone: the workspace was replaced
    queue.splice(0);
    return false;
  }
}

// Show an answer of the server, with the waiting actions on top of it.
function take(state, answered = 0) {
  queue.splice(0, answered);
  seen[state.object] = state.revision;
  if (answered && app.alert?.again) change({ alert: null });
  change({ offline: false });
  show(state);
  queueChanged();
}

function show(state) {
  if (app.state?.object !== state.object) return;
  change({ state, keypoint: Math.max(0, Math.min(app.keypoint, state.keypoints.length - 1)) });
  for (const { action } of waiting(state.object)) showNow(action);
}

export function alertOnce(text, again = false) {
  change({ alert: { text, again } });
}

// What was done, to be read and closed.
export const tell = (text) => change({ alert: { text, good: true } });

export async function sendAgain() {
  change({ alert: null });
  await sending; // what is under way was asked before, and may fail still
  return send();
}

// Load an object, or its newer state. Waiting actions were made on the older one. Returns false where
// another object was asked for meanwhile.
export async function load(name) {
  wanted = name;
  const state = await get(objectPath(name));
  if (wanted !== name) return false;
  const waits = waiting(name).length > 0;
  if (app.state?.object === name && waits) return true;
  if (!waits) seen[name] = state.revision;
  change({ state });
  show(state);
  if (queue.length) send(); else solve();
  return true;
}

const question = () => `${app.state?.object} ${app.state?.revision}`;

// Request the result of the saved actions; a newer request replaces a waiting one.
async function solve() {
  if (solving || !app.state) return; // no object is open while another one is loaded
  solving = true;
  let asked;
  try {
    do {
      asked = question();
      await askFor(app.state.object, asked);
    } while (app.state && asked !== question());
  } catch (error) {
    if (error.status) alertOnce(error.message); else change({ offline: true });
  } finally {
    solving = false;
  }
}

// The solution first; then, when nothing was done since, what its clicks say about one another.
async function askFor(object, asked) {
  for (const query of ["?checked=false", ""]) {
    const result = await get(`${objectPath(object)}/result${query}`);
    if (object === app.state?.object) change({ result, next: result.next });
    if (!result.checking || asked !== question()) return;
  }
}

// What an action does to the clicks, before the server has answered.
function showNow(action) {
  const same = (c) => c.keypoint === action.keypoint && c.scene === action.scene && c.frame === action.frame;
  const state = { ...app.state };
  if (action.op === "undo") state.redo ||= "the last action";
  else if (action.op !== "redo") [state.undo, state.redo] = ["the last action", null];
  if (action.op === "click" || action.op === "move") {
    const { op, id, ...mark } = action;
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

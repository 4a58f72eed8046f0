// The state of the page; panels are redrawn after a change.

import { sceneOf } from "./api.js";

export const app = {
  workspace: null, // {name, scenes, objects}
  scenes: {}, // details by name, once requested
  poses: {}, // by scene: {index: Int32Array, table: Float32Array of 8 a row}
  state: null, // the object's log from the server, with the actions on their way there
  result: null, // result of the last revision that was solved
  suggestions: {}, // by scene: [{frame, why}]
  next: null, // {text, scene, frame, keypoint, view, action}
  scene: null, row: 0, keypoint: 0, view: "mark",
  shown: null, // "scene/frame" of the picture on the screen
  hurried: false, // while the user scrubs or plays
  cursor: null, // {u, v} in image pixels
  showModel: true, showMask: false, showNames: false, brightness: 1,
  waiting: 0, offline: false, job: null, fresh: {},
};

const listeners = [];
let planned = false;

// Call a listener after changes; with `inputs`, only when one of the values it gives is another one.
export function onChange(listener, inputs = null) {
  let before = null;
  listeners.push(() => {
    const now = inputs?.();
    if (now && before && now.every((value, i) => Object.is(value, before[i]))) return;
    before = now;
    listener(app);
  });
}

export function change(part) {
  Object.assign(app, part);
  if (planned) return;
  planned = true;
  queueMicrotask(() => {
    planned = false;
    for (const listener of listeners) listener();
  });
}

// The scenes; behind each, the further instances of the object that were marked in it, or are asked for.
export function places() {
  const named = [...(app.state?.clicks || []).map((c) => c.scene), ...Object.keys(app.result?.scene_from_object || {}), app.scene];
  const further = [...new Set(named)].filter((place) => place?.includes("/")).sort();
  return (app.workspace?.scenes || []).flatMap((name) => [name, ...further.filter((place) => sceneOf(place) === name)]);
}

export const scene = () => app.scenes[app.scene] || null;
export const poses = () => app.poses[app.scene] || null;
export const frame = () => (poses() ? poses().index[app.row] : null);

// The row of a frame in its scene; the nearest one when that frame has no pose.
export function rowOf(sceneName, index) {
  const rows = app.poses[sceneName]?.index || [];
  let low = 0, high = rows.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[middle] < index) low = middle + 1; else high = middle;
  }
  return low;
}

export const clicksIn = (sceneName, frameIndex) =>
  (app.state?.clicks || []).filter((c) => isIn(c, sceneName) && (frameIndex == null || c.frame === frameIndex));

// Where the object is moved while it is filmed, each clicked frame is a place of its own: 00/@12, 00/2@12.
const isIn = (click, place) =>
  click.scene === place || click.scene === `${place}${place?.includes("/") ? "" : "/"}@${click.frame}`;

export const residualOf = (click) =>
  app.result?.clicks.find((r) => r.keypoint === click.keypoint && r.scene === click.scene && r.frame === click.frame);

// A keypoint's name; its number where it has no name of its own.
export const keypointName = (k) => {
  const name = app.state?.keypoints[k]?.name;
  return name === undefined || name === String(k) ? `keypoint ${k}` : name;
};

// Number and name, as the messages of the server and files of clicks have them.
export const keypointTitle = (k) => (keypointName(k) === `keypoint ${k}` ? `keypoint ${k}` : `${k} ${keypointName(k)}`);

export const counted = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;

export const isSkipped = (keypoint, sceneName) =>
  (app.state?.skipped || []).some(([k, s]) => k === keypoint && s === sceneName);

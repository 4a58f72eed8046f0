// Points around the object in every scene, and its dense model: fetched once, moved by every new result.

import { get, objectPath } from "../state/api.js";
import { apply, invert, multiply } from "../image/camera.js";
import { app, change, clicksIn, onChange, places } from "../state/store.js";

const clouds = new Map(); // scene -> {key, points, colors}
let model = null, asked = null, placedFor; // the result it was placed for

export function setUp() {
  onChange(loadModel);
  onChange(placeModel);
}

export const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
export const floats = (text) => new Float32Array(bytes(text).buffer);

// After a build, what was fetched is out of date.
export function forget() {
  clouds.clear();
  model = asked = null;
  change({ dense: null });
}

async function loadModel() {
  const object = app.state?.object;
  if (!object || asked === object) return;
  asked = object;
  model = null;
  const found = await get(`${objectPath(object)}/dense`).catch(() => null);
  if (asked !== object) return;
  model = found && {
    sceneFromObject: found.places, points: floats(found.points),
    colors: found.colors && bytes(found.colors), triangles: new Uint16Array(bytes(found.triangles).buffer),
  };
  placedFor = undefined;
  change({});
}

// app.dense: the vertices of the dense model in the object frame of the newest result.
function placeModel() {
  if (!app.state || placedFor === app.result) return;
  placedFor = app.result;
  const scene = Object.keys(app.result?.scene_from_object || {}).find((name) => model?.sceneFromObject[name]);
  const moved = scene && multiply(invert(app.result.scene_from_object[scene]), model.sceneFromObject[scene]);
  change({ dense: model && rows(model.points, moved) });
}

export const denseModel = () => (app.dense && model ? { ...model, points: app.dense } : null);

function rows(flat, matrix) {
  const found = [];
  for (let i = 0; i < flat.length; i += 3) {
    const point = [flat[i], flat[i + 1], flat[i + 2]];
    found.push(matrix ? apply(matrix, point) : point);
  }
  return found;
}

// Scenes with something to show: the placed ones in the object frame; while there is none, the current
// scene in its own frame.
export function shownScenes() {
  const sceneFromObject = app.result?.scene_from_object || {};
  const placed = places().filter((name) => sceneFromObject[name]);
  if (placed.length) return placed.map((name) => ({ name, moved: invert(sceneFromObject[name]) }));
  return clicksIn(app.scene).length ? [{ name: app.scene, moved: null }] : [];
}

// The moved points of a scene; null until they have loaded.
export function cloud({ name, moved }) {
  const known = (app.result?.points_m || []).filter(Boolean).length;
  const key = `${app.state.object}/${moved ? `placed ${known}` : clicksIn(name).length}`;
  const kept = clouds.get(name);
  if (kept?.key !== key) fetchCloud(name, key, kept);
  return kept?.points ? { points: rows(kept.points, moved), colors: kept.colors } : null;
}

async function fetchCloud(name, key, before) {
  const object = app.state.object;
  clouds.set(name, key.startsWith(`${object}/`) && before?.object === object ? { ...before, key } : { key, object });
  const found = await get(`${objectPath(object)}/surfaces/${encodeURIComponent(name)}`).catch(() => null);
  if (clouds.get(name)?.key !== key) return;
  clouds.set(name, found ? { key, object, points: floats(found.points), colors: bytes(found.colors) } : { key, object });
  change({ cloudsLoaded: (app.cloudsLoaded || 0) + 1 });
}

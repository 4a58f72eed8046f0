// Scenes, poses and pictures, fetched when they are first needed.

import { binary, get, objectPath, picturePath, sceneOf, scenePath } from "../state/api.js";
import { app, change, clicksIn, frame, poses, rowOf, scene } from "../state/store.js";

const MOST_PICTURES = 48;
const pictures = new Map(); // address -> {image, ready}

const PATIENCE_MS = 600;

// Open a scene at a frame; by default the one last shown, last marked, or best to begin with. Returns false where
// another one was asked for meanwhile: a click would land in a scene that nobody waits for any more.
const leftAt = {};
let openings = 0;
export async function openScene(name, index = null, part = {}) {
  const opening = ++openings;
  const wanted = index ?? leftAt[name] ?? clicksIn(name).at(-1)?.frame;
  const [first] = await Promise.all([wanted === undefined ? beginning(name) : wanted, ensureScene(name)]);
  if (opening !== openings) return false;
  if (app.scene !== null) leftAt[app.scene] = frame();
  const row = first === null ? app.poses[name].index.length >> 1 : rowOf(name, first);
  change({ ...part, scene: name, row });
  return true;
}

// The suggested frame that is near and sharp; null when the server does not answer soon.
async function beginning(name) {
  const late = new Promise((resolve) => setTimeout(resolve, PATIENCE_MS, null));
  const found = app.suggestions[name] || (await Promise.race([suggestions(name), late]));
  return (found?.find(({ why }) => why.startsWith("near")) || found?.[0])?.frame ?? null;
}

// Frames of a scene worth marking; null when the server cannot say.
export async function suggestions(name) {
  const address = `${objectPath(app.state.object)}/suggestions/${encodeURIComponent(name)}`;
  const found = await get(address).catch(() => null);
  if (found) change({ suggestions: { ...app.suggestions, [name]: found } });
  return found;
}

export async function ensureScene(name) {
  if (app.poses[name]) return;
  const [details, poses] = await fetchScene(name);
  for (const place of [name, sceneOf(name)]) {
    app.scenes[place] = details;
    app.poses[place] = poses;
  }
}

async function fetchScene(name) {
  const [details, buffer] = await Promise.all([get(scenePath(name)), binary(`${scenePath(name)}/poses`)]);
  const table = new Float32Array(buffer);
  const index = Int32Array.from({ length: table.length / 8 }, (_, row) => table[8 * row]);
  return [details, { index, table }];
}

// After a build: camera poses may be better now, and a scene may have been cut.
export async function refreshScenes() {
  const stays = app.workspace.scenes.includes(sceneOf(app.scene)), name = stays ? app.scene : app.workspace.scenes[0];
  const index = stays ? frame() : 0, [details, poses] = await fetchScene(name);
  Object.assign(app, { scenes: { [name]: details, [sceneOf(name)]: details }, poses: { [name]: poses, [sceneOf(name)]: poses }, suggestions: {} });
  change({ scene: name, row: rowOf(name, index) });
}

export function goToRow(row) {
  const count = poses()?.index.length || 0;
  if (count) change({ row: Math.max(0, Math.min(count - 1, row)) });
}

// A picture of a frame; `ready` is set once it can be drawn. `then` is called when it has loaded.
export function picture(sceneName, index, width, then) {
  const address = picturePath(sceneName, index, width);
  let entry = pictures.get(address);
  if (entry) {
    pictures.delete(address);
    pictures.set(address, entry); // used last
    if (then && !entry.ready) entry.waiting.push(then);
    return entry;
  }
  const image = new Image();
  entry = { image, of: `${sceneName}/${index}`, ready: false, failed: false, waiting: then ? [then] : [] };
  image.decoding = "async";
  image.onload = () => done(entry, true);
  image.onerror = () => done(entry, false);
  image.src = address;
  pictures.set(address, entry);
  while (pictures.size > MOST_PICTURES) pictures.delete(pictures.keys().next().value);
  return entry;
}

function done(entry, ready) {
  entry.ready = ready;
  entry.failed = !ready;
  for (const then of entry.waiting.splice(0)) then();
}

// Stop fetching pictures of other frames, which would come first on a slow link.
export function onlyFetch(shown) {
  for (const [address, entry] of pictures) {
    if (entry.ready || entry.failed || entry.of === shown) continue;
    pictures.delete(address);
    entry.image.onload = entry.image.onerror = null;
    entry.image.src = "";
  }
}

const HURRIED_PX = 320;

// The width to request: that of the screen, 0 = full size; less while playing or scrubbing.
export function wantedWidth(zoom) {
  if (app.hurried && scene().width > HURRIED_PX) return HURRIED_PX;
  const pixels = scene().width * zoom * (window.devicePixelRatio || 1);
  return pixels >= scene().width ? 0 : [320, 640, 960, 1280, 1920].find((w) => w >= pixels) || 0;
}

// Neighbouring frames are fetched while a frame is shown.
let resting = null;
export function fetchNeighbours(width) {
  clearTimeout(resting);
  const [name, row, rows] = [app.scene, app.row, poses().index];
  resting = setTimeout(() => {
    for (const step of [1, -1, 2]) {
      if (app.scene === name && app.row === row && rows[row + step] !== undefined)
        picture(name, rows[row + step], width);
    }
  }, 150);
}

// Depth -----------------------------------------------------------------------------------------------

const TILE_PX = 128, MARGIN_PX = 16, MOST_TILES = 60;
const tiles = new Map(); // "scene/frame/column/row" -> {data, left, top, side}; null while it loads
let asked = null;

// The stored depth around a pixel of the current frame; null until it has loaded.
export function depthAround(u, v, then) {
  const [column, row] = [u, v].map((value) => Math.floor(Math.max(0, value) / TILE_PX));
  const key = `${app.scene}/${frame()}/${column}/${row}`;
  if (tiles.has(key)) return tiles.get(key);
  asked?.abort();
  asked = new AbortController();
  tiles.set(key, null);
  binary(`${scenePath(app.scene)}/frames/${frame()}.depth?column=${column}&row=${row}`, asked.signal).then(
    (buffer) => {
      const [left, top] = [column * TILE_PX - MARGIN_PX, row * TILE_PX - MARGIN_PX];
      tiles.set(key, { data: new Uint16Array(buffer), left, top, side: TILE_PX + 2 * MARGIN_PX });
      while (tiles.size > MOST_TILES) tiles.delete(tiles.keys().next().value);
      then();
    },
    () => tiles.delete(key),
  );
  return null;
}

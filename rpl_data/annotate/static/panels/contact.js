// The contact sheet: labels on small pictures, one page of a scene at a time; a picture opens its frame.

import { get, post, sceneOf } from "../state/api.js";
import { openScene } from "../image/frames.js";
import { element, refill } from "./dom.js";
import { addKeys } from "./keys.js";
import { alertOnce } from "../state/log.js";
import { onNews } from "../state/news.js";
import { app, change, counted, onChange } from "../state/store.js";

const PAGE = 48;
const section = document.getElementById("labels");
const head = element("div", { className: "solid-head row" });
const grid = element("div", { id: "sheet" });
let scene = null, frames = null, order = "worst", whole = false, page = 0, asked = null;

export function setUp() {
  section.append(head, grid);
  onNews("left_out", async (name) => { if (name === scene) await load(); });
  onChange(follow, () => [app.view, app.scene, app.built, app.workspace]);
  addKeys([[["PageUp", "PageDown"], "in the labels: previous, next scene", null]]);
}

const labelsPath = (name) => `/api/labels/${encodeURIComponent(name)}`;

// The sheet shows the scene that is open; it is asked for when the view is shown and after every build.
async function follow() {
  if (app.view !== "labels" || !app.workspace || app.scene === null) return;
  const key = `${app.scene}/${app.built}`;
  if (key === asked) return;
  asked = key;
  if (scene !== sceneOf(app.scene)) page = 0;
  scene = sceneOf(app.scene);
  await load();
}

async function load() {
  try {
    ({ frames } = await get(labelsPath(scene)));
  } catch (error) {
    frames = [];
    alertOnce(error.message);
  }
  draw();
}

const worstFirst = (a, b) => (a.quality ?? 2) - (b.quality ?? 2) || a.frame - b.frame;
const sorted = () => (order === "worst" ? [...frames].sort(worstFirst) : frames);

function draw() {
  const shown = sorted().slice(page * PAGE, (page + 1) * PAGE);
  drawHead();
  grid.replaceChildren(...(frames.length ? shown.map(picture) : [element("p", { className: "empty", textContent: nothing() })]));
  grid.scrollTop = 0;
}

const placedHere = () => Boolean(app.result?.scene_from_object[scene]);
const nothing = () => (app.fresh?.label ? (placedHere() ? `No frame of scene ${scene} is labelled: the object is placed there, but its images do not show it.`
  : `No frame of scene ${scene} is labelled: the object has no pose there; click at least 3 of its keypoints.`)
  : "No labels yet: make them with the button on the right (X). Then every frame is shown here with its labels.");

function drawHead() {
  const left = frames.filter((f) => f.left_out).length, pages = Math.ceil(frames.length / PAGE);
  const scenes = element("select", { ariaLabel: "scene", id: "sheet-scene" }, ...app.workspace.scenes.map((name) => new Option(`scene ${name}`, name)));
  scenes.value = scene;
  scenes.addEventListener("change", () => openScene(scenes.value));
  const sort = element("select", { ariaLabel: "order", id: "sheet-order" }, new Option("worst first", "worst"), new Option("in order of time", "time"));
  sort.value = order;
  sort.addEventListener("change", () => { order = sort.value; page = 0; draw(); });
  const turn = (by) => element("button", { textContent: by < 0 ? "◀ page" : "page ▶", disabled: page + by < 0 || page + by >= pages, onclick: () => { page += by; draw(); } });
  const part = element("select", { ariaLabel: "part of the picture", id: "sheet-part" }, new Option("around the object", ""), new Option("whole frames", "whole"));
  part.value = whole ? "whole" : "";
  part.addEventListener("change", () => { whole = Boolean(part.value); draw(); });
  const count = `${counted(frames.length, "frame")}${left ? `, ${left} left out of the export` : ""}${pages > 1 ? ` · page ${page + 1} of ${pages}` : ""}`;
  refill(head, scenes, sort, part, ...(pages > 1 ? [turn(-1), turn(1)] : []), element("span", { className: "quiet", textContent: count }));
}

function picture(item) {
  const { frame, quality, left_out } = item;
  const image = element("img", { loading: "lazy", alt: `labels of frame ${frame}`, src: `${labelsPath(scene)}/${frame}.jpg?width=320&whole=${whole}&v=${app.built || 0}` });
  const { width, height } = app.scenes[scene];
  image.style.aspectRatio = whole ? `${width} / ${height}` : "4 / 3";
  const open = element("button", { className: "open", title: "open this frame to correct its clicks" }, image);
  open.addEventListener("click", () => openScene(scene, frame, { view: "mark" }));
  const box = element("input", { type: "checkbox", checked: !left_out, ariaLabel: `export frame ${frame}` });
  box.addEventListener("change", () => leaveOut(frame, !box.checked));
  const mark = quality == null ? ["quiet", "no object"] : quality < 0.5 ? ["bad", `quality ${quality.toFixed(2)}`] : ["quiet", `quality ${quality.toFixed(2)}`];
  return element("figure", { className: left_out ? "out" : "" }, open,
    element("figcaption", {}, element("label", {}, box, ` frame ${frame}`),
      element("span", { className: `small ${mark[0]}`, title: "quality: 0.5 stands for an expected error of 5 px, 0.25 for 15 px; frames below the least quality are left out", textContent: mark[1] })));
}

async function leaveOut(frame, left_out) {
  try {
    ({ frames } = await post(labelsPath(scene), { frame, left_out }));
    change({ fresh: { ...app.fresh, export: false } });
  } catch (error) {
    alertOnce(error.message);
  }
  draw();
}

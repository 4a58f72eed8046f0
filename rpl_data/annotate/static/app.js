// The page: loads the workspace, connects the parts, and keeps object, scene and frame in the address bar.

import { get, sceneOf } from "./state/api.js";
import * as canvas from "./image/canvas.js";
import * as contact from "./panels/contact.js";
import * as crop from "./solid/crop.js";
import * as dense from "./solid/dense.js";
import * as distances from "./solid/distances.js";
import * as files from "./panels/files.js";
import { openScene } from "./image/frames.js";
import * as grasp from "./panels/grasp.js";
import * as jobs from "./panels/jobs.js";
import * as keypoints from "./panels/keypoints.js";
import * as keys from "./panels/keys.js";
import * as legend from "./image/legend.js";
import * as log from "./state/log.js";
import * as loupe from "./image/loupe.js";
import * as mask from "./image/mask.js";
import { keep, kept } from "./state/kept.js";
import { listen } from "./state/news.js";
import * as model from "./panels/model.js";
import * as next from "./panels/next.js";
import * as opening from "./panels/open.js";
import { newObject, openObject } from "./panels/objects.js";
import * as results from "./panels/results.js";
import * as scenes from "./panels/scenes.js";
import * as solid from "./solid/solid.js";
import * as path from "./solid/path.js";
import { app, change, frame, onChange } from "./state/store.js";
import * as timeline from "./image/timeline.js";
import * as tour from "./panels/tour.js";

const by = (id) => document.getElementById(id);

async function start() {
  setUpTheme();
  for (const part of [legend, timeline, keypoints, scenes, results, next, keys, files, mask]) part.setUp();
  for (const part of [dense, solid, path, distances, crop, jobs, contact, model, grasp, opening, tour]) part.setUp();
  canvas.setUp({ place: keypoints.place, move: keypoints.move });
  onChange(() => { canvas.draw(); loupe.draw(); });
  onChange(drawHead, () => [app.workspace, app.state, app.waiting, app.offline, app.alert, app.brightness, app.showModel, app.showMask, app.showNames, app.view]);
  onChange(drawAlert, () => [app.alert]);
  onChange(rememberPlace, () => [app.state, app.scene, app.row, app.keypoint]);
  setUpButtons();
  await open();
  listen();
}

// Open the workspace at the object, scene and frame that the address names.
async function open() {
  const workspace = await get("/api/workspace");
  const address = new URLSearchParams(location.hash.slice(1));
  change({ workspace });
  const object = workspace.objects.includes(address.get("object")) ? address.get("object") : workspace.objects[0];
  const scene = workspace.scenes.includes(sceneOf(address.get("scene") ?? "")) ? address.get("scene") : workspace.scenes[0];
  const index = address.has("frame") ? Number(address.get("frame")) : null;
  if (object === undefined || scene === undefined) throw new Error("this workspace has no object or no scene");
  change({ keypoint: Number(address.get("keypoint") || 0) });
  await log.load(object);
  await openScene(scene, index);
  if (!address.has("keypoint")) keypoints.selectOpen();
}

function rememberPlace() {
  if (!app.state || frame() === null) return;
  const address = new URLSearchParams({ object: app.state.object, scene: app.scene, frame: frame(), keypoint: app.keypoint });
  if (location.hash !== `#${address}`) history.replaceState(null, "", `#${address}`);
}

function drawHead() {
  by("workspace").textContent = app.workspace?.name || "rpl annotate";
  const objects = app.workspace?.objects || [], select = by("object");
  if (select.options.length !== objects.length) select.replaceChildren(...objects.map((name) => new Option(name, name)));
  if (app.state) select.value = app.state.object;
  const saved = by("saved");
  const stuck = app.offline || app.alert?.again;
  saved.textContent = app.offline ? `connection lost · ${app.waiting} not saved`
    : app.waiting ? (stuck ? `${app.waiting} not saved` : `saving ${app.waiting} …`) : "all saved";
  saved.className = stuck ? "bad" : app.waiting ? "warn" : "good";
  for (const name of ["undo", "redo"]) {
    by(name).disabled = !app.state?.[name];
    by(name).title = app.state?.[name] ? `${name} ${app.state[name]}` : `nothing to ${name}`;
  }
  by("brightness").value = app.brightness;
  by("show-model").checked = app.showModel;
  by("show-mask").checked = app.showMask;
  by("show-names").checked = app.showNames;
  for (const tab of document.querySelectorAll("#views button")) tab.setAttribute("aria-selected", tab.dataset.view === app.view);
  for (const view of document.querySelectorAll(".view")) view.hidden = view.id !== app.view;
}

function drawAlert() {
  by("alert").hidden = !app.alert;
  if (!app.alert) return;
  by("alert").className = app.alert.good ? "told" : "";
  const again = app.alert.again ? [button("Try again", log.sendAgain)] : [];
  by("alert").replaceChildren(Object.assign(document.createElement("span"), { textContent: app.alert.text }),
    ...again, button("Close", () => change({ alert: null })));
}

function button(text, does) {
  const made = Object.assign(document.createElement("button"), { textContent: text });
  made.addEventListener("click", does);
  return made;
}

function setUpButtons() {
  const on = (id, does, event = "click") => by(id).addEventListener(event, does);
  on("undo", keys.undo);
  on("redo", keys.redo);
  on("zoom-in", () => canvas.zoomBy(1.5, ...canvas.cursorOnScreen()));
  on("zoom-out", () => canvas.zoomBy(1 / 1.5, ...canvas.cursorOnScreen()));
  on("zoom-fit", canvas.fit);
  on("brightness", (event) => change({ brightness: Number(event.target.value) }), "input");
  on("show-model", (event) => change({ showModel: event.target.checked }), "change");
  on("show-mask", (event) => change({ showMask: event.target.checked }), "change");
  on("show-names", (event) => change({ showNames: event.target.checked }), "change");
  on("object", (event) => openObject(event.target.value), "change");
  on("new-object", newObject);
  for (const tab of document.querySelectorAll("#views button")) tab.addEventListener("click", () => change({ view: tab.dataset.view }));
}

function setUpTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const use = (theme) => { document.documentElement.dataset.theme = theme; change({ theme }); };
  use(kept("theme") || (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", () => kept("theme") || use(dark.matches ? "dark" : "light"));
  const turn = () => {
    const name = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    keep("theme", name);
    use(name);
  };
  by("theme").addEventListener("click", turn);
  keys.addKeys([[["t"], "light or dark", turn]]);
}

start().catch((error) => log.alertOnce(`The page could not be loaded: ${error.message}`));

// A known model: keypoints from a file, or picked on a mesh in the 3D view. Then three
// clicks place the object in a scene.

import { get, objectPath } from "../state/api.js";
import { bytes, floats } from "../solid/dense.js";
import { ask, element, refill } from "./dom.js";
import { addEntry, chooseFile } from "./files.js";
import { selectNext } from "./keypoints.js";
import { act, alertOnce } from "../state/log.js";
import { onNews } from "../state/news.js";
import { addTraces, insteadOf, labelFont, onPick, stage, xyz } from "../solid/solid.js";
import { app, change, keypointTitle, onChange } from "../state/store.js";

const ACCEPTED = ".txt,.pp,.ply,.obj,.off,.stl";
const panel = element("div", { id: "model-panel" });
let mesh = null, asked = null;

export function setUp() {
  addEntry("Load a known model", "sparse_model.txt, MeshLab's .pp, or a mesh to pick its keypoints on", load);
  addEntry("Export the model", "sparse_model.txt of RapidPoseLabels, with the grasp where there is one", exportModel);
  onNews("mesh", (name) => { if (name === app.state?.object) asked = null; change({}); });
  stage.append(panel);
  insteadOf(picking);
  onPick(pick);
  addTraces(() => [], () => [app.picking, mesh, app.state?.known_points]);
  onChange(fetchMesh, () => [app.state?.object, asked]);
  onChange(draw, () => [app.picking, mesh, app.state?.known_points, app.keypoint, app.state?.object, Boolean(app.result?.points_m)]);
}

async function load() {
  const file = await chooseFile(ACCEPTED);
  if (!file) return;
  let unit = "1";
  if (!/\.txt$/i.test(file.name)) [unit] = (await ask(`The unit of ${file.name}`, [{ label: "metres per unit: 1, or 0.001 for millimetres", value: "1" }])) || [];
  if (!unit) return;
  const query = new URLSearchParams({ file: file.name, metres_per_unit: unit });
  try {
    const answer = await fetch(`${objectPath(app.state.object)}/model?${query}`, { method: "POST", body: file });
    const { actions, error, detail } = await answer.json();
    if (!answer.ok) throw new Error(error || JSON.stringify(detail));
    if (actions.length) await act({ op: "batch", events: actions });
    else startPicking();
  } catch (error) {
    alertOnce(`Not loaded: ${error.message}`);
  }
}

function freeze() {
  const points = app.result?.points_m;
  if (!points) return alertOnce("There is no model yet: mark its keypoints first.");
  act({ op: "model", points, source: "the clicks" });
}

function exportModel() {
  element("a", { href: `${objectPath(app.state.object)}/sparse_model.txt`, download: "sparse_model.txt" }).click();
}

// The mesh of this object, once an object and after a new one was loaded.
async function fetchMesh() {
  const object = app.state?.object;
  if (!object || asked === object) return;
  asked = object;
  const found = await get(`${objectPath(object)}/given`).catch(() => null);
  if (asked !== object) return;
  mesh = found && { points: floats(found.points), triangles: new Uint16Array(bytes(found.triangles).buffer) };
  change({ picking: Boolean(mesh) && Boolean(app.picking) });
}

async function startPicking() {
  asked = null;
  await fetchMesh();
  change({ view: "solid", picking: true });
}

// While keypoints are picked, the 3D view shows the mesh and them, in the mesh's own frame.
function picking() {
  if (!app.picking || !mesh) return null;
  const column = (i) => Array.from({ length: mesh.triangles.length / 3 }, (_, t) => mesh.triangles[3 * t + i]);
  const rows = Array.from({ length: mesh.points.length / 3 }, (_, i) => [...mesh.points.subarray(3 * i, 3 * i + 3)]);
  const picked = (app.state.known_points || []).map((point, k) => ({ point, k })).filter(({ point, k }) => point && app.state.keypoints[k]);
  return [
    {
      type: "mesh3d", name: "pick here", ...xyz(rows), i: column(0), j: column(1), k: column(2), color: "#9aa7ae", hoverinfo: "none", flatshading: true,
      lighting: { ambient: 0.5, diffuse: 0.8, specular: 0.1, roughness: 0.8 },
    },
    {
      type: "scatter3d", name: "picked", mode: "markers+text", ...xyz(picked.map(({ point }) => point)), text: picked.map(({ k }) => keypointTitle(k)),
      hoverinfo: "skip", textfont: labelFont(), marker: { size: 7, color: picked.map(({ k }) => app.state.keypoints[k].color) },
    },
  ];
}

// A vertex, metres, mesh frame: the selected keypoint is there.
function pick(point) {
  if (!app.picking) return;
  const points = app.state.keypoints.map((_, k) => app.state.known_points?.[k] ?? null);
  const first = points[app.keypoint] === null;
  points[app.keypoint] = point;
  act({ op: "model", points, source: "picked on the mesh" });
  if (first) selectNext((k) => points[k] === null);
}

function draw() {
  panel.hidden = !mesh && !app.state?.known_points && !app.result?.points_m;
  if (panel.hidden || !app.state) return;
  if (!mesh && !app.state.known_points) return refill(panel, button("Keep this model", "model-keep", freeze,
    "three clicks then place it in further scenes, without changing it; undo takes that back"));
  const known = (app.state.known_points || []).filter(Boolean).length;
  const text = app.picking ? `Click on the mesh where ${keypointTitle(app.keypoint)} is. ${known} picked, at least 3 are needed.`
    : `This object has a known model of ${known} keypoints${mesh ? " and a mesh" : ""}: three clicks place it in a scene.`;
  const parts = [element("span", { textContent: text })];
  if (mesh) parts.push(button(app.picking ? "Done picking" : "Pick keypoints on the mesh", "pick", () => change({ picking: !app.picking })),
    button("Drop the mesh", "mesh-drop", () => fetch(`${objectPath(app.state.object)}/given`, { method: "DELETE" })));
  if (app.state.known_points && !app.picking) parts.push(button("Find it from the clicks", "model-free", () => act({ op: "model", points: null }),
    "the known model is no longer used; undo takes that back"));
  refill(panel, ...parts);
}

const button = (textContent, id, onclick, title = "") => element("button", { textContent, id, onclick, title });

// The way of the camera in every placed scene, and where the frame on the screen was taken from.

import { apply, multiply, poseAt } from "../image/camera.js";
import { ensureScene } from "../image/frames.js";
import { addToggle, addTraces, SCENE_COLORS, xyz } from "./solid.js";
import { shownScenes } from "./dense.js";
import { app, change, places } from "../state/store.js";

const MOST = 300; // points per scene
const loading = new Set();
const shown = addToggle("path", "camera path", "the way of the camera in every scene; a dot where the frame on the screen was taken from");

export function setUp() {
  addTraces(traces, () => [shown(), app.row, app.scene, app.pathsLoaded, ...shownScenes().map(({ name }) => app.poses[name])]);
}

function traces() {
  if (!shown()) return [];
  const scenes = shownScenes();
  for (const { name } of scenes) if (!app.poses[name]) load(name);
  return scenes.filter(({ name }) => app.poses[name]).flatMap(({ name, moved }) => {
    const { index, table } = app.poses[name], color = SCENE_COLORS[places().indexOf(name) % SCENE_COLORS.length];
    const centre = (row) => { const [x, y, z] = table.subarray(8 * row + 1, 8 * row + 4); return moved ? apply(moved, [x, y, z]) : [x, y, z]; };
    const count = Math.min(MOST, index.length), rows = Array.from({ length: count }, (_, i) => Math.round((i * (index.length - 1)) / Math.max(1, count - 1)));
    const path = { type: "scatter3d", mode: "lines", name: `camera ${name}`, showlegend: false, ...xyz(rows.map(centre)), line: { color, width: 4 }, hoverinfo: "skip" };
    return name === app.scene ? [path, ...camera(table, moved, color)] : [path];
  });
}

// The frame on the screen: its centre and its optical axis, 10 cm long.
function camera(table, moved, color) {
  const pose = moved ? multiply(moved, poseAt(table, app.row)) : poseAt(table, app.row);
  const ends = [apply(pose, [0, 0, 0]), apply(pose, [0, 0, 0.1])];
  return [{ type: "scatter3d", mode: "lines+markers", name: "this frame", showlegend: false, ...xyz(ends), hoverinfo: "skip",
    line: { color, width: 6 }, marker: { color, size: [7, 0] } }];
}

async function load(name) {
  if (loading.has(name)) return;
  loading.add(name);
  await ensureScene(name).catch(() => null);
  loading.delete(name);
  change({ pathsLoaded: (app.pathsLoaded || 0) + 1 });
}

// How far the selected keypoint is from the others, as lines: what can be measured on the object gives errors away.

import { addToggle, addTraces, labelFont, xyz } from "./solid.js";
import { app, keypointTitle } from "../state/store.js";

const shown = addToggle("distances", "distances", "from the selected keypoint to all others, in millimetres: measure one on the object");

export function setUp() {
  addTraces(traces, () => [shown()]);
}

// [{k, mm, from, to}] of the selected keypoint; the table beside the picture has the same.
export function distancesFrom(k) {
  const from = app.result?.points_m?.[k];
  if (!from || from[0] == null) return [];
  return app.result.points_m.map((to, other) => ({ k: other, from, to })).filter(({ k: other, to }) => other !== k && to && to[0] != null)
    .map((pair) => ({ ...pair, mm: 1e3 * Math.hypot(...from.map((x, i) => x - pair.to[i])) }));
}

function traces() {
  if (!shown()) return [];
  return distancesFrom(app.keypoint).map(({ k, mm, from, to }) => ({
    type: "scatter3d", mode: "lines+text", name: `distance to ${keypointTitle(k)}`, showlegend: false, hoverinfo: "skip",
    ...xyz([from, from.map((x, i) => (x + to[i]) / 2), to]), text: ["", mm.toFixed(1), ""], textfont: labelFont(),
    line: { color: app.state.keypoints[k]?.color || "#888", width: 4 },
  }));
}

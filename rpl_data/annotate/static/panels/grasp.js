// A grasp frame from two clicks in one frame: where to grasp, and where its x axis points.

import { element, refill } from "./dom.js";
import { addKeys } from "./keys.js";
import { takeClicks } from "./keypoints.js";
import { act, alertOnce } from "../state/log.js";
import { addTraces, xyz } from "../solid/solid.js";
import { app, change, frame, onChange } from "../state/store.js";

const LENGTH_M = 0.05;
const AXES = [["x", "#e5484d"], ["y", "#30a46c"], ["z", "#3e8bff"]];
const WHERE = "grasp: click on the object where it is to be grasped (W cancels)";
const TOWARD = "grasp: now click, in this frame, toward where its x axis is to point (W cancels)";

let marked = false, said = null; // marked: not judged yet; said: what the alert says of the grasp

export function setUp() {
  addKeys([[["w"], "mark a grasp: two clicks; again to cancel", turn]]);
  onChange(draw, () => [app.pendingGrasp, app.state?.grasp, app.state === null]);
  onChange(judge, () => [app.result, app.state, app.waiting]);
  takeClicks(place);
  addTraces(axes, () => [app.result?.grasp]);
}

const turn = () => (app.pendingGrasp ? end() : begin());

function draw() {
  const mark = element("button", { id: "grasp", textContent: app.pendingGrasp ? "Cancel" : "Grasp", disabled: !app.state, onclick: turn,
    title: "two clicks on the object: where to grasp, and toward where the gripper's x axis points (W)" });
  const remove = element("button", { id: "grasp-remove", textContent: "✕", ariaLabel: "remove the grasp", title: "remove the grasp; undo restores it",
    hidden: !app.state?.grasp || Boolean(app.pendingGrasp), onclick: () => act({ op: "grasp", scene: null }) });
  refill(document.getElementById("grasp-tools"), mark, remove);
}

function begin() {
  change({ view: "mark", pendingGrasp: { text: WHERE } });
}

function end() {
  change({ pendingGrasp: null });
}

// True when the click was for the grasp.
function place(u_px, v_px) {
  const begun = app.pendingGrasp;
  if (!begun) return false;
  const here = { scene: app.scene, frame: frame() };
  if (begun.scene !== here.scene || begun.frame !== here.frame) {
    change({ pendingGrasp: { ...here, u_px, v_px, text: TOWARD } });
    return true;
  }
  finish({ ...here, u_px: begun.u_px, v_px: begun.v_px, toward_u_px: u_px, toward_v_px: v_px });
  return true;
}

function finish(grasp) {
  end();
  marked = true;
  act({ op: "grasp", ...grasp });
}

// Say why the grasp that was just marked cannot be computed, until it was undone, removed or mended.
function judge() {
  const { result, state, waiting } = app;
  if (!result || waiting || result.revision !== state?.revision || !(marked || said)) return;
  const problem = result.grasp_problem || null;
  if (marked && problem) alertOnce(problem);
  else if (said && problem !== said && app.alert?.text === said) change({ alert: null });
  [marked, said] = [false, problem];
}

// The three axes at the grasp, in the object frame.
function axes() {
  const m = app.result?.grasp;
  if (!m) return [];
  const origin = [m[3], m[7], m[11]];
  return AXES.map(([name, color], i) => ({
    type: "scatter3d", mode: "lines+text", name: `grasp ${name}`, showlegend: false, hoverinfo: "skip", line: { color, width: 7 },
    ...xyz([origin, origin.map((o, row) => o + LENGTH_M * m[4 * row + i])]), text: ["", name], textfont: { color, size: 14 },
  }));
}

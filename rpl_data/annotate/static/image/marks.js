// Marks over the picture: clicks, the model projected into the frame, and the cursor.

import { apply, invert, multiply, poseAt, project } from "./camera.js";
import { clicksHere, toScreen, view } from "./view.js";
import { app, frame, poses, residualOf, scene } from "../state/store.js";

const REACH_PX = 9, FINGER_PX = 16;

// The click under a position on the screen; that of the selected keypoint first.
export function markAt(x, y, byFinger = false) {
  const near = clicksHere().filter((click) => {
    const [sx, sy] = toScreen([click.u_px, click.v_px]);
    return Math.hypot(sx - x, sy - y) <= (byFinger ? FINGER_PX : REACH_PX);
  });
  return near.find((click) => click.keypoint === app.keypoint) || near[0] || null;
}

// camera_from_object of a frame; null if the object has no pose in the scene yet.
export function cameraFromObject(sceneName, row) {
  const sceneFromObject = app.result?.scene_from_object?.[sceneName];
  return sceneFromObject ? multiply(cameraFromScene(sceneName, row), sceneFromObject) : null;
}

export const cameraFromScene = (sceneName, row) => invert(poseAt(app.poses[sceneName].table, row));

// Positions of the keypoints in a frame, each [u, v] or null: of the model if its pose is known, else the
// clicks of this scene lifted by their depth.
export function projectedKeypoints(sceneName = app.scene, row = app.row) {
  const camera = app.scenes[sceneName].camera, pose = cameraFromObject(sceneName, row);
  const found = (app.state?.keypoints || []).map(() => null);
  if (pose) {
    app.result.points_m.forEach((p, k) => { if (p && k < found.length) found[k] = project(camera, apply(pose, p)); });
    return found;
  }
  for (const { keypoint, scene: where, point_m } of app.result?.lifted || [])
    if (where === sceneName && keypoint < found.length)
      found[keypoint] = project(camera, apply(cameraFromScene(sceneName, row), point_m));
  return found;
}

export function drawMarks(canvas, dragged) {
  const ratio = window.devicePixelRatio || 1, context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.font = "12px system-ui, sans-serif";
  const projected = projectedKeypoints();
  if (app.showMask) drawMask(context);
  if (app.showModel) drawModel(context, projected);
  for (const click of clicksHere()) {
    const moved = dragged && dragged.keypoint === click.keypoint;
    drawClick(context, moved ? dragged : click, moved ? null : projected[click.keypoint]);
  }
  drawGrasp(context);
  if (app.cursor) drawCursor(context, canvas);
}

const color = (k) => app.state?.keypoints[k]?.color || "#fff";
// The keypoint's number, with the name for the selected one, or for all where that is wanted (N).
const title = (k) => {
  const name = app.state?.keypoints[k]?.name;
  return (app.showNames || k === app.keypoint) && name !== undefined && name !== String(k) ? `${k} ${name}` : String(k);
};

function drawModel(context, projected) {
  const dots = cameraFromObject(app.scene, app.row);
  if (dots && app.dense) drawDense(context, dots);
  context.lineWidth = 1.5;
  context.strokeStyle = "#ffffffb0";
  for (const [a, b] of app.result?.skeleton || [])
    if (projected[a] && projected[b]) line(context, toScreen(projected[a]), toScreen(projected[b]));
  projected.forEach((at, k) => {
    if (!at) return;
    ring(context, toScreen(at), 7, "#000", 4);
    ring(context, toScreen(at), 7, color(k), 2);
    if (!clicksHere().some((c) => c.keypoint === k)) label(context, toScreen(at), title(k), k === app.keypoint);
  });
}

function drawDense(context, pose) {
  context.fillStyle = "#35e0d055";
  for (const point of app.dense) {
    const at = project(scene().camera, apply(pose, point));
    if (!at) continue;
    const [x, y] = toScreen(at);
    context.fillRect(x - 1, y - 1, 2, 2);
  }
}

function drawMask(context) {
  const mask = app.mask;
  if (!mask || mask.scene !== app.scene || mask.frame !== frame() || !mask.image) return;
  context.globalAlpha = 0.5;
  context.drawImage(mask.image, view.left, view.top, scene().width * view.zoom, scene().height * view.zoom);
  context.globalAlpha = 1;
}

function drawClick(context, click, projected) {
  const at = toScreen([click.u_px, click.v_px]), found = residualOf(click), bad = found?.outlier;
  const doubtful = !bad && found?.reason;
  if (projected) {
    context.strokeStyle = bad ? "#ff4040" : "#ffffff";
    context.lineWidth = bad ? 2.5 : 1;
    line(context, at, toScreen(projected));
  }
  const [x, y] = at, picked = click.keypoint === app.keypoint;
  for (const [style, width] of [["#000", 4], [color(click.keypoint), 2]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    line(context, [x - 7, y], [x - 2, y]);
    line(context, [x + 2, y], [x + 7, y]);
    line(context, [x, y - 7], [x, y - 2]);
    line(context, [x, y + 2], [x, y + 7]);
  }
  if (picked) ring(context, at, 11, "#fff", 1.5);
  if (bad || doubtful) ring(context, at, 14, bad ? "#ff4040" : "#ffc46b", 3);
  label(context, at, `${title(click.keypoint)}${bad ? " ✗" : doubtful ? " ?" : ""}`, picked);
}

function drawGrasp(context) {
  const grasp = app.pendingGrasp || app.state?.grasp;
  if (!grasp || grasp.scene !== app.scene || grasp.frame !== frame()) return;
  const from = toScreen([grasp.u_px, grasp.v_px]);
  ring(context, from, 6, "#ffe14d", 3);
  label(context, from, "grasp", true);
  if (grasp.toward_u_px === undefined) return;
  context.strokeStyle = "#ffe14d";
  context.lineWidth = 2;
  line(context, from, toScreen([grasp.toward_u_px, grasp.toward_v_px]));
}

function drawCursor(context, canvas) {
  const [x, y] = toScreen([app.cursor.u, app.cursor.v]);
  context.strokeStyle = "#ffffff70";
  context.lineWidth = 1;
  line(context, [0, y], [x - 12, y]);
  line(context, [x + 12, y], [canvas.width, y]);
  line(context, [x, 0], [x, y - 12]);
  line(context, [x, y + 12], [x, canvas.height]);
}

function line(context, [x0, y0], [x1, y1]) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

function ring(context, [x, y], radius, style, width) {
  context.strokeStyle = style;
  context.lineWidth = width;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.stroke();
}

function label(context, [x, y], text, bold) {
  context.font = `${bold ? "bold " : ""}12px system-ui, sans-serif`;
  context.lineWidth = 3;
  context.strokeStyle = "#000";
  context.strokeText(text, x + 11, y - 8);
  context.fillStyle = "#fff";
  context.fillText(text, x + 11, y - 8);
}

// The pixels around the cursor, enlarged eight times, with their depth.

import { currentPicture } from "./canvas.js";
import { toScreen } from "./view.js";
import { describeDepth } from "./depth.js";
import { depthAround, picture } from "./frames.js";
import { app, change, frame, scene } from "../state/store.js";

const canvas = document.getElementById("loupe");
const readout = document.getElementById("readout");
const ENLARGED = 8;

export function draw() {
  const shown = app.view === "mark" && app.cursor && scene();
  canvas.hidden = !shown;
  readout.replaceChildren();
  if (!shown) return;
  const { u, v } = app.cursor;
  drawPixels(u, v);
  drawReadout(u, v);
  const [x, y] = toScreen([u, v]);
  canvas.classList.toggle("left", x > canvas.parentElement.clientWidth - 260 && y < 240);
}

function drawPixels(u, v) {
  const context = canvas.getContext("2d"), half = canvas.width / 2;
  const whole = app.hurried ? null : picture(app.scene, frame(), 0, () => change({}));
  const shown = whole?.ready ? whole : currentPicture();
  context.fillStyle = "#000";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.imageSmoothingEnabled = false;
  context.filter = app.brightness === 1 ? "none" : `brightness(${app.brightness})`;
  if (shown) {
    const [left, top] = [half - (u + 0.5) * ENLARGED, half - (v + 0.5) * ENLARGED];
    context.drawImage(shown.image, left, top, scene().width * ENLARGED, scene().height * ENLARGED);
  }
  context.filter = "none";
  for (const [style, width] of [["#000", 3], [app.state?.keypoints[app.keypoint]?.color || "#fff", 1]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.beginPath();
    context.moveTo(half, 0); context.lineTo(half, half - 6);
    context.moveTo(half, half + 6); context.lineTo(half, canvas.height);
    context.moveTo(0, half); context.lineTo(half - 6, half);
    context.moveTo(half + 6, half); context.lineTo(canvas.width, half);
    context.stroke();
  }
}

function drawReadout(u, v) {
  const depth = describeDepth(app.hurried ? null : depthAround(u, v, () => change({})), scene(), u, v);
  const span = document.createElement("span");
  span.textContent = `${depth.warn ? "⚠ " : ""}${depth.text}`;
  span.className = depth.warn ? "warn" : "";
  readout.append(`(${u.toFixed(2)}, ${v.toFixed(2)}) px · `, span);
}

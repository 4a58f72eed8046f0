// The image with its marks: zoom at the cursor, pan, click, drag; by mouse, pen and fingers.

import { fetchNeighbours, onlyFetch, picture, wantedWidth } from "./frames.js";
import { drawMarks, markAt } from "./marks.js";
import { app, change, frame, scene } from "../state/store.js";
import { isInside, toImage, toScreen, view } from "./view.js";

const pictureCanvas = document.getElementById("picture");
const marksCanvas = document.getElementById("marks");
const stage = document.getElementById("stage");
const MOST_ZOOM = 64, STILL_PX = 4, FINGER_STILL_PX = 10, HOLD_MS = 350;

let shownScene = null, placing = () => {}, moving = () => {}, drag = null, last = null, wanted = null;
const touches = new Map(); // where each finger is
let pinch = null; // the middle of two fingers, and how far they are apart

// place(u, v) marks the selected keypoint there; move(click, u, v) moves a mark.
export function setUp({ place, move }) {
  placing = place;
  moving = move;
  new ResizeObserver(() => resize()).observe(stage);
  marksCanvas.addEventListener("wheel", wheel, { passive: false });
  marksCanvas.addEventListener("pointerdown", down);
  marksCanvas.addEventListener("pointermove", move_);
  marksCanvas.addEventListener("pointerup", up);
  marksCanvas.addEventListener("pointercancel", cancel);
  marksCanvas.addEventListener("pointerleave", () => drag || change({ cursor: null }));
  marksCanvas.addEventListener("contextmenu", (event) => event.preventDefault());
}

function resize() {
  const ratio = window.devicePixelRatio || 1;
  for (const canvas of [pictureCanvas, marksCanvas]) {
    canvas.width = Math.round(stage.clientWidth * ratio);
    canvas.height = Math.round(stage.clientHeight * ratio);
  }
  if (view.fitted) fit(); else change({});
}

// Show the whole image.
export function fit() {
  if (!scene() || !stage.clientWidth) return;
  const { width, height } = scene();
  view.zoom = Math.min(stage.clientWidth / width, stage.clientHeight / height);
  view.left = (stage.clientWidth - width * view.zoom) / 2;
  view.top = (stage.clientHeight - height * view.zoom) / 2;
  view.fitted = true;
  change({});
}

// Zoom by a factor; the pixel under (x, y) stays there.
export function zoomBy(factor, x, y) {
  const zoom = Math.min(MOST_ZOOM, Math.max(0.1, view.zoom * factor));
  view.left = x - (x - view.left) * (zoom / view.zoom);
  view.top = y - (y - view.top) * (zoom / view.zoom);
  view.zoom = zoom;
  view.fitted = false;
  change({});
}

// Position for zooming and marking by keys: the cursor if it is on the image, else the centre.
export function cursorOnScreen() {
  return app.cursor ? toScreen([app.cursor.u, app.cursor.v]) : [stage.clientWidth / 2, stage.clientHeight / 2];
}

// Move the cursor by screen pixels, as the arrow keys do; the view follows it.
export function nudge(dx, dy) {
  const [x, y] = cursorOnScreen();
  const [u, v] = toImage(x + dx, y + dy);
  const [inside_u, inside_v] = [clamp(u, scene().width), clamp(v, scene().height)];
  const [sx, sy] = toScreen([inside_u, inside_v]);
  view.left -= Math.max(0, sx - stage.clientWidth + 20) + Math.min(0, sx - 20);
  view.top -= Math.max(0, sy - stage.clientHeight + 20) + Math.min(0, sy - 20);
  change({ cursor: { u: inside_u, v: inside_v } });
}

const clamp = (value, size) => Math.min(size - 0.501, Math.max(-0.5, value));

function position(event) {
  const box = marksCanvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

function wheel(event) {
  event.preventDefault();
  const pixels = event.deltaMode === 1 ? event.deltaY * 30 : event.deltaY;
  zoomBy(Math.exp(-Math.max(-300, Math.min(300, pixels)) * 0.0025), ...position(event));
}

function down(event) {
  if (!scene() || (drag && !touches.size)) return;
  marksCanvas.setPointerCapture(event.pointerId);
  const [x, y] = position(event), finger = event.pointerType === "touch";
  if (finger) touches.set(event.pointerId, [x, y]);
  if (touches.size > 1) return beginPinch();
  const mark = event.button === 0 ? markAt(x, y, finger) : null;
  if (mark) change({ keypoint: mark.keypoint });
  drag = { x, y, left: view.left, top: view.top, mark, button: event.button, moved: false, aiming: false };
  if (finger && !mark) drag.hold = setTimeout(aim, HOLD_MS, drag);
}

// A finger that rests aims: the loupe shows what it hides, and lifting it marks.
function aim(begun) {
  if (drag !== begun || begun.moved) return;
  begun.aiming = true;
  change({ cursor: cursor(...toImage(begun.x, begun.y)) });
}

function move_(event) {
  if (!scene()) return;
  const [x, y] = position(event);
  if (touches.has(event.pointerId)) touches.set(event.pointerId, [x, y]);
  if (pinch) return movePinch();
  if (drag?.aiming) return change({ cursor: cursor(...toImage(x, y)) });
  if (drag) {
    drag.moved ||= Math.hypot(x - drag.x, y - drag.y) >= (touches.size ? FINGER_STILL_PX : STILL_PX);
    if (drag.moved) clearTimeout(drag.hold);
    if (drag.moved && drag.mark) return change({ dragged: dragged(x, y), cursor: cursor(...draggedTo(x, y)) });
    if (drag.moved) Object.assign(view, { left: drag.left + x - drag.x, top: drag.top + y - drag.y, fitted: false });
  }
  change({ cursor: touches.size ? null : cursor(...toImage(x, y)) });
}

// Two fingers: what is between them stays between them.
function between() {
  const [[x0, y0], [x1, y1]] = touches.values();
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, apart: Math.max(1, Math.hypot(x1 - x0, y1 - y0)) };
}

function beginPinch() {
  giveUp();
  pinch = between();
}

function movePinch() {
  const before = pinch, { x, y, apart } = (pinch = between());
  Object.assign(view, { left: view.left + x - before.x, top: view.top + y - before.y });
  zoomBy(apart / before.apart, x, y);
}

function giveUp() {
  clearTimeout(drag?.hold);
  drag = null;
  change({ dragged: null, cursor: null });
}

function cancel(event) {
  touches.delete(event.pointerId);
  if (touches.size < 2) pinch = null;
  giveUp();
}

const cursor = (u, v) => (isInside(u, v) ? { u, v } : null);

// A dragged mark keeps its distance from the pointer.
function draggedTo(x, y) {
  const { u_px, v_px } = drag.mark;
  return [
    clamp(u_px + (x - drag.x) / view.zoom, scene().width),
    clamp(v_px + (y - drag.y) / view.zoom, scene().height),
  ];
}

function dragged(x, y) {
  const [u_px, v_px] = draggedTo(x, y);
  return { ...drag.mark, u_px, v_px };
}

function up(event) {
  if (pinch) return cancel(event); // the other finger does nothing until it is lifted, too
  const finger = touches.delete(event.pointerId);
  if (!drag) return;
  const [x, y] = position(event), done = drag;
  if (done.moved && done.mark) moving(done.mark, ...draggedTo(x, y));
  giveUp();
  if (!finger) change({ cursor: cursor(...toImage(x, y)) });
  if (done.moved || done.button !== 0 || done.mark) return;
  const [u, v] = done.aiming ? toImage(x, y) : toImage(done.x, done.y);
  if (isInside(u, v)) placing(u, v);
}

// Draw everything. The last picture stays until the next one has loaded.
export function draw() {
  if (!scene() || frame() === null || app.view !== "mark") return;
  if (shownScene !== app.scene) {
    shownScene = app.scene;
    last = null;
    fit();
  }
  const here = `${app.scene}/${frame()}`, width = wantedWidth(view.zoom);
  if (here !== wanted) onlyFetch(here);
  wanted = here;
  const entry = picture(app.scene, frame(), width, () => change({}));
  if (entry.ready) {
    last = entry;
    if (!app.hurried) fetchNeighbours(width);
  }
  if ((entry.ready || entry.failed) && app.shown !== here) change({ shown: here });
  drawPicture(entry);
  drawMarks(marksCanvas, app.dragged);
}

function drawPicture(entry) {
  const ratio = window.devicePixelRatio || 1, context = pictureCanvas.getContext("2d");
  pictureCanvas.style.filter = app.brightness === 1 ? "" : `brightness(${app.brightness})`;
  pictureCanvas.dataset.frame = entry.ready ? `${app.scene}/${frame()}` : "";
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, stage.clientWidth, stage.clientHeight);
  const shown = entry.ready ? entry : last;
  if (entry.failed) {
    context.fillStyle = "#fff";
    context.fillText(app.offline ? "no picture: the connection is lost" : "the server cannot read this picture", 20, 30);
  } else if (shown) {
    context.imageSmoothingEnabled = view.zoom < 4;
    context.imageSmoothingQuality = "high";
    context.drawImage(shown.image, view.left, view.top, scene().width * view.zoom, scene().height * view.zoom);
  }
}

export const currentPicture = () => last;

// Keyboard shortcuts, and the sheet that lists them.

import { cursorOnScreen, fit, nudge, zoomBy } from "../image/canvas.js";
import { element, show, closeDialog } from "./dom.js";
import { legend } from "../image/legend.js";
import { goToRow } from "../image/frames.js";
import * as keypoints from "./keypoints.js";
import * as scenes from "./scenes.js";
import * as timeline from "../image/timeline.js";
import { act } from "../state/log.js";
import { app, change, poses } from "../state/store.js";

const brighter = (by) => change({ brightness: Math.round(10 * Math.max(0.4, Math.min(3, app.brightness + by))) / 10 });
const placeAtCursor = () => app.cursor && keypoints.place(app.cursor.u, app.cursor.v);
export const undo = () => app.state?.undo && act({ op: "undo" });
export const redo = () => app.state?.redo && act({ op: "redo" });

// [keys, what it does, function]; keys as `keyOf` writes them.
const KEYS = [
  [["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"], "move the cursor by 1 screen pixel (Shift: 10, Ctrl: ¼)", null],
  [["Enter"], "mark the selected keypoint at the cursor", placeAtCursor],
  [["Delete", "Backspace"], "delete the selected keypoint's mark", keypoints.remove],
  [["0 … 9"], "select the keypoint of that number", null],
  [["j", "k"], "next, previous keypoint", (key) => keypoints.select(app.keypoint + (key === "j" ? 1 : -1))],
  [["s"], "skip: not visible in this scene", keypoints.skip],
  [["a"], "add a keypoint", keypoints.add],
  [["F2"], "rename the keypoint", keypoints.rename],
  [["Alt+ArrowUp", "Alt+ArrowDown"], "move the keypoint up or down the list", (key) => keypoints.shift(key === "Alt+ArrowUp" ? -1 : 1)],
  [["Ctrl+z"], "undo", undo],
  [["Ctrl+y", "Ctrl+Shift+z"], "redo", redo],
  [[",", "."], "previous, next frame", (key) => goToRow(app.row + (key === "." ? 1 : -1))],
  [["<", ">"], "10 frames back, forward", (key) => goToRow(app.row + (key === ">" ? 10 : -10))],
  [["Home", "End"], "first, last frame", (key) => goToRow(key === "Home" ? 0 : poses().index.length)],
  [["[", "]"], "previous, next suggested or clicked frame", (key) => timeline.jump(key === "]" ? 1 : -1)],
  [["r"], "a frame at random", timeline.random],
  [["p"], "play, stop", timeline.play],
  [["PageUp", "PageDown"], "previous, next scene", (key) => scenes.step(key === "PageDown" ? 1 : -1)],
  [["Shift+s"], "skip the rest: the object is not in this scene", scenes.skipAll],
  [["Shift+r"], "reset the scene: remove its clicks and skips", scenes.reset],
  [["+", "="], "zoom in at the cursor", () => zoomBy(1.25, ...cursorOnScreen())],
  [["-"], "zoom out", () => zoomBy(0.8, ...cursorOnScreen())],
  [["f"], "the whole image", fit],
  [["b", "Shift+b"], "brighter, darker", (key) => brighter(key === "b" ? 0.2 : -0.2)],
  [["m"], "show or hide the model", () => change({ showModel: !app.showModel })],
  [["n"], "names of all keypoints in the picture, or of the selected one", () => change({ showNames: !app.showNames })],
  [["l"], "show or hide the mask of the labels", () => change({ showMask: !app.showMask })],
];

// Other parts of the page add their keys.
export function addKeys(more) {
  KEYS.push(...more);
}

const modifiers = (event) =>
  `${event.ctrlKey || event.metaKey ? "Ctrl+" : ""}${event.altKey ? "Alt+" : ""}`;

function keyOf(event) {
  const letter = /^[a-z]$/i.test(event.key);
  const shift = event.shiftKey && letter ? "Shift+" : "";
  return modifiers(event) + shift + (letter ? event.key.toLowerCase() : event.key);
}

export function setUp() {
  addKeys([[["?"], "this sheet", sheet]]);
  document.getElementById("help").addEventListener("click", sheet);
  document.addEventListener("keydown", press);
}

function press(event) {
  if (document.querySelector("dialog[open]") || event.isComposing) return;
  const typing = event.target.matches("input:not([type=checkbox]):not([type=range]), textarea, select");
  if (typing) return;
  const key = keyOf(event), arrow = /^(Ctrl\+)?Arrow/.test(key), onButton = event.target.matches("button, input");
  if (key === "Enter" && onButton) return; // it presses the button
  if (arrow && (event.target.matches("input[type=range]") || app.view !== "mark")) return;
  const does = arrow ? () => arrowKey(event) : /^[0-9]$/.test(key) ? () => pick(Number(key)) : KEYS.find(([keys, , f]) => f && keys.includes(key))?.[2];
  if (!does) return;
  event.preventDefault();
  does(key);
}

const pick = (k) => k < app.state.keypoints.length && keypoints.select(k);

function arrowKey(event) {
  const size = event.shiftKey ? 10 : event.ctrlKey ? 0.25 : 1;
  const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  nudge(dx * size, dy * size);
}

// Letters as they stand on keyboards, and in the texts of the page.
const shown = (key) => key.replace("Arrow", "").replace(/(^|\+)[a-z]$/, (end) => end.toUpperCase());

function sheet() {
  const lines = KEYS.map(([keys, text]) =>
    element("p", {}, element("span", {}, ...keys.flatMap((k) => [element("kbd", { textContent: shown(k) }), " "])), text));
  const mouse = "Mouse, pen: click marks the selected keypoint, drag a mark to move it, drag the image to pan, wheel zooms.";
  const touch = "Touch: tap marks; hold for the loupe and lift where the keypoint is; one finger pans, two zoom.";
  show(element("b", { textContent: "Keys" }), element("p", { textContent: mouse }), element("p", { textContent: touch }),
    element("div", { className: "columns" }, ...lines),
    element("b", { textContent: "Marks in the picture" }), legend(),
    element("div", { className: "row" },
      element("button", { className: "primary", textContent: "Close (Esc)", onclick: () => closeDialog() }),
      element("button", { textContent: "Tour of the page (F1)", onclick: () => { closeDialog(); press(new KeyboardEvent("keydown", { key: "F1" })); } })));
}

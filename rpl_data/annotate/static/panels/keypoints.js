// The list of keypoints: which one to mark next, and all changes to the list itself.

import { app, change, clicksIn, counted, frame as frameNow, isSkipped, keypointName, keypointTitle, onChange, residualOf } from "../state/store.js";
import { act, alertOnce } from "../state/log.js";
import { ask, element, refill } from "./dom.js";

const list = document.getElementById("keypoints");

export function setUp() {
  document.getElementById("add-keypoint").addEventListener("click", add);
  onChange(draw, () => [app.state, app.result, app.scene, app.keypoint]);
}

export function select(k) {
  const count = app.state?.keypoints.length || 0;
  if (count) change({ keypoint: ((k % count) + count) % count });
}

// The next keypoint that is neither clicked nor skipped in this scene; the same one when there is none. Those that
// other scenes have tie this scene to them, so they come first, as in the advice of the next step.
export function nextOpen(from) {
  const count = app.state.keypoints.length, order = app.state.keypoints.map((_, i) => (from + 1 + i) % count);
  const marked = (k, here) => app.state.clicks.some((c) => c.keypoint === k && (c.scene === app.scene) === here);
  const open = order.filter((k) => !isSkipped(k, app.scene) && !marked(k, true));
  return open.find((k) => marked(k, false)) ?? open[0] ?? from;
}

// The next keypoint that passes the test; the same when there is none.
export function selectNext(test) {
  const count = app.state.keypoints.length;
  for (let step = 1; step <= count; step++) if (test((app.keypoint + step) % count)) return select(app.keypoint + step);
}

// Keep the selected keypoint if it is not marked in this scene, else select one that is not.
export function selectOpen() {
  const count = app.state?.keypoints.length || 0;
  if (count) select(nextOpen((app.keypoint + count - 1) % count));
}

// Other parts may use a click for something else: take(u, v) returns true when it did.
const takers = [];
export function takeClicks(take) {
  takers.push(take);
}

export function place(u_px, v_px) {
  if (takers.some((take) => take(u_px, v_px))) return;
  const keypoint = app.keypoint, where = { keypoint, scene: app.scene, frame: frameNow() };
  if (!app.state) return;
  if (!app.state.keypoints.length) return alertOnce("Add a keypoint first (A).");
  const there = clicksIn(app.scene, frameNow()).some((c) => c.keypoint === keypoint);
  act({ op: there ? "move" : "click", ...where, u_px, v_px });
  if (!there) select(nextOpen(keypoint));
}

export function move(click, u_px, v_px) {
  const { keypoint, scene, frame } = click;
  act({ op: "move", keypoint, scene, frame, u_px, v_px });
}

// Delete the selected keypoint's mark in this frame, or in the only other frame of this scene.
export function remove() {
  const mine = clicksIn(app.scene).filter((c) => c.keypoint === app.keypoint);
  const click = mine.find((c) => c.frame === frameNow()) || (mine.length === 1 ? mine[0] : null);
  if (!click) return alertOnce("This keypoint has no mark in this frame.");
  act({ op: "delete", keypoint: click.keypoint, scene: click.scene, frame: click.frame });
}

export function skip() {
  const undo = isSkipped(app.keypoint, app.scene);
  act({ op: undo ? "unskip" : "skip", keypoint: app.keypoint, scene: app.scene });
  if (!undo) select(nextOpen(app.keypoint));
}

const names = () => app.state.keypoints.map((k) => k.name);

export async function add() {
  const [name] = (await ask("Add a keypoint", [{ label: "its name", value: unusedName() }])) || [];
  if (!name) return;
  await act({ op: "keypoints", names: [...names(), name] });
  select(app.state.keypoints.length - 1);
}

function unusedName() {
  let number = names().length;
  while (names().includes(String(number))) number++;
  return String(number);
}

export async function rename() {
  const old = names()[app.keypoint];
  const [name] = (await ask(`Rename ${keypointTitle(app.keypoint)}`, [{ label: "new name", value: old }])) || [];
  if (name && name !== old) act({ op: "keypoints", names: names().with(app.keypoint, name) });
}

// Move the selected keypoint up or down the list; it keeps its clicks.
export async function shift(by) {
  const to = app.keypoint + by, order = names().map((_, k) => k);
  if (to < 0 || to >= order.length) return;
  [order[app.keypoint], order[to]] = [order[to], order[app.keypoint]];
  await act({ op: "order", order });
  select(to);
}

export async function removeFromList() {
  const marks = app.state.clicks.filter((c) => c.keypoint === app.keypoint).length;
  const sure = await ask(`Take ${keypointTitle(app.keypoint)} out of the list, with its ${counted(marks, "click")}? Undo restores it.`, []);
  if (sure) act({ op: "order", order: names().map((_, k) => k).filter((k) => k !== app.keypoint) });
}

function draw() {
  if (app.state) refill(list, ...app.state.keypoints.map(row));
}

function row({ name, color }, k) {
  const here = clicksIn(app.scene).filter((c) => c.keypoint === k);
  const bad = here.some((click) => residualOf(click)?.outlier), doubtful = here.some((click) => residualOf(click)?.reason);
  const [kind, word] = bad ? ["bad", "✗ wrong"] : doubtful ? ["warn", "? doubtful"]
    : here.length ? ["good", here.length > 1 ? `✓ ×${here.length}` : "✓"]
    : isSkipped(k, app.scene) ? ["quiet", "skipped"] : ["quiet", "to mark"];
  const button = element("button", { title: `${keypointTitle(k)}: ${whereMarked(k)}` },
    badge(k, color),
    element("span", { className: name === String(k) ? "name quiet" : "name", textContent: keypointName(k) }),
    element("span", { className: `small ${kind}`, textContent: word }));
  button.dataset.key = `keypoint ${k}`;
  button.addEventListener("click", () => select(k));
  const item = element("li", {}, button);
  item.setAttribute("aria-current", k === app.keypoint);
  if (k === app.keypoint) item.append(tools(here));
  return item;
}

function whereMarked(k) {
  const names = [...new Set(app.state.clicks.filter((c) => c.keypoint === k).map((c) => c.scene))];
  return names.length ? `marked in scene ${names.sort().join(", ")}` : "not marked yet";
}

// Black or white on a colour, whichever has more contrast (WCAG's relative luminance).
export function inkOn(color) {
  const [r, g, b] = [1, 3, 5].map((i) => (parseInt(color.slice(i, i + 2), 16) / 255) ** 2.2);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18 ? "#000" : "#fff";
}

export const badge = (k, color) =>
  element("span", { className: "badge", style: `background:${color};color:${inkOn(color)}`, textContent: k });

function tools(here) {
  const skipped = isSkipped(app.keypoint, app.scene);
  const all = [
    [skipped ? "unskip" : "skip", skipped ? "it is visible after all (S)" : "not visible in this scene (S)", skip],
    ["delete", "delete its mark in this frame (Del)", remove, !here.length],
    ["rename", "give it another name (F2)", rename],
    ["↑", "earlier in the list (Alt+↑)", () => shift(-1), app.keypoint === 0],
    ["↓", "later in the list (Alt+↓)", () => shift(1), app.keypoint === app.state.keypoints.length - 1],
    ["✕", "take it out of the list", removeFromList, app.state.keypoints.length === 1],
  ];
  return element("div", { className: "tools" }, ...all.map(([text, title, does, disabled = false]) => {
    const button = element("button", { textContent: text, title, disabled });
    button.dataset.key = text;
    button.addEventListener("click", does);
    return button;
  }));
}

// The list of keypoints: which one is marked next, and everything that can be done to the list itself.

import { frame as frameNow, app, change, clicksIn, isSkipped, onChange } from "./store.js";
import { act, alertOnce } from "./log.js";
import { ask, element } from "./dom.js";

const list = document.getElementById("keypoints");

export function setUp() {
  document.getElementById("add-keypoint").addEventListener("click", add);
  onChange(draw);
}

export function select(k) {
  const count = app.state?.keypoints.length || 0;
  if (count) change({ keypoint: ((k % count) + count) % count });
}

// The next keypoint of this scene that has neither a click nor is skipped; the same when there is none.
export function nextOpen(from) {
  const count = app.state.keypoints.length;
  const open = (k) => !isSkipped(k, app.scene) && !clicksIn(app.scene).some((c) => c.keypoint === k);
  for (let step = 1; step <= count; step++) if (open((from + step) % count)) return (from + step) % count;
  return from;
}

export function place(u_px, v_px) {
  const keypoint = app.keypoint, where = { keypoint, scene: app.scene, frame: frameNow() };
  if (!app.state?.keypoints.length) return alertOnce("Add a keypoint first (A).");
  const there = clicksIn(app.scene, frameNow()).some((c) => c.keypoint === keypoint);
  act({ op: there ? "move" : "click", ...where, u_px, v_px });
  if (!there) select(nextOpen(keypoint));
}

export function move(click, u_px, v_px) {
  const { keypoint, scene, frame } = click;
  act({ op: "move", keypoint, scene, frame, u_px, v_px });
}

// Take the selected keypoint's mark out of this frame, or out of the only other frame of this scene.
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
  const [name] = (await ask(`Rename keypoint ${old}`, [{ label: "new name", value: old }])) || [];
  if (name && name !== old) act({ op: "keypoints", names: names().with(app.keypoint, name) });
}

// Move the selected keypoint up or down the list; its clicks stay its own.
export async function shift(by) {
  const to = app.keypoint + by, order = names().map((_, k) => k);
  if (to < 0 || to >= order.length) return;
  [order[app.keypoint], order[to]] = [order[to], order[app.keypoint]];
  await act({ op: "order", order });
  select(to);
}

export async function removeFromList() {
  const name = names()[app.keypoint];
  const marks = app.state.clicks.filter((c) => c.keypoint === app.keypoint).length;
  const sure = await ask(`Take keypoint ${name} out of the list, with its ${marks} clicks? Undo brings it back.`, []);
  if (sure) act({ op: "order", order: names().map((_, k) => k).filter((k) => k !== app.keypoint) });
}

function draw() {
  if (!app.state) return;
  list.replaceChildren(...app.state.keypoints.map(row));
}

function row({ name, color }, k) {
  const here = clicksIn(app.scene).filter((c) => c.keypoint === k);
  const bad = here.some((c) => app.result?.clicks.some((r) => r.outlier && r.keypoint === k && r.scene === c.scene && r.frame === c.frame));
  const total = new Set(app.state.clicks.filter((c) => c.keypoint === k).map((c) => c.scene)).size;
  const state = bad ? "✗ bad" : here.length ? `✓${here.length > 1 ? `×${here.length}` : ""}` : isSkipped(k, app.scene) ? "skipped" : "—";
  const button = element("button", { title: `marked in ${total} scene(s)` },
    element("span", { className: "dot", style: `background:${color}` }),
    element("span", { className: "name", textContent: `${k + 1} ${name}` }),
    element("span", { className: `small ${bad ? "bad" : here.length ? "good" : "quiet"}`, textContent: state }),
    element("span", { className: "small quiet", textContent: `${total} sc.` }));
  button.addEventListener("click", () => select(k));
  const item = element("li", {}, button);
  item.setAttribute("aria-current", k === app.keypoint);
  if (k === app.keypoint) item.append(tools(here));
  return item;
}

function tools(here) {
  const all = [
    [isSkipped(app.keypoint, app.scene) ? "unskip" : "skip", "not visible in this scene (S)", skip],
    ["delete", "delete its mark in this frame (Del)", remove],
    ["rename", "(F2)", rename],
    ["↑", "earlier in the list (Alt+↑)", () => shift(-1)],
    ["↓", "later in the list (Alt+↓)", () => shift(1)],
    ["✕", "take it out of the list", removeFromList],
  ];
  return element("div", { className: "tools" }, ...all.map(([text, title, does]) => {
    const button = element("button", { textContent: text, title, disabled: text === "delete" && !here.length });
    button.addEventListener("click", does);
    return button;
  }));
}

// The list of scenes: the progress and quality of each.

import { openScene, suggestions } from "../image/frames.js";
import { selectOpen } from "./keypoints.js";
import { sceneOf } from "../state/api.js";
import { app, clicksIn, counted, frame, isSkipped, onChange, places } from "../state/store.js";
import { act, alertOnce } from "../state/log.js";
import { ask, element, refill } from "./dom.js";

const list = document.getElementById("scenes");
// Class and word of a state, and whether the expected error of its labels follows.
const WORDS = {
  checking: ["quiet", "checking …"], tied: ["good", "✓", true], found: ["good", "✓ found", true],
  weak: ["warn", "not surely", true], rough: ["warn", "rough", true], unfit: ["bad", "too rough", true], bad: ["bad", "✗ wrong click"],
  doubt: ["warn", "? doubtful"], loose: ["warn", "not placed"], few: ["warn", "too few clicks"],
};
const MEANINGS = {
  found: "placed by shape and colours, without clicks",
  weak: "its clicks place the object badly there",
  rough: "labels rougher than 5 px: film it again, or add clicks where the page asks for them",
  unfit: "labels so rough that the dataset leaves them out",
  bad: "the other clicks contradict one of these", doubt: "one of some clicks is wrong, and nothing tells which",
};

export function setUp() {
  document.getElementById("new-instance").addEventListener("click", openAnother);
  onChange(draw, () => [app.workspace, app.state, app.result, app.scene]);
  onChange(suggest, () => [app.state, app.result, app.scene]);
}

// Request suggested frames once per scene, and again when the object's pose in it is known.
const asked = new Set();
async function suggest() {
  if (!app.state || !app.result || app.scene === null) return;
  const name = app.scene, object = app.state.object;
  const key = `${object}/${name}/${name in app.result.scene_from_object}`;
  if (asked.has(key)) return;
  asked.add(key);
  if (!(await suggestions(name))) asked.delete(key);
}

export function step(by) {
  const names = places(), at = names.indexOf(app.scene);
  return open(names[(at + by + names.length) % names.length]);
}

// Open a scene to mark the keypoints that are not marked there yet.
async function open(name) {
  if (await openScene(name)) selectOpen();
}

// Mark another instance of the object in this scene, from 2 on, at the same frame.
async function openAnother() {
  if (app.scene === null) return;
  const name = sceneOf(app.scene), taken = places();
  let number = 2;
  while (taken.includes(`${name}/${number}`)) number++;
  if (await openScene(`${name}/${number}`, frame())) selectOpen();
}

function draw() {
  if (!app.workspace || !app.state) return;
  const all = places();
  const tied = all.filter((name) => app.result?.scene_from_object?.[name]).length;
  document.getElementById("scene-progress").textContent = `${tied} of ${all.length} placed`;
  refill(list, ...all.map(row));
}

function row(name) {
  const count = app.state.keypoints.length;
  const done = new Set(clicksIn(name).map((c) => c.keypoint)).size;
  const skipped = app.state.keypoints.filter((_, k) => isSkipped(k, name)).length;
  const found = app.result?.scenes?.[name];
  const none = skipped === count ? "not here" : "nothing yet";
  const [kind, word, figure] = done || found ? WORDS[found?.state] || ["quiet", "…"] : ["quiet", none];
  const off = figure && found.expected_mm != null ? ` ± ${millimetres(found.expected_mm)} mm` : "";
  const button = element("button", { title: explained(found, done, skipped, off) },
    element("span", { className: "name", textContent: name }),
    element("span", { className: "small quiet", textContent: `${done} of ${count - skipped}` }),
    element("span", { className: `small ${kind}`, textContent: word + off }));
  button.addEventListener("click", () => open(name));
  const item = element("li", {}, button);
  item.setAttribute("aria-current", name === app.scene);
  if (name === app.scene) item.append(tools());
  return item;
}

const ofScene = (name) => ({
  marks: clicksIn(name), skipped: app.state.skipped.filter(([, where]) => where === name),
});

function tools() {
  const { marks, skipped } = ofScene(app.scene);
  const all = [
    ["not here", "the object is not in this scene: skip every keypoint that is not marked here (Shift+S)", skipAll, !unmarked().length],
    ["reset", "remove this object's clicks and skips in this scene (Shift+R)", reset, !marks.length && !skipped.length],
  ];
  return element("div", { className: "tools" }, ...all.map(([text, title, does, disabled]) => {
    const button = element("button", { textContent: text, title, disabled });
    button.dataset.key = text;
    button.addEventListener("click", does);
    return button;
  }));
}

// Keypoints that are neither marked nor skipped in the scene that is open.
function unmarked() {
  const marked = new Set(clicksIn(app.scene).map((click) => click.keypoint));
  return app.state.keypoints.map((_, k) => k).filter((k) => !marked.has(k) && !isSkipped(k, app.scene));
}

// The object is not in this scene; one action, which undo takes back.
export function skipAll() {
  if (app.state && unmarked().length) act({ op: "batch", events: unmarked().map((keypoint) => ({ op: "skip", keypoint, scene: app.scene })) });
}

// Begin the scene anew; one action, which undo takes back.
export async function reset() {
  const name = app.scene, { marks, skipped } = ofScene(name);
  if (!marks.length && !skipped.length) return alertOnce(`Scene ${name} has nothing to reset: no click, and nothing skipped.`);
  const what = [marks.length && counted(marks.length, "click"), skipped.length && `${skipped.length} skipped`].filter(Boolean).join(" and ");
  const sure = await ask(`Reset scene ${name}: remove ${what} of ${app.state.object} there? Undo restores them.`, []);
  if (!sure) return;
  await act({ op: "batch", events: [
    ...marks.map(({ keypoint, scene, frame }) => ({ op: "delete", keypoint, scene, frame })),
    ...skipped.map(([keypoint, scene]) => ({ op: "unskip", keypoint, scene })),
  ] });
  selectOpen();
}

// One digit is enough for what is a guess of the size of an error.
export const millimetres = (mm) => (mm < 10 ? mm.toFixed(1) : mm.toFixed(0));

function explained(found, done, skipped, off) {
  const lines = [`${counted(done, "keypoint")} clicked${skipped ? `, ${skipped} not visible here` : ""}`];
  if (off) lines.push(`placed: its labels are expected to be${off} (${found.expected_px?.toFixed(1) ?? "?"} px) off`);
  if (MEANINGS[found?.state]) lines.push(MEANINGS[found.state]);
  if (found?.text) lines.push(found.text);
  return lines.join("\n");
}

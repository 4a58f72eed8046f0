// The crop box, which the dense model is cut to. It is shown while a slider moves, and saved when it rests.

import { element } from "../panels/dom.js";
import { act } from "../state/log.js";
import { addTraces, cutTo, nearBox, stage, xyz } from "./solid.js";
import { app, change, onChange } from "../state/store.js";

const SIDES = [0, 1, 2].flatMap((axis) => [0, 1].map((side) => ({ axis, side, name: `${"xyz"[axis]} ${side ? "to" : "from"}` })));
const LEAST_M = 0.005;
const sliders = SIDES.map(({ name }) => element("input", { type: "range", step: 0.001, ariaLabel: `crop box, ${name}` }));
const numbers = SIDES.map(() => element("output"));
const add = element("button", { textContent: "Cut to a box", id: "crop-add" });
const remove = element("button", { textContent: "Remove the box", id: "crop-remove" });
const body = element("div", {}, ...SIDES.map(({ name }, i) => element("label", { className: "slider" }, name, sliders[i], numbers[i])), remove);
const panel = element("details", { id: "crop" }, element("summary", { textContent: "Crop box" }),
  element("p", { className: "note quiet", textContent: "Use this only if the dense model contains something that is not the object." }), add, body);
const STILL_MS = 400;
let moving = null, saving = null; // the box until it is saved; the timer that saves it

export function setUp() {
  stage.append(panel);
  cutTo(box);
  addTraces(lines, () => [box()]);
  add.addEventListener("click", () => save(nearBox()));
  remove.addEventListener("click", () => { moving = null; act({ op: "crop", low_m: null, high_m: null }); });
  sliders.forEach((slider, i) => {
    slider.addEventListener("input", () => move(i, Number(slider.value)));
    slider.addEventListener("change", () => { saving = setTimeout(() => save(moving), STILL_MS); });
  });
  onChange(draw);
}

const box = () => moving || app.state?.crop_m || null;
const save = ([low_m, high_m]) => act({ op: "crop", low_m, high_m });

// Shown at once; saved after the slider is let go (or its keys rest), so that a drag is one action to undo.
function move(i, value) {
  clearTimeout(saving);
  change({ cropped: (moving = moved(i, value)) });
}

// The box with one side moved; it keeps some thickness.
function moved(i, value) {
  const { axis, side } = SIDES[i], [low, high] = box().map((corner) => [...corner]);
  if (side) high[axis] = Math.max(value, low[axis] + LEAST_M); else low[axis] = Math.min(value, high[axis] - LEAST_M);
  return [low, high];
}

function draw() {
  if (moving && JSON.stringify(moving) === JSON.stringify(app.state?.crop_m)) moving = null;
  const now = box(), reach = nearBox(0.6);
  panel.hidden = !now && !reach;
  add.hidden = Boolean(now);
  body.hidden = !now;
  if (!now) return;
  SIDES.forEach(({ axis, side }, i) => {
    const [low, high] = reach || now;
    sliders[i].min = Math.min(low[axis], now[0][axis]);
    sliders[i].max = Math.max(high[axis], now[1][axis]);
    sliders[i].value = now[side][axis];
    numbers[i].textContent = `${Math.round(1000 * now[side][axis])} mm`;
  });
}

function lines() {
  const now = box();
  if (!now) return [];
  const corner = (bits) => [0, 1, 2].map((axis) => now[(bits >> axis) & 1][axis]);
  const edges = [];
  for (let bits = 0; bits < 8; bits++)
    for (let axis = 0; axis < 3; axis++) if (!((bits >> axis) & 1)) edges.push(corner(bits), corner(bits | (1 << axis)), [NaN, NaN, NaN]);
  return [{ type: "scatter3d", mode: "lines", name: "crop box", ...xyz(edges), line: { color: "#e5484d", width: 4 }, hoverinfo: "skip" }];
}

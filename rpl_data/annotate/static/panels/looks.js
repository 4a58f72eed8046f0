// Cut-outs of a keypoint where it is already marked, to help find it in another scene.

import { scenePath } from "../state/api.js";
import { element } from "./dom.js";
import { app } from "../state/store.js";

const MOST = 3;

// Cut-outs around some clicks; those of other scenes come first.
export function looks(clicks, go) {
  const chosen = [...clicks].sort((a, b) => rank(a, clicks) - rank(b, clicks)).slice(0, MOST);
  return element("div", { className: "looks" }, ...chosen.map((click) => look(click, go)));
}

// The first click of every other scene, then the first of this one, then the rest.
function rank(click, clicks) {
  const before = clicks.filter((c) => c.scene === click.scene).indexOf(click);
  return 2 * before + (click.scene === app.scene ? 1 : 0);
}

function look(click, go) {
  const { scene, frame, u_px, v_px } = click;
  const src = `${scenePath(scene)}/frames/${frame}.look.jpg?u_px=${u_px}&v_px=${v_px}`;
  const color = app.state.keypoints[click.keypoint]?.color;
  const button = element("button", { title: `scene ${scene}, frame ${frame}: show it` },
    element("span", { className: "look" }, element("img", { src, alt: "" }), element("i", { style: `border-color:${color}` })),
    element("span", { textContent: `scene ${scene}` }));
  button.addEventListener("click", () => go(click));
  return button;
}

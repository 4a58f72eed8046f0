// What a keypoint looks like where it is marked already, so that it is found again in another scene.

import { element } from "./dom.js";
import { picture } from "./frames.js";
import { app, change } from "./store.js";

const MOST = 3, SIDE_PX = 76, ENLARGED = 1.5;

// Pieces of the pictures around some clicks; other scenes than the current one first.
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
  const canvas = element("canvas", { width: 2 * SIDE_PX, height: 2 * SIDE_PX });
  const button = element("button", { title: `scene ${click.scene}, frame ${click.frame}: show it` }, canvas,
    element("span", { textContent: `scene ${click.scene}` }));
  button.addEventListener("click", () => go(click));
  draw(canvas, click);
  return button;
}

function draw(canvas, click) {
  const size = app.scenes[click.scene];
  const came = () => change({ picturesCame: (app.picturesCame || 0) + 1 });
  const entry = picture(click.scene, click.frame, 0, came);
  if (!entry.ready) return;
  const context = canvas.getContext("2d"), middle = canvas.width / 2;
  const scale = (2 * ENLARGED * (size?.width || entry.image.naturalWidth)) / entry.image.naturalWidth;
  context.drawImage(entry.image, middle - (click.u_px + 0.5) * scale, middle - (click.v_px + 0.5) * scale,
    entry.image.naturalWidth * scale, entry.image.naturalHeight * scale);
  for (const [style, width] of [["#000", 5], [app.state.keypoints[click.keypoint]?.color || "#fff", 2.5]]) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.beginPath();
    context.arc(middle, middle, 16, 0, 2 * Math.PI);
    context.stroke();
  }
}

// The frames of a scene: a row of thumbnails, a bar that shows where marks are, and a slider.

import { picturePath } from "../state/api.js";
import { goToRow } from "./frames.js";
import { app, change, clicksIn, frame, onChange, poses, rowOf } from "../state/store.js";

const thumbnails = document.getElementById("thumbnails");
const bar = document.getElementById("bar");
const scrub = document.getElementById("scrub");
const text = document.getElementById("frame-text");
const THUMBNAIL_PX = 78;
let shown = "", playing = null, scrubbing = false, wanted = null; // the row the slider is at

export function setUp() {
  scrub.addEventListener("input", () => {
    wanted = Number(scrub.value);
    scrubbing = true;
    hurry();
    follow();
  });
  scrub.addEventListener("change", () => { scrubbing = false; hurry(); });
  thumbnails.addEventListener("click", (event) => {
    if (event.target.dataset.row) goToRow(Number(event.target.dataset.row));
  });
  bar.addEventListener("click", (event) => {
    const share = event.offsetX / bar.clientWidth;
    goToRow(Math.round(share * (poses().index.length - 1)));
  });
  const on = (id, does) => document.getElementById(id).addEventListener("click", does);
  on("previous", () => goToRow(app.row - 1));
  on("following", () => goToRow(app.row + 1));
  on("play", play);
  on("random", random);
  on("suggested", () => jump(1));
  new ResizeObserver(() => { shown = ""; change({ timelineWidth: thumbnails.clientWidth }); }).observe(thumbnails);
  onChange(follow, () => [app.shown]);
  onChange(draw, () => [app.scene, app.row, app.view, app.state, app.suggestions, app.poses[app.scene], app.timelineWidth, app.theme]);
}

const hurry = () => change({ hurried: scrubbing || playing !== null });
const isShown = () => app.shown === `${app.scene}/${frame()}`;

// Follow the slider, as fast as pictures load.
function follow() {
  if (wanted === null || !isShown()) return;
  const row = wanted;
  wanted = null;
  goToRow(row);
}

export function play() {
  const button = document.getElementById("play");
  if (playing) {
    clearInterval(playing);
    playing = null;
    hurry();
    button.textContent = "▶ play";
    return;
  }
  button.textContent = "❚❚ stop";
  playing = setInterval(() => {
    // On a slow link, wait: the next frame is requested when this one is shown.
    if (!isShown()) return;
    if (app.row + 1 >= poses().index.length) play(); else goToRow(app.row + 1);
  }, 80);
  hurry();
}

export const random = () => goToRow(Math.floor(Math.random() * poses().index.length));

// To the next (or previous) frame that is suggested or has a click.
export function jump(direction) {
  const marked = new Set(clicksIn(app.scene).map((c) => rowOf(app.scene, c.frame)));
  for (const { frame: index } of app.suggestions[app.scene] || []) marked.add(rowOf(app.scene, index));
  const rows = [...marked].sort((a, b) => a - b);
  if (!rows.length) return;
  const after = direction > 0 ? rows.find((r) => r > app.row) : rows.findLast((r) => r < app.row);
  goToRow(after ?? (direction > 0 ? rows[0] : rows.at(-1)));
}

function draw() {
  const rows = poses()?.index;
  if (!rows || app.view !== "mark") return;
  scrub.max = rows.length - 1;
  if (wanted === null && Number(scrub.value) !== app.row) scrub.value = app.row;
  const why = (app.suggestions[app.scene] || []).find((s) => s.frame === frame())?.why;
  text.textContent = `${why ? `★ ${why} · ` : ""}scene ${app.scene} · frame ${frame()} (${app.row + 1} of ${rows.length})`;
  drawThumbnails(rows);
  drawBar(rows);
}

function drawThumbnails(rows) {
  const count = Math.max(1, Math.min(rows.length, Math.floor(thumbnails.clientWidth / THUMBNAIL_PX)));
  const key = `${app.scene} ${count}`;
  if (key !== shown) {
    shown = key;
    thumbnails.replaceChildren(...Array.from({ length: count }, (_, i) => {
      const image = document.createElement("img");
      image.dataset.row = Math.round(((i + 0.5) * (rows.length - 1)) / count);
      image.src = picturePath(app.scene, rows[image.dataset.row], 96);
      image.alt = "";
      return image;
    }));
  }
  const here = Math.min(count - 1, Math.floor((app.row * count) / rows.length));
  [...thumbnails.children].forEach((image, i) => image.classList.toggle("here", i === here));
}

function drawBar(rows) {
  const ratio = window.devicePixelRatio || 1, width = bar.clientWidth, context = bar.getContext("2d");
  bar.width = Math.round(width * ratio);
  bar.height = Math.round(14 * ratio);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const x = (row) => 6 + (row / Math.max(1, rows.length - 1)) * (width - 12);
  const style = getComputedStyle(document.documentElement);
  context.fillStyle = style.getPropertyValue("--line");
  context.fillRect(0, 6, width, 2);
  context.fillStyle = style.getPropertyValue("--warn");
  for (const { frame: index } of app.suggestions[app.scene] || []) triangle(context, x(rowOf(app.scene, index)));
  for (const click of clicksIn(app.scene)) {
    context.fillStyle = app.state.keypoints[click.keypoint]?.color || "#888";
    context.strokeStyle = "#0009";
    context.beginPath();
    context.arc(x(rowOf(app.scene, click.frame)), 7, 4, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  }
  context.fillStyle = style.getPropertyValue("--accent");
  context.fillRect(x(app.row) - 1, 0, 3, 14);
}

function triangle(context, x) {
  context.beginPath();
  context.moveTo(x - 5, 0);
  context.lineTo(x + 5, 0);
  context.lineTo(x, 9);
  context.fill();
}

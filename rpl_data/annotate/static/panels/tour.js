// A tour of the page on the first visit: where things are, in a minute. Esc ends it; it is not shown again.

import { addKeys } from "./keys.js";
import { element } from "./dom.js";
import { kept, keep } from "../state/kept.js";
import { app, change, onChange } from "../state/store.js";

// [what is shown, its title, what is said of it]
const STOPS = [
  ["#next", "The next step", "This line always says what to do next. “Take me there”, or the key G, goes to the right scene, frame and keypoint."],
  ["#stage", "The picture", "Click exactly on the selected keypoint; the loupe shows the pixels. The wheel zooms, dragging pans. With a finger: tap, or hold for the loupe and lift."],
  ["#keypoints", "Keypoints", "The selected one is marked by your next click; then the next is selected. What cannot be seen in a scene is skipped there (S)."],
  ["#timeline", "Frames", "Any sharp frame will do, and each keypoint may be marked in another one. ★ goes to frames that are sharp and show a new side."],
  ["#scenes", "Scenes", "Three keypoints place a scene, a fourth checks them. Then ± is how far off its labels are expected to be."],
  ["#result", "Expected errors", "After every click: how good the labels will be, and which click is wrong, and why."],
  ["#views", "Look at it", "The object in 3D from all scenes, and the finished labels before they are exported (V)."],
  ["#jobs", "Build", "When the clicks are done: the dense model, the labels, the dataset and a report. It goes on when you close the page."],
];
const MARGIN_PX = 6, CARD_PX = 330;

export function setUp() {
  addKeys([[["F1"], "the tour of the page", start]]);
  onChange(startOnce, () => [Boolean(app.next)]);
}

// The tour once the page has loaded, unless this browser has seen it.
const startOnce = () => app.next && (kept("tour") || start());

export function start() {
  if (document.querySelector("dialog[open]")) return;
  if (app.view !== "mark") change({ view: "mark" });
  let at = 0;
  const hole = element("div", { className: "hole" }), title = element("b"), text = element("p"), count = element("span", { className: "quiet small" });
  const back = element("button", { textContent: "Back", onclick: () => go(-1) }), next = element("button", { className: "primary", onclick: () => go(1) });
  const skip = element("button", { textContent: "Skip (Esc)", onclick: () => dialog.close() });
  const card = element("div", { className: "card" }, title, text, element("div", { className: "row" }, next, back, skip, count));
  const dialog = element("dialog", { id: "tour", ariaLabel: "tour of the page" }, hole, card);
  dialog.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (by) { event.preventDefault(); go(by); }
  });
  const place = () => show(STOPS[at], hole, card);
  const go = (by) => {
    if (at + by === STOPS.length) return dialog.close();
    at = Math.max(0, at + by);
    [title.textContent, text.textContent] = STOPS[at].slice(1);
    count.textContent = `${at + 1} of ${STOPS.length}`;
    next.textContent = at + 1 < STOPS.length ? "Next" : "Begin";
    back.disabled = at === 0;
    place();
    next.focus();
  };
  dialog.addEventListener("close", () => { keep("tour", "seen"); window.removeEventListener("resize", place); dialog.remove(); }, { once: true });
  window.addEventListener("resize", place);
  document.body.append(dialog);
  dialog.showModal();
  go(0);
}

// The hole lies over what is spoken of, the card beside it where there is room.
function show([selector], hole, card) {
  const box = document.querySelector(selector).getBoundingClientRect(), style = hole.style;
  const left = box.left - MARGIN_PX, top = box.top - MARGIN_PX;
  style.left = `${left}px`; style.top = `${top}px`;
  style.width = `${box.width + 2 * MARGIN_PX}px`; style.height = `${Math.min(box.height + 2 * MARGIN_PX, innerHeight - top)}px`;
  const beside = box.right + CARD_PX + 20 < innerWidth ? box.right + 16 : box.left > CARD_PX + 20 ? box.left - CARD_PX - 16 : (innerWidth - CARD_PX) / 2;
  const wide = box.width > innerWidth / 2, below = wide ? (box.bottom + 200 < innerHeight ? box.bottom + 14 : Math.max(10, box.top - 190)) : box.top;
  card.style.left = `${wide ? Math.max(10, (innerWidth - CARD_PX) / 2) : beside}px`;
  card.style.top = `${Math.max(10, Math.min(below, innerHeight - 200))}px`;
}

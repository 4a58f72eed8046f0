// What the marks on the picture mean: short in the row above it, whole in the sheet of keys.

import { element } from "../panels/dom.js";

const CROSS = '<path d="M3 9h4M11 9h4M9 3v4M9 11v4" stroke="#ffd84d" stroke-width="2"/>';
const RING = '<circle cx="9" cy="9" r="5" fill="none" stroke="#ffd84d" stroke-width="2"/>';
const around = (color) => `<circle cx="9" cy="9" r="7.5" fill="none" stroke="${color}" stroke-width="2"/>`;

// [drawing, short name or null, meaning]
const MARKS = [
  [CROSS, "click", "cross: your click in this frame"],
  [RING, "model", "ring: where all clicks together put the keypoint; a line leads to the click"],
  [CROSS + around("#ff5a5a"), "wrong", "red ring, ✗: the other clicks contradict this one"],
  [CROSS + around("#ffc46b"), "doubtful", "amber ring, ?: this click or another one is wrong"],
  [CROSS + around("#ffffff"), null, "white ring: the selected keypoint"],
  ['<path d="M3 4h2v2H3zM8 8h2v2H8zM12 4h2v2h-2zM5 12h2v2H5zM12 13h2v2h-2z" fill="#35e0d0"/>', null, "small dots: the dense model"],
  ['<path d="M3 4h12L9 14z" fill="#e8a13a"/>', null, "triangle on the bar below: a suggested frame (★)"],
  ['<circle cx="9" cy="9" r="4" fill="#ffd84d" stroke="#000"/>', null, "dot on the bar below: a frame with a click"],
];

function symbol(drawing) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("viewBox", "0 0 18 18");
  made.setAttribute("aria-hidden", "true");
  made.innerHTML = drawing;
  return made;
}

export function setUp() {
  const short = MARKS.filter(([, name]) => name);
  document.getElementById("legend").append(...short.map(([drawing, name, meaning]) =>
    element("span", { title: meaning }, symbol(drawing), name)));
}

export const legend = () => element("div", { className: "columns" },
  ...MARKS.map(([drawing, , meaning]) => element("p", { className: "symbol" }, symbol(drawing), element("span", { textContent: meaning }))));

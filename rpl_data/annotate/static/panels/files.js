// The menu of files: clicks as CSV in and out; other parts of the page add their entries.

import { objectPath, post } from "../state/api.js";
import { closeDialog, element, show } from "./dom.js";
import { addKeys } from "./keys.js";
import * as log from "../state/log.js";
import { app } from "../state/store.js";

const entries = [
  ["Export clicks (CSV)", "every click of this object: object, keypoint, scene, frame, u_px, v_px", exportClicks],
  ["Import clicks (CSV)", "replaces this object's clicks; undo restores them", importClicks],
];

// Add an entry: its text, a short description, and its function.
export function addEntry(text, note, does) {
  entries.push([text, note, does]);
}

export function setUp() {
  document.getElementById("more").addEventListener("click", openMenu);
  addKeys([[["o"], "files: import and export", openMenu]]);
}

export function openMenu() {
  const lines = entries.map(([text, note, does]) => element("button", { className: "entry", onclick: () => { closeDialog(); does(); } },
    element("b", { textContent: text }), element("span", { className: "quiet small", textContent: note })));
  show(element("b", { textContent: "Files" }), ...lines,
    element("button", { textContent: "Close (Esc)", onclick: () => closeDialog() }));
}

function exportClicks() {
  element("a", { href: `${objectPath(app.state.object)}/clicks.csv`, download: `${app.state.object}_clicks.csv` }).click();
}

// Ask for a file; null when none was chosen.
export function chooseFile(accept) {
  return new Promise((resolve) => {
    const input = element("input", { type: "file", accept });
    input.addEventListener("change", () => resolve(input.files[0] || null));
    input.addEventListener("cancel", () => resolve(null));
    input.click();
  });
}

async function importClicks() {
  const file = await chooseFile(".csv,text/csv");
  if (!file) return;
  try {
    const { actions } = await post(`${objectPath(app.state.object)}/clicks/read`, { name: file.name, text: await file.text() });
    if (actions.length) await log.act({ op: "batch", events: actions });
    else log.alertOnce("This object already has all these clicks.");
  } catch (error) {
    log.alertOnce(error.message);
  }
}

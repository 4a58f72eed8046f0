// The menu of files: clicks as CSV in and out; other parts of the page add their entries.

import { objectPath, post } from "../state/api.js";
import { closeDialog, element, show } from "./dom.js";
import { addKeys } from "./keys.js";
import * as log from "../state/log.js";
import { app, counted } from "../state/store.js";

const entries = [
  ["Export clicks (CSV)", "every click of this object: object, keypoint, scene, frame, u_px, v_px", exportClicks],
  ["Import clicks (CSV)", "add them to this object's clicks, or replace those; undo restores them", importClicks],
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
    const found = await post(`${objectPath(app.state.object)}/clicks/read`, { name: file.name, text: await file.text() });
    const chosen = found[await howToImport(file.name, found)];
    if (!chosen) return;
    if (chosen.actions.length) await log.act({ op: "batch", events: chosen.actions });
    log.tell(`${file.name}: ${chosen.says}.`);
  } catch (error) {
    log.alertOnce(error.message);
  }
}

// Adding and replacing, each with what it would do; "" when cancelled. Where they do the same, nothing is asked.
async function howToImport(name, { add, replace, clicks }) {
  if (!replace.removed) return "add";
  const choice = (value, title, says) => element("button", { className: "entry", onclick: () => closeDialog(value) },
    element("b", { textContent: title }), element("span", { className: "quiet small", textContent: says }));
  return show(element("b", { textContent: `${name} holds ${counted(clicks, "click")} on ${app.state.object}` }),
    choice("add", "Add to what is here", add.says), choice("replace", "Replace what is here", replace.says),
    element("button", { textContent: "Cancel (Esc)", onclick: () => closeDialog() }));
}

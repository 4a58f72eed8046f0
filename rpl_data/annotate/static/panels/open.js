// Another workspace, or a recording: opened in this tab, served at a port of its own.

import { get, post } from "../state/api.js";
import { closeDialog, element, show } from "./dom.js";
import { addKeys } from "./keys.js";
import { alertOnce } from "../state/log.js";
import { app, onChange } from "../state/store.js";

let coming = null; // the workspace of the recording that is being read

export function setUp() {
  document.getElementById("open").addEventListener("click", choose);
  addKeys([[["Shift+o"], "open another workspace or recording", choose]]);
  onChange(follow, () => [app.job]);
}

async function choose() {
  let known;
  try {
    known = await get("/api/opening");
  } catch (error) {
    return alertOnce(error.message);
  }
  const others = known.workspaces.filter(({ here }) => !here);
  const listed = others.map(({ path, name }) => element("button", { className: "entry", textContent: name, onclick: () => { closeDialog(); open({ path }); } }));
  const field = (label, placeholder) => element("input", { ariaLabel: label, placeholder });
  const path = field("folder or file", "my-recording"), object = field("object", "object"), keypoints = field("keypoints", "8, or handle,rim,foot");
  const form = element("form", { method: "dialog" },
    element("label", {}, "A recording, or a workspace, by its path ", path),
    element("label", {}, "Of a recording: the object’s name ", object),
    element("label", {}, "Of a recording: its keypoints, how many or their names ", keypoints),
    element("div", { className: "row" }, element("button", { className: "primary", value: "ok", textContent: "Open" }),
      element("button", { type: "button", textContent: "Cancel (Esc)", onclick: () => closeDialog() })));
  const where = known.folder ? `Below ${known.folder}; to open others, start rpl annotate with --folder.`
    : "This page is served to other machines, so it opens nothing else; start rpl annotate with --folder DIR to allow what is below DIR.";
  const answer = show(element("b", { textContent: "Open another workspace or recording" }), element("p", { className: "quiet small", textContent: where }),
    ...(known.folder ? [...listed, form] : [element("button", { textContent: "Close (Esc)", onclick: () => closeDialog() })]));
  if ((await answer) === "ok" && path.value.trim()) open({ path: path.value.trim(), object: object.value, keypoints: keypoints.value });
}

async function open(wanted) {
  try {
    const { port, workspace } = await post("/api/opening", wanted);
    if (port) location.assign(`${location.protocol}//${location.hostname}:${port}/`);
    else coming = workspace;
  } catch (error) {
    alertOnce(`Not opened: ${error.message}`);
  }
}

// When the recording has been read, its workspace is opened.
function follow() {
  if (!coming || app.job?.stage !== "open" || app.job.state === "running") return;
  const path = coming;
  coming = null;
  if (app.job.state === "done") open({ path });
}

// Builds: the dense model, the labels, the dataset, the report. They run on the server, even when the page is closed.

import { get, post, sceneOf } from "../state/api.js";
import { openObject } from "./objects.js";
import * as dense from "../solid/dense.js";
import { element, prose, refill } from "./dom.js";
import { openScene, refreshScenes } from "../image/frames.js";
import { addKeys } from "./keys.js";
import { alertOnce, load as loadObject } from "../state/log.js";
import { onNews } from "../state/news.js";
import { onAction } from "./next.js";
import { app, change, clicksIn, counted, onChange } from "../state/store.js";

const panel = document.getElementById("jobs");
const STEPS = [
  ["segment", "Dense model", "Make", "the object's surface, from the depth of all scenes"],
  ["label", "Labels", "Make", "pose, keypoints, boxes and masks in every chosen frame"],
  ["export", "Dataset", "Export", "a folder that trainers read"],
  ["report", "Report", "Make", "one page to look at and to send: pictures, errors, models in 3D"],
];
let asked = null; // the revision that `fresh` was last asked for

export function setUp() {
  onNews("job", heard);
  onNews("hello", caughtUp);
  onAction("label", () => start("label"));
  onNews("built", elsewhere);
  onAction("export", () => start("report"));
  onAction("object", (step) => openObject(step.object));
  addKeys([[["x"], "make what is missing: dense model and labels, then the dataset and its report", () => start(app.fresh.label ? "report" : "label")]]);
  onChange(refresh);
  onChange(advise);
  onChange(draw);
}

// A known object, found in the scene on the screen without clicks, or with the one that was asked for.
export async function find() {
  if (atWork()) return alertOnce("A job is running; wait until it ends, or stop it.");
  try {
    take(await post("/api/jobs", { stage: "find", object: app.state.object, scene: app.scene }));
  } catch (error) {
    alertOnce(error.message);
  }
}

const runs = (job) => ["running", "stopping"].includes(job?.state);
export const atWork = () => runs(app.job);

// The news of an end may arrive before the answer to the start, and is not taken back by it.
async function heard(job) {
  const ended = !runs(job) && (atWork() || job.number !== app.job?.number);
  if (ended) await load(); // with what is up to date now, or the step that was just done would be the next one
  if (!(app.job?.number > job.number)) change({ job });
  if (ended) await rebuilt();
}

function take(state) {
  const old = runs(state.job) && !atWork() && state.job.number === app.job?.number;
  change(old ? { ...state, job: app.job } : state);
}

// After a lost connection: a job may have ended unheard.
async function caughtUp() {
  const before = atWork();
  await load();
  if (before && !atWork()) await rebuilt();
}

// Another program built here, a step or many.
async function elsewhere(steps) {
  const before = app.elsewhere?.steps || [];
  change({ elsewhere: { steps: [...new Set([...before, ...steps])], time: new Date().toTimeString().slice(0, 5) } });
  await rebuilt();
}

async function rebuilt() {
  dense.forget();
  const workspace = await get("/api/workspace").catch(() => app.workspace); // a build may cut a scene that drifts
  change({ workspace, built: (app.built || 0) + 1 });
  await refreshScenes().catch((error) => alertOnce(error.message));
  if (app.state) await loadObject(app.state.object);
  await load();
}

let loads = 0; // an older answer that arrives late is not taken
async function load() {
  const mine = ++loads, state = await get("/api/jobs").catch(() => null);
  if (state && mine === loads) take(state);
}

// Every saved action may change what is up to date.
function refresh() {
  const key = app.result && `${app.state?.object}/${app.result.revision}`;
  if (!key || key === asked || app.waiting) return;
  asked = key;
  load();
}

export async function start(stage) {
  if (atWork()) return alertOnce("A job is running; wait until it ends, or stop it.");
  try {
    take(await post("/api/jobs", { stage }));
  } catch (error) {
    alertOnce(error.message);
  }
}

async function stop() {
  await fetch("/api/jobs", { method: "DELETE" });
}

// When the clicks are done, the next steps are builds.
function advise() {
  if (app.next?.action !== "label" && !app.next?.built) return;
  const next = { ...afterClicks(), built: true };
  if (!app.next.built || next.text !== app.next.text) change({ next });
}

function afterClicks() {
  if (atWork()) return { text: `working: ${app.job.what || app.job.stage} …` };
  const other = (app.unmarked || []).find((name) => name !== app.state.object);
  if (other) return { text: `${app.state.object} is marked in every scene; now mark ${other}`, action: "object", object: other };
  if (!app.fresh?.label)
    return { text: app.result?.next.text ?? "make the dense model and the labels", action: "label", label: "Make them " };
  if (!app.fresh.export || !app.fresh.report)
    return app.view === "labels"
      ? { text: "look through the labels, click a frame to mend it; when they are good, make the dataset and its report", action: "export", label: "Make them " }
      : { text: "the labels are made: look through them", view: "labels", label: "Show them " };
  const doubt = app.result?.next.doubt;
  if (doubt) return { text: `the dataset and its report are made, but its labels are rough: ${doubt}. Film again, or use them as they are` };
  return { text: "done: the dataset and its report are made. Add clicks or scenes whenever you like, and make it again" };
}

// With fewer clicks than place a scene, the object may be found there by its shape and colours.
function findable() {
  if (!app.state || !app.result || app.scene === null || app.result.scene_from_object[app.scene]) return false;
  if (app.scene !== sceneOf(app.scene)) return false; // which instance would be found is not known
  return Boolean(app.fresh?.segment) && new Set(clicksIn(app.scene).map((c) => c.keypoint)).size < 3;
}

const TITLES = { find: "Finding the object", open: "Reading the recording", ...Object.fromEntries(STEPS.map(([stage, title]) => [stage, title])) };
const signature = () => JSON.stringify([app.job, app.fresh, app.scene, app.elsewhere, findable()]);
let drawn = "";

function draw() {
  if (drawn === signature()) return;
  drawn = signature();
  refill(document.getElementById("find"), ...finding());
  const all = element("button", { textContent: "Make all", id: "job-all", disabled: atWork() || Boolean(app.fresh?.report),
    title: "everything that is out of date, as `rpl build` does (X)" });
  all.addEventListener("click", () => start("report"));
  refill(panel, element("h2", {}, "Build", all), ...STEPS.map(row), ...progress(), ...builtElsewhere(), ...ending());
}

function builtElsewhere() {
  if (!app.elsewhere) return [];
  const { steps, time } = app.elsewhere, more = steps.length - 3;
  const named = steps.slice(-3).map((step) => step.replace("/", " ")).join(", ") + (more > 0 ? ` and ${counted(more, "other step")}` : "");
  return [element("p", { className: "note", id: "elsewhere", textContent: `Another program built here until ${time}: ${named}. What you see is up to date with it.` })];
}

function finding() {
  if (!findable()) return [];
  const button = element("button", { textContent: "Find", id: "job-find", disabled: atWork(),
    title: "by the shape and colours of its dense model; nothing is placed where that is not sure" });
  button.addEventListener("click", find);
  const what = `scene ${app.scene} without clicks`;
  return [element("div", { className: "job row" }, element("span", { className: "name", textContent: what }), button)];
}

function row([stage, title, verb, note]) {
  const fresh = app.fresh?.[stage];
  const mark = fresh ? element("span", { className: "small good", textContent: "✓ up to date" })
    : element("span", { className: "small quiet", textContent: atWork() ? "" : "to make" });
  const button = element("button", { textContent: verb, title: note, disabled: atWork() || Boolean(fresh), id: `job-${stage}` });
  button.addEventListener("click", () => start(stage));
  const name = element("span", { className: "name", textContent: title });
  if (stage === "report" && fresh) name.append(" ", element("a", { href: "/api/report.html", textContent: "open", title: "saves it as a file, to open or to send" }));
  return element("div", { className: "job row" }, name, mark, button);
}

function progress() {
  if (!atWork()) return [];
  const { what, done, total, state, stage } = app.job;
  const bar = element("progress", { max: total || 1, ariaLabel: "progress" });
  if (total) bar.value = done; // otherwise it shows only that it is running
  const button = element("button", { textContent: state === "stopping" ? "stopping …" : "Stop", disabled: state === "stopping", id: "job-stop" });
  button.addEventListener("click", stop);
  return [element("p", { className: "note", textContent: `${what || stage}${total ? ` · ${done} of ${stage === "find" ? total : counted(total, "frame")}` : " …"}` }),
    element("div", { className: "job row" }, bar, button)];
}

function ending() {
  const { state, error, lines = [], seconds, stage, scene, frame, keypoint } = app.job || {};
  if (state === "unsure") {
    const go = element("button", { textContent: "Take me to that click", id: "job-ask", hidden: frame == null });
    go.addEventListener("click", () => openScene(scene, frame, { keypoint, view: "mark" }));
    return [element("p", { className: "note warn", role: "alert", textContent: `Not sure: ${error}` }), go];
  }
  if (state === "failed") return [element("p", { className: "note bad", role: "alert" }, ...prose(error))];
  if (state === "stopped") return [element("p", { className: "note warn", textContent: `${TITLES[stage]}: stopped; what was finished stays` })];
  if (state !== "done") return [];
  const shown = lines.map((text) => element("p", { className: "note" }, ...prose(text)));
  return [element("p", { className: "note good", textContent: `${TITLES[stage]}: done in ${seconds} s` }), ...shown];
}

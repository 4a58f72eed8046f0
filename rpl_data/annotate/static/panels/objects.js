// Objects: opening one, and adding another.

import { openScene } from "../image/frames.js";
import { post, sceneOf } from "../state/api.js";
import { ask } from "./dom.js";
import * as keypoints from "./keypoints.js";
import * as log from "../state/log.js";
import { app, change, frame } from "../state/store.js";

export async function openObject(name) {
  change({ state: null, result: null, next: null, dense: null, mask: null, suggestions: {}, keypoint: 0 });
  try {
    if (!(await log.load(name))) return;
    if (app.scene?.includes("/")) await openScene(sceneOf(app.scene), frame()); // an instance is one object's
    keypoints.selectOpen();
  } catch (error) {
    log.alertOnce(error.message);
  }
}

export async function newObject() {
  const answer = await ask("Another object in these scenes", [
    { label: "name", value: "" },
    { label: "keypoints: their number, or their names separated by commas", value: "8" },
  ]);
  if (!answer) return;
  const [name, wanted] = answer, count = Number(wanted);
  const names = Number.isInteger(count) ? Array.from({ length: count }, (_, k) => String(k)) : wanted.split(",").map((n) => n.trim());
  try {
    const { objects } = await post("/api/objects", { name, keypoints: names });
    change({ workspace: { ...app.workspace, objects } });
    await openObject(name);
  } catch (error) {
    log.alertOnce(error.message);
  }
}

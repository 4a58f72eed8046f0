// The labels' mask in the current frame, fetched when it is shown.

import { scenePath } from "../state/api.js";
import { app, change, frame, onChange } from "../state/store.js";

let shown = "";

export function setUp() {
  onChange(load, () => [app.showMask, app.state?.object, app.scene, app.row, app.fresh]);
}

async function load() {
  if (!app.showMask || !app.state || frame() === null) {
    shown = "";
    return;
  }
  const key = (shown = `${app.state.object}/${app.scene}/${frame()}`);
  const [name, index] = [app.scene, frame()];
  const address = `${scenePath(name)}/frames/${index}.mask.png?object=${encodeURIComponent(app.state.object)}`;
  const image = await fetch(address).then(pictureOf, () => null);
  if (key === shown) change({ mask: { scene: name, frame: index, image } });
}

const pictureOf = async (answer) => (answer.status === 200 ? createImageBitmap(await answer.blob()) : null);

// Whether there is a mask for the current frame; null while it loads.
export function maskHere() {
  const here = app.mask && app.mask.scene === app.scene && app.mask.frame === frame();
  return here ? app.mask.image !== null : null;
}

// News from elsewhere: other tabs and people, jobs, and whether the server still responds.

import { get } from "./api.js";
import * as log from "./log.js";
import { app, change } from "./store.js";

const SILENCE_MS = 25000; // the server says something every 10 s
const REPLACED = "The workspace was replaced while this page was open: reload the page.";
const isAnother = (now) => now.name !== app.workspace.name || (app.state && !now.objects.includes(app.state.object))
  || (app.scene !== null && !now.scenes.includes(app.scene));

// What fails where there is no object any more says so, in place of a fault of the page.
for (const kind of ["error", "unhandledrejection"])
  window.addEventListener(kind, (event) => { if (app.workspace && !app.state) { event.preventDefault(); log.alertOnce(REPLACED); } });

const hears = {
  object: async (name, revision) => {
    if (name === app.state?.object && revision > app.state.revision && !app.waiting) await log.load(name);
  },
  objects: async () => change({ workspace: await get("/api/workspace") }),
};

// Other parts of the page listen too.
export function onNews(kind, does) {
  hears[kind] = does;
}

export function listen() {
  const stream = new EventSource("/api/news");
  let silence = null;
  const alive = () => {
    clearTimeout(silence);
    silence = setTimeout(() => { stream.close(); change({ offline: true }); listen(); }, SILENCE_MS);
  };
  alive();
  stream.onmessage = async ({ data }) => {
    alive();
    const [kind, ...what] = JSON.parse(data);
    if (app.offline) change({ offline: false });
    if (kind === "hello") await caughtUp();
    await hears[kind]?.(...what);
  };
  stream.onerror = () => {
    change({ offline: true });
    if (stream.readyState === EventSource.CLOSED) {
      clearTimeout(silence);
      setTimeout(listen, 1000);
    }
  };
}

// After a lost connection: send waiting actions, and load what others did.
export async function caughtUp() {
  const now = app.workspace && (await get("/api/workspace").catch(() => null));
  if (now && isAnother(now)) return log.alertOnce(REPLACED);
  if (app.waiting) await log.sendAgain();
  else if (app.state) await log.load(app.state.object).catch((error) => log.alertOnce(error.message));
}

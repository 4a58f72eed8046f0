"""Another web page, open in the same browser: it reads nothing, changes nothing and ends nothing."""

from __future__ import annotations

import threading
import urllib.request
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from driving import Server
from playwright.sync_api import Browser

ATTACK = """<!doctype html><title>elsewhere</title>
<iframe src="TARGETapi/scenes/00/frames/0.look.jpg?u_px=nan&v_px=0"></iframe>
<iframe src="TARGETapi/scenes/00/frames/0.look.jpg?u_px=1&v_px=1"></iframe>
<iframe id="page" src="TARGET"></iframe>
<iframe name="sink"></iframe>
<object data="TARGETapi/workspace"></object><embed src="TARGETapi/workspace">
<form id="f" method="post" action="TARGETapi/objects" target="sink" enctype="text/plain">
<input name='{"name": "evil", "keypoints": ["a", "b", "c"], "x": "' value='"}'></form>
<script>
window.got = {};
const image = new Image();
image.onload = () => { window.got.image = "read"; };
image.onerror = () => { window.got.image = "refused"; };
image.src = "TARGETapi/scenes/00/frames/0.jpg";
document.getElementById("f").submit();
const asked = async (name, path, options) => {
  try {
    const answer = await fetch("TARGET" + path, options);
    window.got[name] = answer.type === "opaque" ? "opaque" : "read " + await answer.text();
  } catch { window.got[name] = "refused"; }
};
const act = JSON.stringify({ seen: 0, actions: [{ op: "keypoints", names: ["a", "b", "c"] }] });
const socket = new WebSocket("TARGET".replace("http", "ws") + "api/news");
socket.onopen = () => { window.got.socket = "open"; };
socket.onerror = () => { window.got.socket = "refused"; };
const events = new EventSource("TARGETapi/news");
events.onopen = () => { window.got.events = "open"; };
events.onerror = () => { window.got.events = "refused"; };
Promise.all([
  asked("get", "api/workspace"), asked("blind", "api/objects/carton", { mode: "no-cors" }),
  asked("post", "api/objects/carton", { method: "POST", mode: "no-cors", body: act }),
  asked("json", "api/objects/carton",
    { method: "POST", body: act, headers: { "Content-Type": "application/json" } }),
  asked("delete", "api/objects/carton/given", { method: "DELETE" }),
  asked("with", "api/workspace", { credentials: "include" }),
]).then(() => { window.got.done = true; });
</script>"""


class Elsewhere(BaseHTTPRequestHandler):
    """A page of another site."""

    target = ""

    def do_GET(self) -> None:
        content = ATTACK.replace("TARGET", self.target).encode()
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def elsewhere(server: Server) -> Iterator[str]:
    """`localhost` is another site than 127.0.0.1, where the server is."""
    Elsewhere.target = server.url
    site = ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere)
    threading.Thread(target=site.serve_forever, daemon=True).start()
    yield f"http://localhost:{site.server_port}/"
    site.shutdown()
    site.server_close()


def files_of(workspace: Path) -> dict[str, bytes]:
    kept = [p for p in workspace.rglob("*") if p.is_file() and p.suffix in (".jsonl", ".json", ".yaml")]
    return {str(path.relative_to(workspace)): path.read_bytes() for path in kept}


@pytest.mark.parametrize("server", ["process"], indirect=True)
def test_a_foreign_page_reads_nothing_changes_nothing_and_ends_nothing(
    browser: Browser, server: Server, elsewhere: str
) -> None:
    before = files_of(server.workspace)
    context = browser.new_context()
    page = context.new_page()
    statuses: dict[str, set[int]] = {}
    page.on("response", lambda r: statuses.setdefault(r.url.split("?")[0], set()).add(r.status))
    page.goto(elsewhere)
    page.wait_for_function("window.got.done && window.got.image && window.got.socket && window.got.events")
    page.wait_for_load_state("networkidle")  # the frames and the form are answered too
    got = page.evaluate("window.got")
    blind = {got.pop("blind"), got.pop("post")}
    assert blind <= {"opaque", "refused"}, "an opaque answer tells the page nothing"
    assert got.pop("done") and set(got.values()) == {"refused"}, got
    answered = {url: seen for url, seen in statuses.items() if url.startswith(server.url)}
    assert answered and set.union(*answered.values()) == {403}, answered
    assert server.process.poll() is None
    assert urllib.request.urlopen(server.url, timeout=10).status == 200
    assert files_of(server.workspace) == before

    page.goto(server.url)  # a link to the page itself still opens it
    assert page.title() != "elsewhere" and page.locator("#saved").count() == 1
    context.close()

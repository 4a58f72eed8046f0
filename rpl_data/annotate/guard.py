"""What stands before every request: who may ask, from which page, and how much may be sent.

The page can change and write files, so another web page open in the same browser must not be able to
use it: requests with a foreign Host (DNS rebinding), a foreign Origin, or that another site caused are
refused. The one exception is a link: another site may open the page itself in a tab, but not in a frame, and
nothing else. Beyond this machine a secret token is asked for as well.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rpl_data.annotate.work import Address

COOKIE = "rpl_token"
MOST_BYTES = 64 * 2**20
"""A large mesh; nothing longer is read."""
LONGEST_NUMBER = 15
"""Digits of a number in a header: Python refuses to read one of thousands."""
MOST_BYTES_AT_ONCE = 2 * MOST_BYTES
"""Of all requests together: bodies are kept in memory until they are answered."""
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "script-src 'self'; connect-src 'self'; object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""Nothing is loaded from anywhere else; plotly styles its elements inline."""


class Guard:
    """ASGI middleware that lets only the page itself through."""

    def __init__(self, app: ASGIApp, address: Address) -> None:
        self.app = app
        self.address = address
        port = address.port
        names = {address.host} if address.token else {"127.0.0.1", "localhost", "[::1]"}
        anywhere = address.host in ("0.0.0.0", "::")  # then the token alone decides
        self.hosts = None if anywhere else {f"{name}:{port}" for name in names}
        self.bytes_at_once = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, or pass on."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await refusal(scope, receive, send)
            return
        body = _Body(receive, self)
        policed = _Policed(send, body)
        try:
            await self.app(scope, body, policed)
        except _TooLong:
            pass
        finally:
            self.bytes_at_once -= body.got
        if body.refusal is not None and not policed.started:
            policed.refuses = True
            await body.refusal(scope, receive, policed)

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if self.hosts is not None and host not in self.hosts:
            return _no(403, f"this page is not served as {host!r}; open {self.address.url}")
        if origin is not None and origin != f"http://{host}":
            return _no(403, f"a page of {origin!r} may not use this one")
        if headers.get("sec-fetch-site") in ("cross-site", "same-site") and not _opens_the_page(
            scope, headers
        ):
            return _no(403, "another site may not use this page")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or len(length) > LONGEST_NUMBER or int(length) > MOST_BYTES:
            return _no(413, f"too much: at most {MOST_BYTES // 2**20} MB are taken")
        return self._without_token(scope, headers)

    def _without_token(self, scope: Scope, headers: Headers) -> Response | None:
        """The refusal when the token is wrong; the first visit trades it for a cookie."""
        token = self.address.token
        if token is None:
            return None
        shown = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if hmac.compare_digest(shown.encode(), token.encode()):
            if scope["path"] != "/":
                return None
            answer = RedirectResponse("/", 303)
            answer.set_cookie(COOKIE, token, httponly=True, samesite="strict")
            return answer
        # Other servers of this machine set cookies too, with names that Python's own parser raises at.
        kept = cookie_parser(headers.get("cookie", "")).get(COOKIE, "")
        if hmac.compare_digest(kept.encode("utf-8", "replace"), token.encode()):
            return None
        return _no(403, "the token is missing or wrong; open the address that `rpl annotate` printed")


def _opens_the_page(scope: Scope, headers: Headers) -> bool:
    """Whether a person followed a link to the page; a frame inside another page is none."""
    mode, shown_in = headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest")
    followed = scope["method"] == "GET" and mode == "navigate" and shown_in == "document"
    return followed and scope["path"] == "/"


def _no(status: int, why: str) -> Response:
    return PlainTextResponse(f"refused: {why}", status)


class _TooLong(Exception):
    """More bytes came than are taken."""


@dataclass
class _Body:
    """Counts the bytes of a body; beyond the limits reading it fails, and `refusal` says why.

    Attributes:
        got: bytes so far, counted in the guard's sum of all requests too.
    """

    receive: Receive
    guard: Guard
    got: int = 0
    refusal: Response | None = None

    async def __call__(self) -> Message:
        message = await self.receive()
        length = len(message.get("body", b""))
        self.got += length
        self.guard.bytes_at_once += length
        if self.got > MOST_BYTES:
            self.refusal = _no(413, f"too much: at most {MOST_BYTES // 2**20} MB are taken")
        elif self.guard.bytes_at_once > MOST_BYTES_AT_ONCE:
            self.refusal = _no(429, "other files are being sent; wait for them and send this one again")
        if self.refusal is not None:
            raise _TooLong
        return message


@dataclass
class _Policed:
    """Adds the headers that keep other pages out to every answer.

    Attributes:
        started: an answer is on its way.
        refuses: the answer is the guard's own. That of the application to a body that was cut off is not
            sent: it would blame the body.
    """

    send: Send
    body: _Body
    started: bool = False
    refuses: bool = False

    async def __call__(self, message: Message) -> None:
        if self.body.refusal is not None and not self.started and not self.refuses:
            return
        if message["type"] == "http.response.start":
            self.started = True
            headers = MutableHeaders(scope=message)
            headers["Content-Security-Policy"] = POLICY
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "no-referrer"
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
        await self.send(message)

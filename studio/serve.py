"""The server: on this machine alone, or with a token; and the command `symseek studio`."""

from __future__ import annotations

import hmac
import http
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from unittest import mock
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from viser import _messages
from websockets import Headers
from websockets.http11 import Request, Response

from symseek.checks import SceneError

from .engine import Engine
from .keep import PAIR, Folder
from .page import Page

LOCAL = {"127.0.0.1", "localhost", "::1"}
COOKIE = "symseek-studio"
MESSAGE_MOST = 1_000_000
"""Bytes of what a browser may say at once."""


class Guard:
    """Who may speak to the server: pages that it served itself, and beyond this machine only those with the token.

    Args:
        token: that the address must hold, and then a cookie does; "" for none.
    """

    def __init__(self, token: str):
        self.token = token

    def refuses(self, request: Request) -> Response | None:
        """The answer to a request that may not be; None: it may."""
        host = request.headers.get("Host", "")
        if not self.token and urlsplit(f"//{host}").hostname not in LOCAL:
            return _refusal("This studio speaks to its own machine alone.")  # another name may be a trap (DNS rebinding)
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return _refusal("Pages of other servers may not use this studio.")
        if self.token and not self._known(request):
            return _refusal("Open the whole address that `symseek studio` printed: the token is missing or wrong.")
        return None

    def _known(self, request: Request) -> bool:
        given = parse_qs(urlsplit(request.path).query).get("token", [])
        try:
            cookie = SimpleCookie(request.headers.get("Cookie", "")).get(COOKIE)
        except Exception:
            cookie = None
        given += [cookie.value] if cookie is not None else []
        return any(hmac.compare_digest(g.encode(), self.token.encode()) for g in given)

    def answered(self, answer: Response | None) -> Response | None:
        """A page that may be, with what the next request will be known by."""
        if answer is not None:
            if self.token:
                answer.headers["Set-Cookie"] = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            answer.headers["Referrer-Policy"] = "no-referrer"
            answer.headers["X-Frame-Options"] = "DENY"
        return answer

    @contextmanager
    def stands(self) -> Iterator[None]:
        """Servers of websockets that are made in the block let this guard look at each request: viser has no hook for it."""
        serve = websockets.asyncio.server.serve

        def guarded(*args: Any, process_request: Callable[[Any, Request], Response | None], **rest: Any) -> Any:
            def examine(connection: Any, request: Request) -> Response | None:
                refusal = self.refuses(request)
                return self.answered(process_request(connection, request)) if refusal is None else refusal

            return serve(*args, process_request=examine, **{**rest, "max_size": MESSAGE_MOST})

        with mock.patch.object(websockets.asyncio.server, "serve", guarded):
            yield


def _refusal(text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)


class Studio:
    """Server, engine and page together; `close` ends them.

    Args:
        paths: what to open: a scene file, an image, or the left and the right one of a stereo pair.
        root: folder that may be read and written.
        host, port: to listen at; port 0 is any free one.
        device: Warp device.

    Raises:
        SceneError: a path lies outside the folder, or they are no pair.
    """

    def __init__(self, paths: Sequence[str], root: Path, host: str = "127.0.0.1", port: int = 8080, device: str = "cpu"):
        self.folder = Folder(root)
        shown = [p if p.startswith("skimage:") else str(self.folder.inside(p).relative_to(self.folder.root)) for p in paths]
        if len(shown) > 2 or (len(shown) == 2 and any(p.endswith(".toml") for p in shown)):
            raise SceneError(shown[-1], "", "is one too many", "give a scene file, an image, or two images of a stereo pair")
        self.token = "" if host in LOCAL else secrets.token_urlsafe(16)
        with Guard(self.token).stands():
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):  # a public address for whoever asks
            self.server._websock_server.unregister_handler(message)
        self.engine = Engine(device)
        self.page = Page(self.server, self.folder, self.engine)
        name = "127.0.0.1" if host in LOCAL else host
        self.address = f"http://{name}:{self.server.get_port()}/" + (f"?token={self.token}" if self.token else "")
        if shown:
            self.page.open(PAIR.join(shown[:2]))

    def close(self) -> None:
        """Ends all threads."""
        self.page.close()
        self.server.stop()
        self.engine.close()


def serve(paths: Sequence[str], host: str, port: int, device: str, tell: Callable[[str], None]) -> None:
    """Runs the studio until it is interrupted."""
    studio = Studio(paths, Path.cwd(), host, port, device)
    try:
        if studio.page.told[0] and studio.page.session is None:
            raise SceneError(paths[0], "", ": ".join(studio.page.told))
        tell(f"the studio is at {studio.address} (^C ends it; what you make is kept in {studio.folder.root})")
        threading.Event().wait()
    finally:
        studio.close()

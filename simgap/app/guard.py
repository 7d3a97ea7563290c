"""Which requests are answered: those to this machine's own name that carry the token, and changes from the app's own pages.

A web page of another origin can send requests to 127.0.0.1. It does not know the token; a name that it makes resolve to
127.0.0.1 (DNS rebinding) is no allowed host; and what its forms send has another origin.
"""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["POLICY", "WRITTEN_POLICY", "Guard"]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; media-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of the app's pages: nothing inline, nothing from elsewhere."""
WRITTEN_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "media-src data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Of pages that a command wrote: an origin of their own, which may ask nothing of the app. Their own policy lists each script."""
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """ASGI middleware. ``port``: that of the server; ``token``: what every request carries, in the address or in the cookie."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app, self._token = app, token
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._cookie = f"simgap-{port}"  # cookies are shared by all ports of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse in one line."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.setdefault("Content-Security-Policy", POLICY)
                for name, value in _HEADERS.items():
                    headers[name] = value
            await send(message)

        refusal = self._answer(Request(scope))
        await (refusal or self._app)(scope, receive, with_headers)

    def _answer(self, request: Request) -> Response | None:
        """A response where the request does not go on."""
        host = request.headers.get("host", "").lower()
        if host not in self._hosts:
            return PlainTextResponse("simgap app: wrong host; open the address that the command printed\n", 400)
        if request.method not in ("GET", "HEAD") and request.headers.get("origin", f"http://{host}") != f"http://{host}":
            return PlainTextResponse("simgap app: a request from another site\n", 403)
        if self._same(self._kept(request)):
            return None
        if not self._same(request.query_params.get("token", "")):
            return PlainTextResponse("simgap app: no token, or a wrong one; open the address that the command printed\n", 403)
        if request.method != "GET":
            return None
        rest = urlencode([(k, v) for k, v in parse_qsl(request.url.query) if k != "token"])
        path = "/" + request.url.path.lstrip("/\\")  # "//host" would be another host
        response = RedirectResponse(f"{path}?{rest}" if rest else path, 303)
        response.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
        return response

    def _kept(self, request: Request) -> str:
        try:
            found = SimpleCookie(request.headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return found.value if found is not None else ""

    def _same(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self._token.encode())

"""The application: addresses of the API, errors in words, and what keeps other people's web pages out."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import logging
import os
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, TypeVar
from urllib.parse import urlsplit

import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, Response
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from glbench import __version__
from glbench.errors import GlbenchError, did_you_mean, last_line
from glbench.serve import messages
from glbench.serve.card import card
from glbench.serve.sessions import RequestError, Sessions
from glbench.untrusted import parse_json, quoted, reason_of, visible

LARGEST_BODY = 64 * 1024  # Bytes of a request
BODY_SECONDS = 10.0  # A request that has not arrived after so long is refused
_PATIENCE_SECONDS = 5  # Time that requests under way get when the server is closed
_KEEP_ALIVE_SECONDS = 600  # A connection stays open for so long without a request: agents think slowly
_SWEEP_SECONDS = 30.0

PAGE_POLICY = (
    "default-src 'none'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
)
"""The page loads nothing, asks this server only, and cannot be put into another page."""

T = TypeVar("T")

_LOGGER = logging.getLogger(__name__)

REFUSALS: dict[int | str, dict[str, Any]] = {
    "4XX": {"model": messages.Failure, "description": "what is wrong and what to do; nothing was simulated"}
}
router = APIRouter(prefix="/v1", responses=REFUSALS)


async def act(request: Request, deed: Callable[[Sessions], T]) -> T:
    """``deed`` of the sessions, in the one thread that simulates."""
    state = request.app.state
    return await asyncio.get_running_loop().run_in_executor(state.thread, deed, state.sessions)


@router.get("/health")
async def health(request: Request) -> messages.Health:
    """What is running: version, task, number of sessions."""
    return await act(request, Sessions.health)


@router.get("/task")
async def task(request: Request) -> dict[str, Any]:
    """The task card: units, ranges and meanings of what is observed and done; limits, prices, and what a day is."""
    content: dict[str, Any] = request.app.state.card
    return content


@router.post("/sessions", status_code=201)
async def start(request: Request, body: messages.SeasonRequest | None = None) -> messages.FullObservation:
    """Start a season of the training split, or of another one, in a session of its own."""
    return await act(request, lambda sessions: sessions.start(body or messages.SeasonRequest()).observe())


@router.post("/sessions/{session}/reset")
async def reset(session: str, request: Request, body: messages.SeasonRequest | None = None) -> messages.FullObservation:
    """Start another season in the same session."""
    return await act(request, lambda sessions: sessions.start(body or messages.SeasonRequest(), session).observe())


@router.get("/sessions/{session}/observation")
async def observe(session: str, request: Request) -> messages.FullObservation:
    """What the agent sees now, by name with units and as a vector, and the local time."""
    return await act(request, lambda sessions: sessions.get(session).observe())


@router.get("/sessions/{session}/forecast")
async def forecast(session: str, request: Request) -> messages.Forecast:
    """The coming weather and prices, as far as agents of the task see them."""
    return await act(request, lambda sessions: sessions.get(session).forecast())


@router.post("/sessions/{session}/step")
async def step(session: str, request: Request, body: messages.StepRequest) -> messages.StepAnswer:
    """Act, and let time advance by one step or by several with the same action."""
    return await act(request, lambda sessions: sessions.get(session).step(body))


@router.get("/sessions/{session}/account")
async def account(session: str, request: Request) -> messages.Account:
    """What the season earned and cost so far."""
    return await act(request, lambda sessions: sessions.get(session).account())


@router.get("/sessions/{session}/episode", response_class=Response)
async def episode(session: str, request: Request) -> Response:
    """The record of a season that is over (MCAP), for `glbench view FILE`. It holds the true climate and the states."""
    name, content = await act(request, lambda sessions: sessions.get(session).record())
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type="application/octet-stream", headers=headers)


@router.delete("/sessions/{session}")
async def close(session: str, request: Request) -> messages.Account:
    """Close a session. The answer has the account of its season."""
    return await act(request, lambda sessions: sessions.close(session))


def refusal(error: RequestError) -> JSONResponse:
    """The answer to a request that cannot be met."""
    return JSONResponse(messages.Failure(error=error.problem).model_dump(), error.status)


def unreadable(error: RequestValidationError) -> RequestError:
    """The first problem of a body that does not fit its model, in words."""
    problem = error.errors()[0]
    place = [str(part) for part in problem["loc"] if part not in ("body", "path", "query")]
    field, value = ".".join(place)[:80], problem.get("input")
    fields = {**messages.SeasonRequest.model_fields, **messages.StepRequest.model_fields}
    entry = fields.get(place[-1]) if place else None
    advice = "GET /v1/openapi.json lists the fields of every request, and the page at / has examples."
    if problem["type"] == "extra_forbidden":
        return RequestError(422, f"There is no field {quoted(field)} here.{did_you_mean(field, fields)}", advice, field, value)
    if entry is not None:
        return RequestError(422, f"{field} has an impossible value.", f"Give {entry.description}.", field, value)
    return RequestError(422, "The request needs a JSON object.", advice, "body", value)


class Guard:
    """Lets through what a program on this machine, the server's own page, or an allowed origin sends, as JSON of limited size.

    A web page from elsewhere cannot act through the browser of somebody who has the server running: neither by its own origin, nor under a
    name that its owner points to this machine (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, hosts: Sequence[str], origins: Sequence[str]) -> None:
        self._app, self._hosts, self._origins = app, {name.lower() for name in hosts}, set(origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on with its body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        try:
            self._check_sender(headers)
            body = await self._body(scope, headers, receive)
        except RequestError as error:
            await refusal(error)(scope, receive, send)
            return
        pieces: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

        async def replay() -> Message:
            return pieces.pop() if pieces else await receive()

        try:
            await self._app(scope, replay, send)
        except Exception as error:
            _LOGGER.debug("", exc_info=True)
            _LOGGER.warning("%s %s failed: %s.", scope["method"], visible(scope["path"]), last_line(error))
            advice = "The program that runs it shows what. Report it; GLBENCH_DEBUG=1 shows where."
            await refusal(RequestError(500, "The server made a mistake.", advice))(scope, replay, send)

    def _check_sender(self, headers: dict[str, str]) -> None:
        host = headers.get("host", "")
        own = False
        with contextlib.suppress(ValueError):
            name = (urlsplit(f"//{host}").hostname or "").lower()
            # An IP address is what no stranger's name server can redirect.
            own = name in self._hosts or bool(ipaddress.ip_address(name.partition("%")[0]))
        if not own:
            advice = "Use the address that the server printed at the start, or start it with --host NAME."
            raise RequestError(403, "The server does not answer to this name.", advice, "Host", host)
        origin = headers.get("origin")
        if origin is not None and origin not in self._origins and origin not in (f"http://{host}", f"https://{host}"):
            advice = "If it is yours, start the server with --allow-origin and this origin."
            raise RequestError(403, "A web page of another origin may not call this server.", advice, "Origin", origin)

    async def _body(self, scope: Scope, headers: dict[str, str], receive: Receive) -> bytes:
        body, more = b"", True
        try:
            async with asyncio.timeout(BODY_SECONDS):
                while more:
                    message = await receive()
                    body, more = body + message.get("body", b""), message.get("more_body", False)
                    announced = headers.get("content-length", "0")
                    if len(body) > LARGEST_BODY or not announced.isdecimal() or int(announced[:20]) > LARGEST_BODY:
                        what = f"The request is larger than {LARGEST_BODY // 1024} KiB."
                        advice = "Send one action, by name or as a list."
                        raise RequestError(413, what, advice, "body", f"{announced[:20]} bytes")
        except TimeoutError:
            what = f"The request did not arrive within {BODY_SECONDS:g} s."
            raise RequestError(408, what, "Send it again in one piece.") from None
        kind, query, is_post = headers.get("content-type", ""), scope["query_string"], scope["method"] == "POST"
        if is_post and query:
            advice = 'Send what it says as JSON in the body, such as {"split": "validation"}.'
            raise RequestError(422, "Nothing reads the address after '?'.", advice, "query", query.decode("latin-1"))
        if is_post and (body or kind) and kind.partition(";")[0].strip().lower() != "application/json":
            advice = "Send JSON with Content-Type: application/json (in MATLAB: weboptions('MediaType', 'application/json'))."
            raise RequestError(415, "The request is not marked as JSON.", advice, "Content-Type", kind)
        if body:
            try:
                parse_json(body)
            except ValueError as error:
                place = f": {reason_of(error)}"
                if isinstance(error, json.JSONDecodeError):
                    place = f" (line {error.lineno}, column {error.colno})"
                advice = 'Send an object such as {"steps": 4, "action": [...]}.'
                raise RequestError(400, f"The request is not valid JSON{place}.", advice) from None
        return body


def application(sessions: Sessions, hosts: Sequence[str] = ("localhost",), origins: Sequence[str] = ()) -> FastAPI:
    """The application that serves ``sessions``, in a thread of its own from now on.

    Requests may be addressed to IP addresses and the names ``hosts``. Besides its own page, web pages of ``origins`` may call the API, such
    as ``http://localhost:1880``.
    """
    thread = ThreadPoolExecutor(1, thread_name_prefix="simulation")

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        async def sweep() -> None:
            while True:
                await asyncio.sleep(_SWEEP_SECONDS)
                await loop.run_in_executor(thread, sessions.close_idle)

        sweeping = asyncio.create_task(sweep())
        yield
        sweeping.cancel()
        await loop.run_in_executor(thread, sessions.close_all)
        thread.shutdown()

    title = f"glbench: {sessions.task.title}"
    about = f"Seasons of {sessions.task.id} to act in. Time advances only when a step is asked for."
    app = FastAPI(
        title=title,
        version=__version__,
        description=about,
        lifespan=lifespan,
        redirect_slashes=False,  # curl does not follow: it would print nothing
        docs_url=None,  # Swagger's page loads its script from the internet
        redoc_url=None,
        openapi_url="/v1/openapi.json",
    )
    app.state.sessions, app.state.thread, app.state.card = sessions, thread, card(sessions.task, sessions.splits)
    app.include_router(router)
    page = Template(files("glbench.serve").joinpath("page.html").read_text(encoding="utf-8"))

    @app.get("/", include_in_schema=False)
    async def front(request: Request) -> HTMLResponse:
        idle = ", ".join(f"{one.value(one.idle):g}" for one in sessions.task.actions)
        example = ", ".join(f'"{one.name}": {one.value(one.idle):g}' for one in sessions.task.actions)
        words = {
            "title": title, "id": sessions.task.id, "version": __version__, "splits": ", ".join(sessions.splits),
            "address": str(request.base_url).rstrip("/"), "values": f"{{{example}}}", "split": sessions.splits[0],
            "list": f"[{idle}]",
        }  # fmt: skip
        content = page.substitute({name: escape(str(text), quote=False) for name, text in words.items()})
        return HTMLResponse(content, headers={"Content-Security-Policy": PAGE_POLICY})

    @app.exception_handler(GlbenchError)
    async def refused(_: Request, error: GlbenchError) -> JSONResponse:
        return refusal(error if isinstance(error, RequestError) else RequestError(422, str(error), "Nothing more was done."))

    @app.exception_handler(RequestValidationError)
    async def unfit(_: Request, error: RequestValidationError) -> JSONResponse:
        return refusal(unreadable(error))

    @app.exception_handler(HTTPException)
    async def unknown(request: Request, error: HTTPException) -> JSONResponse:
        path, addresses = request.url.path, [route.path for route in router.routes if hasattr(route, "path")]
        what = f"There is nothing at {quoted(path)}.{did_you_mean(path, addresses)}"
        advice = "The page at / lists all addresses."
        if error.status_code == 405:
            what = f"{quoted(path)} does not take {quoted(request.method)}."
            advice = f"It takes {(error.headers or {}).get('Allow', 'another')}."
        answer = refusal(RequestError(error.status_code, what, advice))
        answer.headers.update(error.headers or {})
        return answer

    app.add_middleware(Guard, hosts=hosts, origins=origins)
    if origins:
        app.add_middleware(
            CORSMiddleware, allow_origins=list(origins), allow_methods=["GET", "POST", "DELETE"], allow_headers=["Content-Type"]
        )
    return app


def bind(host: str, port: int) -> socket.socket:
    """A socket at ``host`` and ``port``; 0 is any free one. Raises ``GlbenchError`` when it is in use, or the host not this machine's."""
    try:
        (family, kind, protocol, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        # With the protocol named, asyncio sends answers at once (TCP_NODELAY); without, each waits 40 ms for an acknowledgement.
        listener = socket.socket(family, kind, protocol)
        with contextlib.ExitStack() as unless_listening:
            unless_listening.enter_context(listener)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(128)
            unless_listening.pop_all()
    except OSError as error:
        why = "there is no such host" if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        msg = (
            f"The server cannot listen at port {port} of {host} ({why}). Choose another port with --port; 0 takes any free one. --host is "
            "an address of this machine, usually 127.0.0.1."
        )
        raise GlbenchError(msg) from error
    return listener


def server_of(app: FastAPI, *, debug: bool = False) -> uvicorn.Server:
    """A server that answers requests under way before it ends. Its ``run`` stops at Ctrl-C and raises it again afterwards."""
    config = uvicorn.Config(
        app,
        log_level="info" if debug else "critical",
        access_log=debug,
        server_header=False,
        timeout_keep_alive=_KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=_PATIENCE_SECONDS,
    )
    return uvicorn.Server(config)

"""Routes of the app. Each answers JSON under /api and a page elsewhere; what is wrong is said in one line."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from tempfile import mkstemp
from typing import Any, TypeAlias

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from mjsim.errors import InputError
from simgap.app import pages
from simgap.app.forms import forms
from simgap.app.guard import WRITTEN_POLICY, Guard
from simgap.app.jobs import Jobs
from simgap.app.preview import Previews
from simgap.app.runs import MissingError, Run, Runs, form_for
from simgap.app.uploads import ARCHIVE, KINDS, MOST_UPLOAD, safe_name
from simgap.terminal import file_error, one_line

__all__ = ["make_app"]

MOST_JSON = 64 * 1024  # bytes of a request other than a file
PAUSE = 0.2  # seconds between two looks at the lines of a job
_TYPES = {".html": "text/html", ".png": "image/png", ".gif": "image/gif", ".mp4": "video/mp4", ".json": "application/json"}
_SHOWN = (".png", ".gif", ".mp4")  # in a page; other files but pages are saved

Handler: TypeAlias = Callable[[Request], Awaitable[Response]]


def make_app(
    folder: Path, token: str, port: int, most_upload: int = MOST_UPLOAD, ending: Callable[[], bool] = lambda: False
) -> Starlette:
    """The ASGI application; ``ending``: whether the server waits for open answers to end.

    Raises InputError where the folder cannot be made.
    """
    app = _App(Runs(folder), Jobs(), Previews(), most_upload, ending)
    return Starlette(
        routes=[Route(path, _told(endpoint), methods=[method]) for method, path, endpoint in app.table()],
        middleware=[Middleware(Guard, token=token, port=port)],
        exception_handlers={404: _missing, 405: _missing},
        lifespan=app.lifespan,
    )


class _App:
    """The endpoints, with the runs and the jobs that they serve."""

    def __init__(self, runs: Runs, jobs: Jobs, previews: Previews, most_upload: int, ending: Callable[[], bool]) -> None:
        self._runs, self._jobs, self._previews, self._most_upload, self._ending = runs, jobs, previews, most_upload, ending

    def table(self) -> list[tuple[str, str, Handler]]:
        """Method, path, endpoint."""
        return [
            ("GET", "/", self.home),
            ("GET", "/compare", self.compare),
            ("GET", "/runs/{run}", self.page),
            ("GET", "/runs/{run}/{command}", self.command),
            ("GET", "/files/{run}/{command}/{name:path}", self.file),
            ("GET", "/static/{name}", self.static),
            ("POST", "/api/runs", self.new),
            ("DELETE", "/api/runs/{run}", self.delete),
            ("POST", "/api/runs/{run}/settings", self.settings),
            ("POST", "/api/runs/{run}/start", self.start),
            ("POST", "/api/runs/{run}/stop", self.stop),
            ("POST", "/api/runs/{run}/copy", self.copy),
            ("GET", "/api/runs/{run}/events", self.events),
            ("GET", "/api/runs/{run}/picture/{name:path}", self.picture),
            ("PUT", "/api/runs/{run}/{kind:str}/{name:path}", self.upload),
            ("DELETE", "/api/runs/{run}/{kind:str}/{name:path}", self.remove),
        ]

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Load the process that draws; stop the children when the server ends."""
        await run_in_threadpool(self._previews.start)
        yield
        await run_in_threadpool(self._previews.close)
        await run_in_threadpool(self._jobs.close, self._runs.all())

    def _run(self, request: Request) -> Run:
        return self._runs.get(request.path_params["run"])

    def _idle(self, request: Request) -> Run:
        """The run, which must not work: its files would change under the command."""
        run = self._run(request)
        if self._jobs.running(run):
            raise InputError(run.name, "a command of this run works", "an idle run", "wait for it, or stop it")
        return run

    async def home(self, _: Request) -> Response:
        """The list of runs."""
        return HTMLResponse(await run_in_threadpool(lambda: pages.home(self._runs.all(), self._jobs)))

    async def compare(self, request: Request) -> Response:
        """The runs that the address names."""
        chosen = [self._runs.get(name) for name in dict.fromkeys(request.query_params.getlist("run"))]
        return HTMLResponse(await run_in_threadpool(pages.comparison, chosen))

    async def page(self, request: Request) -> Response:
        """One run."""
        return HTMLResponse(await run_in_threadpool(pages.run_page, self._run(request), self._jobs))

    async def command(self, request: Request) -> Response:
        """One command of a run: its form, and what it said and wrote."""
        command = request.path_params["command"]
        if command not in forms():
            raise MissingError(command)
        return HTMLResponse(await run_in_threadpool(pages.command_page, self._run(request), self._jobs, command))

    async def file(self, request: Request) -> Response:
        """A file that a command wrote; no other."""
        run, command, name = (request.path_params[k] for k in ("run", "command", "name"))
        found = self._runs.get(run)
        if command not in forms() or name not in found.written(command):
            raise MissingError(name)
        path = found.out(command) / name
        kind = _TYPES.get(path.suffix, "text/plain")
        if kind == "text/html":
            return FileResponse(path, media_type=kind, headers={"Content-Security-Policy": WRITTEN_POLICY})
        if path.suffix in _SHOWN and "save" not in request.query_params:
            return FileResponse(path, media_type=kind)
        return FileResponse(path, media_type=kind, filename=path.name)

    async def picture(self, request: Request) -> Response:
        """A recording as SVG, or why there is no picture of it."""
        run, name = self._run(request), request.path_params["name"]
        if name not in run.recordings:
            raise MissingError(name)
        svg, problem = await run_in_threadpool(self._previews.picture, run.folder, f"recordings/{name}", run.settings.model)
        return JSONResponse({"svg": svg, "problem": problem})

    async def static(self, request: Request) -> Response:
        """Style and script."""
        name = request.path_params["name"]
        if name == "app.css":
            return Response(pages.style(), media_type="text/css")
        if name == "app.js":
            return Response(pages.script(), media_type="text/javascript")
        raise MissingError(name)

    async def new(self, request: Request) -> Response:
        """A new run."""
        name = (await _json(request)).get("name", "")
        return JSONResponse({"id": self._runs.new(name if isinstance(name, str) else "").id}, 201)

    async def copy(self, request: Request) -> Response:
        """A new run with the same model, recordings and settings."""
        run = self._run(request)
        made = await run_in_threadpool(self._runs.new, f"{run.name}, copy", run)
        return JSONResponse({"id": made.id}, 201)

    async def delete(self, request: Request) -> Response:
        """Remove a run."""
        await run_in_threadpool(self._runs.delete, self._idle(request))
        return JSONResponse({})

    async def settings(self, request: Request) -> Response:
        """Change settings."""
        self._idle(request).with_settings(await _json(request))
        return JSONResponse({})

    async def start(self, request: Request) -> Response:
        """Start a command."""
        run, command = self._run(request), (await _json(request)).get("command")
        if not isinstance(command, str):
            raise InputError("command", "none is named", "the name of one")
        form_for(command)
        await run_in_threadpool(self._jobs.start, run, command)
        return JSONResponse({}, 202)

    async def stop(self, request: Request) -> Response:
        """Stop the command that works."""
        await run_in_threadpool(self._jobs.stop, self._run(request))
        return JSONResponse({})

    async def events(self, request: Request) -> Response:
        """The lines of the last command as server-sent events, from the first; ``ended`` when it has ended."""
        job = self._jobs.of(self._run(request))

        async def told() -> AsyncIterator[str]:
            sent = 0
            while job is not None and not self._ending():
                over = job.code is not None  # before the lines, so that none is missed
                for line in job.lines[sent:]:
                    yield f"data: {json.dumps(line)}\n\n"
                    sent += 1
                if over:
                    break
                await asyncio.sleep(PAUSE)
            yield "event: ended\ndata: null\n\n"

        return StreamingResponse(told(), media_type="text/event-stream")

    async def upload(self, request: Request) -> Response:
        """Keep a file, or unpack a ZIP archive: beside its final name first, so that none is half there."""
        run = self._idle(request)
        kind, name = request.path_params["kind"], request.path_params["name"]
        if kind not in KINDS:
            raise MissingError(kind)
        packed = name.lower().endswith(ARCHIVE)
        path = run.folder / kind / safe_name(name) if packed else run.place(kind, name)
        folder = run.folder / kind
        handle, scratch = mkstemp(dir=folder, prefix=".", suffix=".part")
        try:
            with open(handle, "wb") as out:
                async for part in _limited(request, self._most_upload, path.name):
                    out.write(part)
            run = self._idle(request)
            if packed:
                kept = await run_in_threadpool(run.unpack, kind, Path(scratch), path.name)
                told: dict[str, Any] = {"names": kept.names, "left_out": kept.left_out}
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                Path(scratch).replace(path)
                told = {"name": path.relative_to(folder).as_posix()}
        finally:
            with suppress(FileNotFoundError):
                Path(scratch).unlink()
        if kind == "model":
            await run_in_threadpool(self._run(request).choose_model)
        return JSONResponse(told, 201)

    async def remove(self, request: Request) -> Response:
        """Remove an uploaded file or folder."""
        run = self._idle(request)
        await run_in_threadpool(run.remove, request.path_params["kind"], request.path_params["name"])
        return JSONResponse({})


async def _json(request: Request) -> dict[str, Any]:
    """The object that a request holds. Raises InputError for anything else."""
    body = b"".join([part async for part in _limited(request, MOST_JSON, "the request")])
    try:
        content = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError("the request", "it holds no JSON object", "an object")
    return content


class _TooLargeError(InputError):
    """More bytes than a request may hold."""


async def _limited(request: Request, most: int, what: str) -> AsyncIterator[bytes]:
    """The parts of a body of at most so many bytes, declared or not."""
    declared = request.headers.get("content-length", "0")
    total = int(declared) if declared.isdigit() else 0
    refusal = _TooLargeError(
        what, "too large", f"at most {most / 2**20:.4g} MiB", "use simgap on the command line, which has no such limit"
    )
    if total > most:
        raise refusal
    total = 0
    async for part in request.stream():
        total += len(part)
        if total > most:
            raise refusal
        yield part


def _told(endpoint: Handler) -> Handler:
    """An endpoint whose errors are one line: 400, 404, 413, 500."""

    async def answer(request: Request) -> Response:
        try:
            return await endpoint(request)
        except _TooLargeError as error:
            return _line(request, str(error), 413)
        except InputError as error:
            return _line(request, str(error), 400)
        except MissingError:
            return await _missing(request, None)
        except ClientDisconnect:
            return _line(request, "the request was broken off", 400)
        except OSError as error:
            return _line(request, file_error(error), 500)

    return answer


async def _missing(request: Request, _: object) -> Response:
    return _line(request, "there is no such run, file or page", 404)


def _line(request: Request, text: str, status: int) -> Response:
    if request.url.path.startswith("/api/"):
        return JSONResponse({"error": one_line(text)}, status)
    return HTMLResponse(pages.problem(one_line(text)), status)

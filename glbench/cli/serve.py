"""``glbench serve``: a task over HTTP, so that a program in any language can act in it."""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import re
import socket
from pathlib import Path
from typing import Annotated

import typer

from glbench.cli.console import count, debugging, messages, print_warning, tell
from glbench.cli.options import task_or_default
from glbench.errors import EpisodeError, GlbenchError, refuse
from glbench.extras import require


def serve(
    task: Annotated[str | None, typer.Argument(metavar="[TASK]", help="Task id or task file (.toml). Default: the benchmark's.")] = None,
    port: Annotated[int, typer.Option("--port", "-p", min=0, max=65535, help="Port; 0 takes any free one.")] = 8000,
    host: Annotated[str, typer.Option("--host", help="Address to listen at. Another than this one lets other machines in.")] = "127.0.0.1",
    sessions: Annotated[int, typer.Option("--sessions", min=1, max=1000, help="Seasons that may be open at once.")] = 16,
    idle_minutes: Annotated[float, typer.Option("--idle-minutes", min=0.1, help="Close a session after so long without use [min].")] = 60.0,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of the first season that names none. Default: 10,000,000,000.")] = None,
    episodes: Annotated[
        Path | None, typer.Option("--episodes", help="Write the season of every session here when it ends (.mcap).")
    ] = None,
    allow_origin: Annotated[
        list[str] | None, typer.Option("--allow-origin", help="Origin of a web page that may call it, such as http://localhost:1880.")
    ] = None,
) -> None:
    """Serve seasons of a task over HTTP: a climate computer, MATLAB, Node-RED, a browser or a language model acts.

    Seasons are of the training or the validation split, and time advances only when a step is asked for. Nothing counts as a score.
    """
    require("glbench serve", "serve", "fastapi", "uvicorn")
    from glbench.tasks.record import FIRST_TRAINING_SEED
    from glbench.untrusted import LARGEST_INTEGER

    first_seed, last = FIRST_TRAINING_SEED if seed is None else seed, LARGEST_INTEGER - 2**32
    if not FIRST_TRAINING_SEED <= first_seed <= last:
        why = "is not for trying agents: tasks are scored with such seeds" if first_seed < FIRST_TRAINING_SEED else "is too large"
        refuse(f"--seed {first_seed:,} {why}. Use one from {FIRST_TRAINING_SEED:,} to {last:,}.", GlbenchError)
    origins = [text.rstrip("/").lower() for text in allow_origin or ()]
    for text in origins:
        if not re.fullmatch(r"https?://([\w.-]+|\[[\da-f:]+\])(:\d+)?", text):
            reason = f"--allow-origin {text} is not the origin of a web page. Give scheme, host and port, such as http://localhost:1880."
            refuse(reason, GlbenchError)
    with messages().status("preparing the task"):
        from glbench.evaluation.files import ensure_writable
        from glbench.serve.app import application, bind, server_of
        from glbench.serve.sessions import Sessions

        seasons = Sessions(task_or_default(task), most=sessions, idle_minutes=idle_minutes, first_seed=first_seed, folder=episodes)
        if episodes is not None:
            ensure_writable(episodes)
        listener = bind(host, port)
        app = application(seasons, ("localhost", host, socket.gethostname()), origins)
        app.state.thread.submit(seasons.prepare).result()
    address = listener.getsockname()[0]
    if not ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        print_warning(
            f"Whoever reaches this machine over the network (--host {host}) can start seasons and act in them: there is no password. "
            "Use it in a network that you trust."
        )
    name = f"[{address}]" if ":" in address else address
    tell(f"{seasons.task.id} is at http://{name}:{listener.getsockname()[1]}/ (open it in a browser). Ctrl-C closes it.")
    if debugging():
        logger = logging.getLogger("glbench.serve")
        logger.setLevel(logging.DEBUG)
        logger.addHandler(logging.StreamHandler())
    with contextlib.suppress(KeyboardInterrupt):
        server_of(app, debug=debugging()).run(sockets=[listener])
    where = f" Episodes of those with a step are in {episodes}." if episodes is not None and seasons.at_end > seasons.unsaved else ""
    tell(f"\nClosed, with {count(seasons.at_end, 'session')} open.{where}")
    if seasons.unsaved:
        refuse(f"{count(seasons.unsaved, 'episode')} could not be written (see above): these seasons are lost.", EpisodeError)

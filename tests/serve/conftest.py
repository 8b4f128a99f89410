"""A server in a thread of this process, on a free port of this machine, and a client that keeps its connection."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from glbench.serve.app import application, bind, server_of
from glbench.serve.sessions import Sessions
from glbench.tasks import TaskSpec, get_task

COMMAND = [sys.executable, "-c", "from glbench_command import main; main()", "serve"]
JSON = {"Content-Type": "application/json"}


@dataclass
class Client:
    """Calls the API at ``port``."""

    port: int
    connection: http.client.HTTPConnection = field(init=False)

    def __post_init__(self) -> None:
        self.connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)

    def raw(self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None) -> tuple[int, bytes]:
        self.connection.request(method, path, body, JSON if headers is None else headers)
        answer = self.connection.getresponse()
        return answer.status, answer.read()

    def call(self, method: str, path: str, body: object = None) -> tuple[int, Any]:
        status, content = self.raw(method, f"/v1{path}", None if body is None else json.dumps(body).encode())
        return status, json.loads(content)

    def ok(self, method: str, path: str, body: object = None) -> Any:
        status, content = self.call(method, path, body)
        assert status in (200, 201), content
        return content


@contextlib.contextmanager
def served(sessions: Sessions, **options: Any) -> Iterator[Client]:
    """A client of a server with these sessions, which is closed afterwards."""
    listener = bind("127.0.0.1", 0)
    server = server_of(application(sessions, **options))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    client = Client(listener.getsockname()[1])
    try:
        yield client
    finally:
        client.connection.close()
        server.should_exit = True
        thread.join(60)
        assert not thread.is_alive()


@contextlib.contextmanager
def process_of(task: str, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command at a free port: the process, which ends afterwards, and its address."""
    process = subprocess.Popen([*COMMAND, task, "--port", "0", *options], stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        match = re.fullmatch(r"glbench/\S+ is at (http://127\.0\.0\.1:\d+)/ \(open it in a browser\)\. Ctrl-C closes it\.\n", line)
        assert match, line
        yield process, match[1]
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="session")
def task() -> TaskSpec:
    """Two days of the default task, with its splits, sensors and forecasts."""
    return get_task("Spring-v1").replace({"weather.days": 2})


@pytest.fixture(scope="module")
def client(task: TaskSpec) -> Iterator[Client]:
    with served(Sessions(task, most=50)) as one:
        yield one


@pytest.fixture
def session(client: Client) -> Iterator[str]:
    """A session that was just started."""
    name: str = client.ok("POST", "/sessions", {"seed": 10_000_000_007})["session"]
    yield name
    client.call("DELETE", f"/sessions/{name}")

"""The command: it starts, says where, ends with Ctrl-C, and refuses in words; the examples of docs/serve.md run."""

from __future__ import annotations

import json
import re
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.episodes import read_episode
from glbench.serve import app
from tests.serve.conftest import COMMAND, Client, process_of
from tests.support import DOCS, examples_of, run_examples

PAGE = "serve.md"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.Popen[str], str, Path]]:
    """The command at a free port: process, address, and the folder of its episodes."""
    folder = tmp_path_factory.mktemp("serve") / "seasons"
    with process_of("Spring-v1", "--episodes", str(folder)) as (process, address):
        yield process, address, folder


@pytest.mark.slow
def test_the_examples_of_the_page_run(server: tuple[subprocess.Popen[str], str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    _, address, _ = server
    examples = [text.replace("http://127.0.0.1:8000", address) for text in examples_of(PAGE)]
    assert examples
    run_examples(PAGE, examples, {})
    assert "EUR m-2" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl on this machine")
def test_the_curl_commands_of_the_page_run(server: tuple[subprocess.Popen[str], str, Path]) -> None:
    _, address, _ = server
    (block,) = re.findall(r"```console\n(curl .*?)```", (DOCS / PAGE).read_text(encoding="utf-8"), re.DOTALL)
    session = ""
    for command in block.replace("\\\n", " ").strip().splitlines():
        text = command.replace("http://127.0.0.1:8000", address).replace("SESSION", session)
        answer = json.loads(subprocess.run(text, shell=True, capture_output=True, text=True, check=True, timeout=120).stdout)
        assert "error" not in answer
        session = answer.get("session", session)
    assert answer["step"] == 4


@pytest.mark.slow
def test_ctrl_c_closes_it_and_keeps_what_was_done(server: tuple[subprocess.Popen[str], str, Path]) -> None:
    process, address, folder = server
    client = Client(int(address.rpartition(":")[2]))
    before = client.ok("GET", "/health")["sessions"]
    name = client.ok("POST", "/sessions", {"seed": 10_000_000_123})["session"]
    client.ok("POST", f"/sessions/{name}/step", {"action": [0.0] * 6, "steps": 96})
    client.connection.close()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert f"Closed, with {before + 1} session{'s' if before else ''} open. Episodes of those with a step are in {folder}." in errors
    assert "Traceback" not in errors
    assert read_episode(folder / "Spring-v1-training-seed-10000000123-1.mcap").steps == 96


def refused(*arguments: str) -> str:
    ended = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=300)
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    return ended.stderr


@pytest.mark.slow
def test_letting_other_machines_in_is_said() -> None:
    process = subprocess.Popen([*COMMAND, "--port", "0", "--host", "0.0.0.0"], stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        assert "Whoever reaches this machine over the network (--host 0.0.0.0) can start seasons" in process.stderr.readline()
    finally:
        process.kill()
        process.communicate()


def test_answers_are_sent_at_once() -> None:
    """asyncio turns Nagle's algorithm off for sockets that name TCP; otherwise every answer takes 40 ms."""
    with app.bind("127.0.0.1", 0) as listener:
        assert listener.proto == socket.IPPROTO_TCP


@pytest.mark.slow
def test_a_port_in_use_and_a_host_of_others_are_refused_in_words() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"cannot listen at port {port} of 127.0.0.1 (Address already in use). Choose another port with --port" in refused(
            "--port", str(port)
        )
    with pytest.raises(app.GlbenchError, match=r"port 0 of no\.such\.host\.invalid \(there is no such host\)"):
        app.bind("no.such.host.invalid", 0)
    with pytest.raises(app.GlbenchError, match=r"cannot listen at port 0 of 192\.0\.2\.1 \(Cannot assign requested address\)"):
        app.bind("192.0.2.1", 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--allow-origin", "*"), "--allow-origin * is not the origin of a web page"),
        (("--allow-origin", "http://a.example/page"), "Give scheme, host and port"),
        (("--seed", "10000"), "--seed 10,000 is not for trying agents"),
        (("--seed", "9007199254740991"), "--seed 9,007,199,254,740,991 is too large"),
        (("--episodes", __file__), "Choose a folder that you can write to"),
        (("Sprung-v1",), "Spring-v1"),
    ],
)
def test_impossible_options_are_refused_in_words(arguments: tuple[str, ...], words: str) -> None:
    assert words in refused(*arguments)

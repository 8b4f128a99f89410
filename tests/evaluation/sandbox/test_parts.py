"""The parts of the sandbox that need none."""

from __future__ import annotations

import os
import struct
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.evaluation.sandbox.bubblewrap import system_call_filter
from glbench.evaluation.sandbox.frames import HEADER, Prints, SandboxLimits, packed_problems, unpacked_problems
from glbench.evaluation.sandbox.process import Watch
from glbench.evaluation.sandbox.runners import told_failure, words


def test_a_header_has_16_bytes() -> None:
    assert HEADER.size == 16


@given(st.dictionaries(st.integers(0, 2**32 - 1), st.text(max_size=200), max_size=5))
def test_problems_survive_the_way(problems: dict[int, str]) -> None:
    assert {row: text.decode() for row, text in unpacked_problems(packed_problems(problems))} == {
        row: text.encode("utf-8", errors="replace").decode() for row, text in problems.items()
    }


@given(st.binary(max_size=64))
def test_bytes_that_are_no_problems_are_refused_or_read_within_bounds(body: bytes) -> None:
    try:
        texts = [text for _, text in unpacked_problems(body)]
    except ValueError:
        return
    assert sum(map(len, texts)) <= len(body)


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_prints_keep_the_beginning_and_the_end(pieces: list[bytes]) -> None:
    prints, whole = Prints(200), b"".join(pieces)
    for piece in pieces:
        prints.add(piece)
    kept = Prints(10**6)
    kept.add(whole)

    if len(whole) <= 200:
        assert prints.text() == kept.text()
    else:
        assert f"[... {len(whole) - 200:,} bytes left out ...]" in prints.text()


def test_prints_cannot_steer_a_terminal() -> None:
    prints = Prints()
    prints.add("\x1b[2J\x1b]0;title\x07plain \u202etext\r\n\tmore".encode())

    assert prints.text() == "[2J]0;titleplain text\n\tmore"
    assert prints.last_lines(1) == ["\tmore"]


def test_words_are_one_line_of_bounded_length() -> None:
    assert words("a\nb\x1b[1m  c\xff".encode("latin-1"), 100) == "a b[1m c\ufffd"
    assert len(words(b"x" * 10_000, 640)) == 640
    assert words(b"\x1b \n", 640) == "nothing that can be shown"


@pytest.mark.parametrize(
    "reason",
    [
        "ValueError: no idea (agent.py:3 in act)",
        "NotImplementedError (my agent.py:42 in <lambda>)",
        "MemoryError",
        "_glbench_submission_ab.Agent.act.<locals>.E: \u2026",
        'File "<string>", line 1 1 + ^ SyntaxError: invalid syntax (agent.py:3 in act)',
        "ExceptionGroup: two (2 sub-exceptions) (agent.py:3 in act)",
    ],
)
def test_errors_of_python_are_told_as_they_are(reason: str) -> None:
    assert told_failure(1, 1, memoryview(reason.encode())).reason == reason


@pytest.mark.parametrize(
    "reason",
    [
        "act took longer than its limit of 10 s",
        "act (for all runs) took longer than its limit of 10 s (agent.py:3 in act)",
        "the agent's process ended by the signal SIGKILL, by itself or for lack of memory",
        "the agent started more than 128 processes and threads, which is its limit",
        "the run's decisions together took longer than their limit of 2 s",
        "\x1b",
    ],
)
def test_what_the_evaluation_would_say_is_marked_as_the_agents_words(reason: str) -> None:
    assert (told_failure(1, 1, memoryview(reason.encode())).reason or "").startswith("the agent's process said: ")


def test_the_filter_is_a_program_whose_jumps_stay_inside() -> None:
    program = system_call_filter()
    if program is None:
        pytest.skip("the numbers of this processor's system calls are not known")
    instructions = list(struct.iter_unpack("=HBBI", program))

    assert len(instructions) < 4096
    for place, (code, yes, no, _) in enumerate(instructions):
        if code & 0x07 == 0x05:
            assert place + 1 + max(yes, no) < len(instructions)
    assert instructions[-1] == (0x06, 0, 0, 0x7FFF0000)


def test_the_watch_sees_children_and_what_they_hold() -> None:
    code = "x = bytearray(b'x') * (64 << 20); print('ready', flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        small = Watch(os.getpid(), SandboxLimits(memory=32 << 20, tasks=10**6)).complaint()  # other tests left threads
        crowd = Watch(os.getpid(), SandboxLimits(memory=1 << 50, tasks=-8)).complaint()
        wide = Watch(child.pid, SandboxLimits(memory=1 << 30, made=1 << 60)).complaint()  # its /tmp is everybody's
        child.communicate(b"\n")

    assert small is not None
    assert "GiB of memory together" in small
    assert crowd is not None
    assert "processes and threads" in crowd
    assert wide is None

"""A zoo: whatever an agent does to the machine it runs on, the evaluation ends in time with a result that says what happened."""

from __future__ import annotations

import dataclasses
import os
import re
import textwrap
import time
from pathlib import Path

import pytest

from glbench.errors import SubmissionError
from glbench.evaluation import Result, TimeLimits
from glbench.evaluation.sandbox.frames import GIB, MIB, SandboxLimits
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.sandbox.conftest import Prepare, ends

pytestmark = pytest.mark.slow

DEED = """
def act(self, observations):
    self.calls += 1
    if self.calls == 4:
        self.deed()
    return np.zeros((self.n, 6))
def deed(self):
"""
HASTY = TimeLimits(start=120.0, step=1.0, run=600.0)  # of three runs: 3 s a step
PATIENT = TimeLimits(start=120.0, step=30.0, run=600.0)
LATE = r"^act \(for all runs\) took longer than its limit of 3 s$"
NO_ANSWER = "sent what is no answer"
ENDED = "^the agent's process ended "
SAY = """
import gc, socket, struct
fd = next(thing for thing in gc.get_objects() if isinstance(thing, socket.socket)).fileno()
def say(kind, number, length, body=b""):
    os.write(fd, struct.pack("=IIQ", kind, number, length) + body)
"""
IGNORE_ALL = """
while True:
    try:
        while True: time.sleep(1)
    except BaseException: pass
"""
KILL_ALL = """
import signal
for process in range(1, 100):
    if process != os.getpid():
        try: os.kill(process, signal.SIGKILL)
        except OSError: pass
"""
DAEMON = """
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0: time.sleep(1000)
    os._exit(0)
"""
DEAF = """
import signal
for number in range(1, 32):
    try: signal.signal(number, signal.SIG_IGN)
    except OSError: pass
"""
THREAD = """
import threading
threading.Thread(target=lambda: [time.sleep(0.01) for _ in iter(int, 1)], daemon=True).start()
"""
TWO_FILES = """
for name in "ab":
    with open("/tmp/" + name, "wb") as file: file.write(bytes(200 << 20))
"""
MANY_PIPES = """
kept = [os.pipe() for _ in range(100)]
for _ in range(7):
    if os.fork() == 0: time.sleep(1000)
time.sleep(1000)
"""
C_CALL = "import ctypes; c = ctypes.CDLL(None, use_errno=True)\nif c.{0}({1}) < 0: raise OSError(ctypes.get_errno(), '{0}')"

ANIMALS: dict[str, tuple[str, str, str]] = {
    # name: (what it does in its fourth step, status of its runs, reason)
    "exits at once": ("os._exit(3)", "crashed", ENDED + "with exit code 3$"),
    "exits as if all were well": ("os._exit(0)", "crashed", ENDED + "with exit code 0$"),
    "reads where nothing is": ("import ctypes; ctypes.string_at(0)", "crashed", ENDED + "by the signal SIGSEGV$"),
    "aborts": ("os.abort()", "crashed", ENDED + "by the signal SIGABRT$"),
    "kills itself": ("import signal; os.kill(os.getpid(), signal.SIGKILL)", "crashed", ENDED + "by the signal SIGKILL, by itself"),
    "kills its group": ("import signal; os.killpg(0, signal.SIGKILL)", "crashed", ENDED + "by the signal SIGKILL"),
    "stops itself": ("import signal; os.kill(os.getpid(), signal.SIGSTOP)", "timed_out", LATE),
    "loops": ("while True: pass", "timed_out", LATE),
    "loops around every error": (IGNORE_ALL, "timed_out", LATE),
    "loops in C": ("sum(range(10**18))", "timed_out", LATE),
    "sleeps in C": ("import ctypes; ctypes.PyDLL(None).sleep(1000)", "timed_out", LATE),
    "takes memory at once": ("self.kept = np.ones(10**9)", "crashed", "MemoryError"),
    "takes memory piece by piece": ("self.kept = []\nwhile True: self.kept.append(b'x' * 10**6)", "crashed", "^MemoryError"),
    "recurses": ("self.deed()", "crashed", "^RecursionError"),
    "closes all files": ("os.closerange(0, 200)", "crashed", ENDED),
    "closes the connection and goes on": (SAY + "os.close(fd); time.sleep(1000)", "crashed", "closed the connection"),
    "speaks nonsense": (SAY + "os.write(fd, os.urandom(4096)); time.sleep(1000)", "crashed", NO_ANSWER),
    "announces an endless answer": (SAY + "say(20, 5, 2**63); time.sleep(1000)", "crashed", NO_ANSWER),
    "answers another question": (SAY + "say(20, 99, 144, bytes(144))", "crashed", NO_ANSWER),
    "answers too little": (SAY + "say(20, 5, 8, bytes(8))", "crashed", NO_ANSWER),
    "answers in a kind of its own": (SAY + "say(77, 5, 8, bytes(8))", "crashed", NO_ANSWER),
    "answers a question with a question": (SAY + "say(3, 5, 0)", "crashed", NO_ANSWER),
    "fails without a reason": (SAY + "say(23, 5, 0)", "crashed", NO_ANSWER),
    "says that it was too slow": (SAY + "say(23, 5, 5, b'\\x02late')", "crashed", NO_ANSWER + ": a timeout, which is not for it to find"),
    "raises the alarm's own error": (
        "from glbench.evaluation.limits import TimeUp; raise TimeUp", "crashed", r"^glbench.evaluation.limits.TimeUp \(agent_under_test",
    ),
    "says what the evaluation would say": (
        SAY + "say(23, 5, 49, b'\\x01act (for all runs) took longer than its limit of 30 s'[:49])\ntime.sleep(1000)", "crashed",
        "^the agent's process said: act \\(for all runs\\) took longer",
    ),
    "fails with a status of its own": (SAY + "say(23, 5, 2, b'\\x09!')", "crashed", NO_ANSWER),
    "lists problems that are none": (SAY + "say(21, 5, 145, bytes(145))", "crashed", NO_ANSWER),
    "begins an answer and stops": (SAY + "os.write(fd, b'\\x14'); time.sleep(1000)", "timed_out", LATE),
    "answers in nan": (SAY + "say(20, 5, 144, np.full(18, np.nan).tobytes())", "invalid_action", "nan, which is not a finite number"),
    "replaces numpy's functions": (
        "np.zeros = lambda *a: 'zeros'; np.frombuffer = np.ascontiguousarray = lambda *a, **k: 1 / 0", "invalid_action|crashed", "",
    ),
    "fills its disk": (TWO_FILES, "crashed", "^OSError.*No space"),
    "writes a large file": ("open('/tmp/a', 'wb').write(bytes(300 << 20))", "crashed", "File too large"),
    "fills shared memory": ("open('/dev/shm/a', 'wb').write(bytes(100 << 20))", "crashed", "^OSError.*No space"),
    "writes beside itself": ("open(__file__ + '.txt', 'w').write('x')", "crashed", "^OSError.*Read-only"),
    "writes to the root": ("open('/x', 'w')", "crashed", "^(PermissionError|OSError)"),
    "makes devices": ("open('/dev/x', 'w')", "crashed", "^(PermissionError|OSError)"),
    "takes memory without a name": ("os.memfd_create('x')", "crashed", "^PermissionError"),
    "asks the network": ("import socket; socket.create_connection(('1.1.1.1', 53), timeout=1)", "crashed", "^OSError.*family"),
    "asks a name server": ("import socket; socket.getaddrinfo('example.org', 80)", "crashed", "^socket.gaierror"),
    "asks the hypervisor": ("import socket; socket.socket(socket.AF_VSOCK)", "crashed", "^OSError.*family"),
    "looks into the first process": ("open('/proc/1/mem', 'rb').read(1)", "crashed", "^(PermissionError|OSError)"),
    "traces the first process": (C_CALL.format("ptrace", "16, 1, 0, 0"), "crashed", "^PermissionError.*ptrace"),
    "wants namespaces of its own": (C_CALL.format("unshare", "0x10000000"), "crashed", "^PermissionError.*unshare"),
    "wants to be root": ("os.setuid(0)", "crashed", "^(PermissionError|OSError)"),
    "wants its limits raised": (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (1 << 40, 1 << 40))", "crashed", "^(ValueError|PermissionError)",
    ),
    "an error with endless words": ("raise ValueError('x' * 10**8)", "crashed", r"^ValueError: x{300,} \.\.\. "),
    "an error that speaks to the terminal": (
        "raise ValueError('\\x1b[2J\\x1b]0;owned\\x07 \\u202e')", "crashed", r"^ValueError: [^\x1b\x07\u202e]*$",
    ),
    "raises the limits of the first process": (
        "import resource; resource.prlimit(1, resource.RLIMIT_AS, (-1, -1))", "crashed", "^PermissionError",
    ),
    "wants larger buffers": (
        "import socket; socket.socketpair()[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 22)", "crashed", "^PermissionError",
    ),
    "makes more files than it may": (
        "for i in range(100_000): os.close(os.open(f'/tmp/{i}', os.O_CREAT))\ntime.sleep(999)", "crashed", "more than 65,536 files in /tmp",
    ),
    "opens more files than it may": (MANY_PIPES, "crashed", "opened more than 1,024 files, pipes and sockets together"),
    "an error whose class breaks when it is looked at": (
        "class M(type):\n    def __getattribute__(c, n): raise RuntimeError(n)\n"
        "class E(Exception, metaclass=M): pass\nraise E", "crashed", "^E$",
    ),
    "an error that cannot be said": (
        "class E(Exception):\n    def __str__(self): raise self\nraise E", "crashed", "^(E:|.*E.*exception str)",
    ),
}  # fmt: skip


def deed(body: str) -> str:
    return DEED + textwrap.indent(textwrap.dedent(body), "    ")


@pytest.mark.parametrize(("body", "status", "words"), ANIMALS.values(), ids=ANIMALS)
def test_an_agent_that(write_agent: AgentWriter, sandboxed: Prepare, body: str, status: str, words: str) -> None:
    began = time.monotonic()
    limits = HASTY if status == "timed_out" else PATIENT
    result = with_sizes(sandboxed(write_agent(deed(body)), limits=limits), SandboxLimits(memory=GIB))

    assert time.monotonic() - began < 240.0
    (how,) = {run.status for run in result.runs}
    assert how in status.split("|")
    assert {run.steps for run in result.runs} == {3}
    for run in result.runs:
        assert run.reason
        assert len(run.reason) <= 460
        assert matches(words, run.reason)


HARMLESS = {
    "reads the clock": "time.time(); time.perf_counter()",
    "prints without end": "for _ in range(20000): print('x' * 1000)\nsys.stderr.write('y' * 10**6)",
    "writes to its standard output from C": "os.write(1, b'z' * 10**6)",
    "closes its standard output": "os.close(1); os.close(2)",
    "starts a thread that goes on": THREAD,
    "starts a process that goes on": "import subprocess; subprocess.Popen(['sleep', '1000'])",
    "leaves a process behind a daemon's fork": DAEMON,
    "handles every signal": DEAF,
    "wants to outlive a machine that runs out of memory": (
        "for who in ('self', '1'):\n"
        "    assert open(f'/proc/{who}/oom_score_adj').read() == '1000\\n'\n"
        "    try: open(f'/proc/{who}/oom_score_adj', 'w').write('0')\n"
        "    except OSError: pass\n"
        "    else: raise AssertionError(who)\n"
    ),
    "changes the working directory": "os.chdir('/')",
    "kills everybody else": KILL_ALL,
    "lowers its nice value in vain": "os.nice(19)",
    "puts signals into its way": (
        "import signal; signal.signal(signal.SIGALRM, lambda *a: None); signal.setitimer(signal.ITIMER_REAL, 1e-3, 1e-3)"
    ),
    "collects garbage": "import gc; gc.collect(); [type(o) for o in gc.get_objects()]",
}  # fmt: skip


@pytest.mark.parametrize("body", HARMLESS.values(), ids=HARMLESS)
def test_nothing_comes_of_it_when_an_agent(write_agent: AgentWriter, sandboxed: Prepare, body: str) -> None:
    evaluation = sandboxed(write_agent(deed(body)))
    result = evaluation.run()

    assert ends(result) == [("ok", 24)] * 3
    assert len(evaluation.prints.text()) < 70_000


def test_a_slow_leak_ends_in_words(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    leaking = write_agent(
        """
        def act(self, observations):
            self.kept = getattr(self, "kept", []) + [np.ones(5 << 20)]
            return np.zeros((self.n, 6))
        """
    )
    result = with_sizes(sandboxed(leaking), SandboxLimits(memory=GIB // 2))

    assert {run.status for run in result.runs} == {"crashed"}
    assert 3 < result.runs[0].steps < 20
    assert matches("MemoryError", result.runs[0].reason or "")


def test_a_slow_agent_that_is_right_is_right(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    slow = write_agent("def act(self, o):\n    time.sleep(0.05)\n    return np.zeros((self.n, 6))")

    assert ends(sandboxed(slow).run()) == [("ok", 24)] * 3


MARK = str(10**6 + os.getpid())
LEAVE = f"import subprocess; subprocess.Popen(['sleep', '{MARK}'])\n"
BOMBS = {
    "processes": "while True:\n    try: os.fork()\n    except OSError: pass",
    "threads": "import threading; threading.stack_size(65536)\nwhile True:\n    threading.Thread(target=time.sleep, args=(1000,)).start()",
}


@pytest.mark.parametrize("body", BOMBS.values(), ids=BOMBS)
def test_a_bomb_of(write_agent: AgentWriter, sandboxed: Prepare, body: str) -> None:
    result = sandboxed(write_agent(deed(LEAVE + body)), limits=HASTY).run()

    assert {(run.status, run.steps) for run in result.runs} <= {("timed_out", 3), ("crashed", 3)}
    assert survivors() == []


def test_processes_that_take_memory_together_are_ended(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    together = """
        for _ in range(8):
            if os.fork() == 0:
                kept = np.ones(16 << 20)
                time.sleep(1000)
        time.sleep(1000)
        """
    result = with_sizes(sandboxed(write_agent(deed(together)), limits=PATIENT), SandboxLimits(memory=512 * MIB))

    assert ends(result) == [("crashed", 3)] * 3
    assert result.runs[0].reason == "the agent's processes took more than 0.5 GiB of memory together, which is their limit"


def test_answers_ahead_of_their_questions_end_the_process(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    # All in one write: whoever reads the first frame has all others, too, before the next question.
    frames = "b''.join(struct.pack('=IIQ', 20, number, 144) + bytes(144) for number in range(5, 30))"
    result = sandboxed(write_agent(deed(SAY + f"os.write(fd, {frames})\ntime.sleep(1000)"))).run()

    # The first of them is an honest answer.
    assert ends(result) == [("crashed", 4)] * 3
    assert result.runs[0].reason == "the agent's process sent what is no answer: it came before the question"


@pytest.mark.parametrize("body", ["pass", "os._exit(1)", "1 / 0"])
def test_nothing_is_left_running(write_agent: AgentWriter, sandboxed: Prepare, body: str) -> None:
    sandboxed(write_agent(deed(LEAVE + body))).run()

    assert survivors() == []


STARTS = {
    "exits": ("os._exit(5)", "ended with exit code 5"),
    "never ends": ("while True: pass", "loading it took longer than its limit of 5 s"),
    "reads where nothing is": ("import ctypes; ctypes.string_at(0)", "SIGSEGV"),
    "raises something odd": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "takes all memory": ("x = np.ones(10**10)", "MemoryError"),
}


@pytest.mark.parametrize(("body", "words"), STARTS.values(), ids=STARTS)
def test_a_file_that_does_harm_while_it_is_loaded(write_agent: AgentWriter, sandboxed: Prepare, body: str, words: str) -> None:
    path = write_agent()
    path.write_text(path.read_text(encoding="utf-8") + f"\n{body}\n", encoding="utf-8")

    with pytest.raises(SubmissionError, match=words):
        sandboxed(path, limits=TimeLimits(start=5.0 if body.startswith("while") else 120.0)).run()


def test_what_it_printed_is_shown_when_it_dies_while_it_is_loaded(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    path = write_agent()
    path.write_text(path.read_text(encoding="utf-8") + "\nprint('here I stand'); os._exit(5)\n", encoding="utf-8")

    with pytest.raises(SubmissionError, match="It printed:\n  here I stand"):
        sandboxed(path).run()


def with_sizes(evaluation: object, sizes: SandboxLimits) -> Result:
    return dataclasses.replace(evaluation, sizes=sizes).run()  # type: ignore[type-var, attr-defined]


def matches(words: str, reason: str) -> bool:
    return re.search(words, reason) is not None


def survivors() -> list[str]:
    """Command lines of processes that were started by ``LEAVE`` and are still there."""
    deadline = time.monotonic() + 60.0
    while True:
        found = [line for line in map(_command_line, Path("/proc").iterdir()) if MARK in line]
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.05)


def _command_line(process: Path) -> str:
    if not process.name.isdigit() or int(process.name) == os.getpid():
        return ""
    try:
        return (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""

"""``check_submission``: the files first, then the agent for a day as an evaluation would run it, all within seconds."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from glbench.agents.identity import FORM_WORDS, Identity, baseline_names, is_built_in, read_identity
from glbench.agents.loading import find_submission
from glbench.errors import SandboxError, SubmissionError
from glbench.evaluation.sandbox.choosing import Protection, SandboxChoice, protection_of
from glbench.evaluation.sandbox.frames import SandboxLimits
from glbench.evaluation.submitting import findings as files
from glbench.evaluation.submitting.findings import Finding, Report, Subject, note, problem
from glbench.tasks import DEFAULT_TASK, TaskSpec, get_task, task_card

SECONDS = 15.0
"""Time for the whole check [s]; a process that does not end by itself has two seconds more."""
_GRACE = 2.0
_STARTING = 90.0
"""Time for Python, glbench and large packages to be there [s], on however busy a machine."""
_LOOK = 0.02
_PRINTED_NOTE, _PRINTED_KEPT, _SAID_KEPT = 4096, SandboxLimits().printed, 2**20
_SHOWN = 160
_WHERE: dict[Protection, str] = {
    "bubblewrap": "in a sandbox (bubblewrap)",
    "unsandboxed": "unsandboxed, with your rights",
}


def check_submission(
    ref: str | Path,
    task: str | Path | TaskSpec = DEFAULT_TASK,
    *,
    seconds: float = SECONDS,
    sandbox: SandboxChoice = "auto",
) -> Report:
    """Find out what will be wrong with a submission in an evaluation on ``task``.

    Parameters
    ----------
    ref
        Path of the submission.
    task
        Task, its id, or the path of a task file.
    seconds
        Time for the whole check.
    sandbox
        Where the agent runs, as for ``glbench.evaluation.evaluate``. Where it wants a sandbox and there can be none, only files are
        looked at, and the report says so.

    Raises
    ------
    SubmissionError
        When there is no such file or folder, or it is a baseline.
    """
    began = time.monotonic()
    spec = task if isinstance(task, TaskSpec) else get_task(task)
    if str(ref) in baseline_names() and not Path(ref).exists():
        msg = f"'{ref}' is a baseline of glbench and no submission: there is nothing to check. Evaluate it."
        raise SubmissionError(msg)
    path = find_submission(ref)
    if is_built_in(path):
        msg = f"{path} holds settings for a controller of glbench and no code: there is nothing to check. Evaluate it."
        raise SubmissionError(msg)
    book = _Book()
    card, found = files.card_findings(path)
    book.add(found, "card")
    # A wrong card hides what lies behind it: what is wrong with the rest is found out as if there was none.
    broken_card = card is None and any(finding.level == "problem" for finding in found)
    identity = _identity(path, book) if not broken_card else None
    name, what = path.resolve().stem if path.is_file() else path.resolve().name, "a submission"
    if identity is not None:
        what = FORM_WORDS[identity.form]
        _look_at_files(identity, spec, book)
        if not book.hopeless:
            task_ref = str(task) if not isinstance(task, TaskSpec) else spec.id
            left = max(2.0, seconds - (time.monotonic() - began))
            protection = _protection(identity, sandbox, book)
            if protection is not None:
                book.facts["loading"] = _WHERE[protection]
                _probe(path, (task_ref, str(left)), (protection, *files.large_packages(identity)), book)
    return Report(
        name,
        what,
        spec.id,
        tuple(dict.fromkeys(book.findings)),
        frozenset(book.checked),
        book.facts,
        time.monotonic() - began,
    )


@dataclass
class _Book:
    """What was found so far."""

    findings: list[Finding] = field(default_factory=list)
    checked: set[Subject] = field(default_factory=set)
    facts: dict[Subject, str] = field(default_factory=dict)

    def add(self, findings: list[Finding], *subjects: Subject) -> None:
        self.findings += findings
        self.checked |= {*subjects, *(finding.subject for finding in findings)}

    @property
    def hopeless(self) -> bool:
        """Whether running it would only say the same again."""
        return any(
            finding.level == "problem" and finding.subject in {"loading", "packages"} for finding in self.findings
        )


def _identity(path: Path, book: _Book) -> Identity | None:
    try:
        return read_identity(path)
    except SubmissionError as error:
        book.add([problem("files", str(error))], "files")
        return None


def _protection(identity: Identity, choice: SandboxChoice, book: _Book) -> Protection | None:
    """How the agent runs; ``None`` when it may not, which is told."""
    try:
        return protection_of(identity, choice)
    except SandboxError as error:
        book.add([problem("loading", str(error))])
        return None


def _look_at_files(identity: Identity, task: TaskSpec, book: _Book) -> None:
    book.add(files.card_notes(identity))
    book.add(files.size_findings(identity), "files")
    book.facts["files"] = files.size_in_words(identity)
    book.add(files.package_findings(identity), "packages")
    book.add(files.policy_findings(identity, task_card(task)))


def _probe(path: Path, task: tuple[str, str], how: tuple[str, ...], book: _Book) -> None:
    """Run the agent in a process of its own and book what that says, and how it ended.

    ``task`` holds the task and the seconds, ``how`` the protection and the packages to import beforehand.
    """
    reading, writing = os.pipe()
    arguments = [str(path), *task, str(writing), *how]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    process = subprocess.Popen(
        [sys.executable, "-m", "glbench.evaluation.submitting.probe", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, **threads},
        pass_fds=(writing,),
        start_new_session=True,
    )
    os.close(writing)
    said, printed = _Reader(os.fdopen(reading, "rb"), _SAID_KEPT), _Reader(process.stdout, _PRINTED_KEPT)
    try:
        hung = _outlives(process, said)
    finally:
        _end(process)
    told = _book_lines(said.text(), book)
    _book_end(process.returncode, told.stage, hung=hung, printed=printed, book=book)
    # What comes out of a sandbox is counted there; outside of one it is the output of this process.
    _book_printing(max(printed.size, told.printed), book)


def _outlives(process: subprocess.Popen[bytes], said: _Reader) -> bool:
    """Whether the process is still there when its time, of which it tells itself, is over."""
    until = time.time() + _STARTING
    while process.poll() is None:
        first, newline, _ = said.so_far().partition("\n")
        if newline and "deadline" in first:
            until = json.loads(first)["deadline"] + _GRACE
        if time.time() > until:
            return True
        time.sleep(_LOOK)
    return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process and what it started: it leads a session of its own."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@dataclass
class _Told:
    """What the probe said besides its findings: the stage that it was in last (empty at its end), and bytes printed in the sandbox."""

    stage: str = "before it began"
    printed: int = 0


def _book_lines(text: str, book: _Book) -> _Told:
    """Book what the probe said."""
    told = _Told()
    for line in text.splitlines():
        try:
            said: dict[str, Any] = json.loads(line)
        except ValueError:  # cut off by the end of the process
            continue
        told.stage, told.printed = said.get("stage", told.stage), said.get("printed", told.printed)
        if "finding" in said:
            book.add([Finding(**said["finding"])])
        if "checked" in said:
            book.checked.add(said["checked"])
        book.facts.update(said.get("fact", {}))
    return told


def _book_end(code: int, stage: str, *, hung: bool, printed: _Reader, book: _Book) -> None:
    if not stage:
        return
    subject: Subject = "decisions" if "act" in stage.split() or "act," in stage.split() else "loading"
    last = printed.last_line()
    heard = f' Its last words: "{last}"' if last else ""
    if hung:
        book.add([problem("time", f"It did not come back {stage}: it hangs, or waits for something.{heard}")])
    elif code < 0:
        name = signal.Signals(-code).name
        why = (
            "a crash in compiled code, or no memory left"
            if name in {"SIGSEGV", "SIGKILL", "SIGABRT", "SIGBUS"}
            else "a signal"
        )
        book.add([problem(subject, f"The process of the agent was ended by {name} {stage} ({why}).{heard}")])
    else:
        book.add([problem(subject, f"The process of the agent ended {stage}, with exit code {code}.{heard}")])


def _book_printing(size: int, book: _Book) -> None:
    book.checked.add("printing")
    said = f"It prints {size / 1024:,.0f} KiB in this short run"
    if size > _PRINTED_KEPT:
        text = f"{said}. Of an evaluation only the beginning and the end are kept, and printing takes time."
        book.add([problem("printing", text)])
    elif size > _PRINTED_NOTE:
        book.add([note("printing", f"{said}. Of an evaluation only the beginning and the end are kept.")])
    if size:
        book.facts["printing"] = f"{size} bytes"


class _Reader:
    """Reads a pipe to its end in a thread; keeps the first bytes and the last, and counts all."""

    def __init__(self, stream: IO[bytes] | None, keep: int) -> None:
        self.size = 0
        self._keep = keep
        self._head = b""
        self._tail = b""
        self._stream = stream
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        if self._stream is None:
            return
        with self._stream as stream:
            while part := stream.read1(65536):  # type: ignore[attr-defined]
                self.size += len(part)
                self._head += part[: max(self._keep - len(self._head), 0)]
                self._tail = (self._tail + part)[-2000:]

    def so_far(self) -> str:
        """The first bytes that have come until now, as text."""
        return self._head.decode("utf-8", errors="replace")

    def text(self) -> str:
        """The first bytes as text, once the other end is closed."""
        self._thread.join(_GRACE)
        return self._head.decode("utf-8", errors="replace")

    def last_line(self) -> str:
        """The last line that is not empty."""
        self._thread.join(_GRACE)
        lines = [line.strip() for line in self._tail.decode("utf-8", errors="replace").splitlines() if line.strip()]
        return lines[-1][:_SHOWN] if lines else ""

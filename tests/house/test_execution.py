"""Every executor runs jobs in the same way: in this process, in others, and on a Ray cluster."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from glbench.errors import GlbenchError, TrainingError
from glbench.execution import (
    RETRIES,
    Executor,
    InlineExecutor,
    JobContext,
    JobError,
    JobStore,
    ProcessExecutor,
    RayExecutor,
    WorkerLostError,
    read_files,
    write_files,
)

MakeExecutor = Callable[[int], AbstractContextManager[Executor]]
_RAY = pytest.param(
    lambda workers: RayExecutor(workers=workers),
    id="ray",
    marks=[
        pytest.mark.slow,
        pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed"),
        # Ray leaves files and sockets for the end of the process.
        pytest.mark.filterwarnings("ignore::ResourceWarning"),
        pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
        pytest.mark.filterwarnings("ignore::FutureWarning"),
        pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    ],
)
everywhere = pytest.mark.parametrize(
    "make_executor", [pytest.param(lambda workers: InlineExecutor(), id="inline"), pytest.param(ProcessExecutor, id="processes"), _RAY]
)
elsewhere = pytest.mark.parametrize("make_executor", [pytest.param(ProcessExecutor, id="processes"), _RAY])


def square(context: JobContext, number: int) -> int:
    for part in range(number):
        context.send((number, part))
    if number == 3:
        msg = "three\nis too many"
        raise ValueError(msg)
    if number == 4:
        msg = "four cannot be trained"
        raise TrainingError(msg)
    return number**2


def ask_three_times(context: JobContext) -> list[int]:
    assert context.folder is not None
    for number in range(3):
        (context.folder / "asked").write_text(str(number), encoding="utf-8")
        try:
            context.ask(number)
        finally:
            context.return_folder()
    return [1, 2, 3]


def endless(context: JobContext, file: Path | None = None) -> None:
    if file is not None:
        file.write_text(str(os.getpid()), encoding="utf-8")
    context.send("begin")
    while True:
        time.sleep(0.05)


def lose_worker(context: JobContext, losses: int) -> str:
    """End the process, until that has happened ``losses`` times."""
    assert context.folder is not None
    file = context.folder / "losses"
    count = int(file.read_text(encoding="utf-8")) if file.exists() else 0
    if count < losses:
        file.write_text(str(count + 1), encoding="utf-8")
        context.send(count, save=True)
        time.sleep(0.5)
        os._exit(7)
    return f"after {count}"


@everywhere
def test_jobs_give_values_errors_and_events(make_executor: MakeExecutor) -> None:
    events: dict[int, list[Any]] = {number: [] for number in range(6)}
    with make_executor(2) as executor:
        futures = {executor.submit(square, number, listener=events[number].append): number for number in events}
        outcomes: dict[int, Any] = {}
        for future in executor.as_completed():
            try:
                outcomes[futures[future]] = future.result()
            except GlbenchError as error:
                outcomes[futures[future]] = error
            except ValueError as error:  # in this process
                outcomes[futures[future]] = JobError(f"ValueError: {str(error).splitlines()[0]}")
    assert {number: outcomes[number] for number in (0, 1, 2, 5)} == {0: 0, 1: 1, 2: 4, 5: 25}
    assert isinstance(outcomes[3], JobError)
    assert str(outcomes[3]) == "ValueError: three"
    assert isinstance(outcomes[4], TrainingError)
    assert events == {number: [(number, part) for part in range(number)] for number in range(6)}


@everywhere
def test_items_are_taken_when_there_is_room(make_executor: MakeExecutor) -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for number in (0, 1, 2, 5, 6):
            taken.append(number)
            yield number

    def submit(number: int) -> Any:
        if number == 2:
            msg = "not two"
            raise GlbenchError(msg)
        return executor.submit(square, number)

    ended: list[int] = []
    with make_executor(2) as executor:
        for item, future in executor.map_as_completed(submit, items()):
            assert len(taken) - len(ended) <= 2 + 1
            ended.append(item)
            if item == 2:
                with pytest.raises(GlbenchError, match="not two"):
                    future.result()
            else:
                assert future.result() == item**2
    assert sorted(ended) == [0, 1, 2, 5, 6]


@everywhere
def test_a_listener_that_raises_stops_its_job_where_it_asked(make_executor: MakeExecutor, tmp_path: Path) -> None:
    def listen(number: int) -> None:
        if number == 1:
            msg = "enough"
            raise TrainingError(msg)

    folders = [tmp_path / name for name in ("stopped", "whole")]
    for folder in folders:
        folder.mkdir()
    with make_executor(2) as executor:
        stopped = executor.submit(ask_three_times, listener=listen, folder=folders[0], save=write_files)
        whole = executor.submit(ask_three_times, folder=folders[1], save=write_files)
        assert set(executor.as_completed()) == {stopped, whole}
    with pytest.raises(TrainingError, match="enough"):
        stopped.result()
    assert whole.result() == [1, 2, 3]
    assert [read_files(folder) for folder in folders] == [{"asked": b"1"}, {"asked": b"2"}]


@elsewhere
def test_a_listener_that_raises_ends_a_job_that_asks_nothing(make_executor: MakeExecutor) -> None:
    def listen(event: str) -> None:
        raise TrainingError(event)

    with make_executor(1) as executor:
        endless_job = executor.submit(endless, listener=listen)
        (future,) = executor.as_completed()
        assert future is endless_job
        with pytest.raises(TrainingError, match="begin"):
            future.result()


@elsewhere
def test_a_job_whose_worker_was_lost_goes_on_from_what_it_saved(make_executor: MakeExecutor, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("twice", "always")]
    for folder in folders:
        folder.mkdir()
    with make_executor(2) as executor:
        twice = executor.submit(lose_worker, 2, folder=folders[0], save=write_files)
        always = executor.submit(lose_worker, RETRIES + 1, folder=folders[1], save=write_files)
        assert set(executor.as_completed()) == {twice, always}
    assert twice.result() == "after 2"
    with pytest.raises(WorkerLostError, match=f"lost {RETRIES + 1} times"):
        always.result()


def test_processes_end_with_the_block(tmp_path: Path) -> None:
    files = [tmp_path / name for name in "ab"]

    def run() -> None:
        with ProcessExecutor(2) as executor:
            first, _ = (executor.submit(endless, file, listener=events.append) for file in files)
            while len(events) < 2:
                executor._poll()
            executor.cancel(first)
            raise KeyboardInterrupt

    events: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        run()
    for file in files:
        with pytest.raises(ProcessLookupError):
            os.kill(int(file.read_text(encoding="utf-8")), 0)


def test_the_store_listens_to_the_last_try_alone_and_keeps_what_the_one_before_saved() -> None:
    store = JobStore()
    store.put("job", {"a": b"1"})
    assert store.begin("job", "first") == {"a": b"1"}
    store.tell("job", "first", 4, [("began", False)], {"a": b"2"})
    updates = store.updates(["job", "other"])
    update = updates["job"]
    assert (update.progress, update.events, update.files) == (4, [("began", False)], {"a": b"2"})
    assert store.updates(["job"]) == {}, "told once"
    assert store.begin("job", "second") == {"a": b"2"}
    store.tell("job", "first", 9, [("late", False)], {"a": b"3"})
    assert store.updates(["job"]) == {}
    assert store.answers("job", "first") == [False], "a try that nobody listens to is to stop"
    store.answer("job", "first", go_on=True)
    store.answer("job", "second", go_on=True)
    assert store.answers("job", "second") == [True]


def test_an_address_where_nobody_answers_is_refused_at_once() -> None:
    pytest.importorskip("ray", reason="ray is not installed (extra 'ray')")
    with (
        pytest.raises(GlbenchError, match=r"no Ray cluster at 127\.0\.0\.1:1: .*refused\. `--engine local` needs none"),
        RayExecutor("127.0.0.1:1"),
    ):
        pass


def test_without_ray_its_engine_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr("glbench.extras.find_spec", lambda name: None)
    with pytest.raises(GlbenchError, match=r"glbench\[ray\]"):
        RayExecutor()

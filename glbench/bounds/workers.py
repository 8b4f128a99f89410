"""Where plans are made: in this process, in several processes, or on the workers of a Ray cluster."""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench import __version__
from glbench.agents.plans import PlanBook
from glbench.bounds.replay import replayed
from glbench.children import end_with_parent
from glbench.control import Iteration, Scenario, plan_season
from glbench.errors import GlbenchError
from glbench.evaluation.engines.cluster import LOOK_SECONDS, TRIES, Cluster, Teller, board_of, in_words, one_thread
from glbench.evaluation.engines.luggage import Luggage, PackedTask
from glbench.tasks import TaskSpec

METHOD = "sequential convex programming"

Listener = Callable[[int, Iteration], None]
"""Called after every iteration, with the seed of the plan."""


@dataclass(frozen=True, eq=False)
class PlanJob:
    """Everything a worker needs to plan the runs with ``seeds``, which have identical conditions."""

    task: PackedTask
    seeds: tuple[int, ...]
    controls: NDArray[np.float64]
    start: str
    iterations: int


def planned(job: PlanJob, listener: Listener | None = None) -> PlanBook | str:
    """A book with the ordered plan, or a message saying why there is none."""
    try:
        task, seed = job.task.unpacked(), job.seeds[0]
        plan = plan_season(
            Scenario.of(task, seed),
            job.controls,
            iterations=job.iterations,
            watch=None if listener is None else partial(listener, seed),
        )
        book = PlanBook.of(task, job.seeds, plan.actions(), {"method": METHOD, "iterations": job.iterations})
        return book.with_about(glbench=__version__, **replayed(task, book, [seed])[seed]._asdict())
    except GlbenchError as error:
        return str(error)


def here(jobs: Sequence[PlanJob], workers: int, listener: Listener | None) -> Iterator[tuple[PlanJob, PlanBook | str]]:
    """Plan on this machine, in this process or in ``workers`` others; each plan is yielded as soon as it is done."""
    if min(workers, len(jobs)) <= 1:
        yield from ((job, planned(job, listener)) for job in jobs)
        return
    context = multiprocessing.get_context("spawn")
    told = context.Queue()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(told,))
    try:
        running = {pool.submit(_planned_there, job): job for job in jobs}
        waiting = set(running)
        while waiting:
            done, waiting = wait(waiting, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
            _listen(told, listener)
            yield from ((running[one], one.result()) for one in done)
    except BaseException:  # whoever interrupts does not want to wait for the plans under way
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def on_ray(
    jobs: Sequence[PlanJob], cluster: Cluster, task: TaskSpec, listener: Listener | None
) -> Iterator[tuple[PlanJob, PlanBook | str]]:
    """Plan on a Ray cluster; if a worker is lost, its plan is restarted on another one."""
    if not jobs:
        return
    luggage = Luggage.of([task], for_plans=True)
    with cluster.connected() as ray:
        work, board, files = ray.remote(num_cpus=1, max_retries=TRIES)(_planned_on_ray), board_of(ray), ray.put(luggage)
        running = {work.remote(job, files, board): job for job in jobs}
        while running:
            ready, _ = ray.wait(list(running), num_returns=1, timeout=LOOK_SECONDS)
            news = ray.get(board.news.remote([str(job.seeds[0]) for job in running.values()]))
            if listener is not None:
                for seed, one in news.items():
                    for iteration in one.events:
                        listener(int(seed), iteration)
            for one in ready:
                job = running.pop(one)
                try:
                    given = ray.get(one)
                except Exception as error:  # of Ray: a worker that was lost
                    given = str(in_words(error))
                yield job, given


def _planned_on_ray(job: PlanJob, luggage: Luggage, board: Any) -> PlanBook | str:
    one_thread()
    luggage.unpack()
    teller = Teller(board, str(job.seeds[0]))
    teller.begin()  # an earlier try left nothing: a plan takes minutes, and starts again
    return planned(job, lambda _seed, iteration: teller.tell(iteration))


_TOLD: list[Any] = []
"""In a process of the pool: the queue to the listener."""


def _begin(told: Any) -> None:
    end_with_parent()
    _TOLD.append(told)


def _planned_there(job: PlanJob) -> PlanBook | str:
    return planned(job, lambda seed, iteration: _TOLD[0].put((seed, iteration)))


def _listen(told: Any, listener: Listener | None) -> None:
    while True:
        try:
            seed, iteration = told.get_nowait()
        except queue.Empty:
            return
        if listener is not None:
            listener(seed, iteration)

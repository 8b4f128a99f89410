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
from glbench.control import Iteration, Scenario, plan_season
from glbench.episodes.definition import task_of
from glbench.errors import GlbenchError
from glbench.evaluation.engines.ray import RayEngine

METHOD = "sequential convex programming"
_LOOK_SECONDS = 0.5

Listener = Callable[[int, Iteration], None]
"""Called after every iteration, with the seed of the plan."""


@dataclass(frozen=True, eq=False)
class Order:
    """Everything a worker needs to plan the runs with ``seeds``, which have identical conditions."""

    definition: bytes
    split: str
    digest: str
    seeds: tuple[int, ...]
    controls: NDArray[np.float64]
    start: str
    iterations: int
    version: str = __version__


def planned(order: Order, listener: Listener | None = None) -> PlanBook | str:
    """A book with the ordered plan, or a message saying why there is none."""
    try:
        task = task_of(order.definition)
        task = task.in_split(order.split) if order.split else task
        if (order.version, order.digest) != (__version__, task.digest):
            return "The worker has another glbench or another version of the task than this machine."
        seed = order.seeds[0]
        plan = plan_season(
            Scenario.of(task, seed),
            order.controls,
            iterations=order.iterations,
            watch=None if listener is None else partial(listener, seed),
        )
        book = PlanBook.of(task, order.seeds, plan.actions(), {"method": METHOD, "iterations": order.iterations})
        return book.with_about(glbench=__version__, **replayed(task, book, [seed])[seed]._asdict())
    except GlbenchError as error:
        return str(error)


def here(orders: Sequence[Order], workers: int, listener: Listener | None) -> Iterator[tuple[Order, PlanBook | str]]:
    """Plan on this machine, in this process or in ``workers`` others; each plan is yielded as soon as it is done."""
    if min(workers, len(orders)) <= 1:
        yield from ((order, planned(order, listener)) for order in orders)
        return
    context = multiprocessing.get_context("spawn")
    told = context.Queue()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_tell, initargs=(told,))
    try:
        running = {pool.submit(_planned_there, order): order for order in orders}
        waiting = set(running)
        while waiting:
            done, waiting = wait(waiting, timeout=_LOOK_SECONDS, return_when=FIRST_COMPLETED)
            _listen(told, listener)
            yield from ((running[one], one.result()) for one in done)
    except BaseException:  # whoever interrupts does not want to wait for the plans under way
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def on_ray(orders: Sequence[Order], workers: int) -> Iterator[tuple[Order, PlanBook | str]]:
    """Plan on a Ray cluster started on this machine with ``workers`` cores, or on the cluster at ``RAY_ADDRESS``."""
    if not orders:
        return
    with RayEngine(cores=workers).cluster() as ray:
        work = ray.remote(num_cpus=1)(planned)
        running = {work.remote(order): order for order in orders}
        while running:
            for one in ray.wait(list(running), num_returns=1)[0]:
                order = running.pop(one)
                try:
                    given = ray.get(one)
                except Exception as error:  # of Ray: a worker that was lost
                    given = f"The worker failed: {str(error).splitlines()[0]}"
                yield order, given


_TOLD: list[Any] = []
"""In a process of the pool: the queue to the listener."""


def _tell(told: Any) -> None:
    _TOLD.append(told)


def _planned_there(order: Order) -> PlanBook | str:
    return planned(order, lambda seed, iteration: _TOLD[0].put((seed, iteration)))


def _listen(told: Any, listener: Listener | None) -> None:
    while True:
        try:
            seed, iteration = told.get_nowait()
        except queue.Empty:
            return
        if listener is not None:
            listener(seed, iteration)

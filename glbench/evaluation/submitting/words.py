"""Findings about a short run, in words."""

from __future__ import annotations

from collections.abc import Sequence

from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.sandbox.limits import MIB
from glbench.evaluation.submitting.findings import Finding, note, problem
from glbench.evaluation.submitting.memory import MEMORY_LIMIT

_SAME = 1e-4
"""Differences of an action that rounding explains; what is larger is information from other runs."""


def company(difference: float, step: int) -> Finding:
    """A run alone was decided differently, by ``difference``, than among others."""
    if difference > _SAME:
        text = (
            f"A run shown alone is decided differently than among others, by {difference:.2g} in step {step}: rows learn of each other. "
            "Decide each row from that row only, and keep one memory a row."
        )
        return problem("rows", text)
    text = (
        f"A run shown alone is decided differently than among others in the last digits ({difference:.1g} in step {step}), as matrix "
        "products round by the size of a batch. `--runs 1` will differ a little from the first of many runs."
    )
    return note("rows", text)


def unrepeatable(step: int, difference: float | None, reason: str) -> Finding:
    """A fresh agent decided differently by ``difference``, or failed for a ``reason``."""
    how = f"by up to {difference:.2g}" if difference is not None else f"because it failed: {reason}"
    text = (
        f"Shown the same observations again, a fresh agent decided differently in step {step}, {how}. Draw random numbers from a "
        "generator that is seeded in reset, and do not look at the clock: otherwise nobody can repeat the result."
    )
    return problem("repeatable", text)


def no_answer(seconds: float, runs: int, step: int, steps: int, limits: TimeLimits) -> Finding:
    """``act`` was stopped after so many ``seconds`` for that many runs."""
    whom = "one run" if runs == 1 else f"{runs} runs"
    began = f"act did not come back within {duration(seconds)} for {whom} in step {step}"
    each, whole = seconds / runs, seconds / runs * steps
    if each >= limits.step:
        return problem("time", f"{began}. The limit is {limits.step:g} s for one decision of one run.")
    if whole > limits.run:
        text = f"{began}. At that pace all decisions of a run take {duration(whole)} or more, and the limit is {duration(limits.run)}."
        return problem("time", text)
    return note("time", f"{began}, which is too slow for this check, though not for an evaluation: more was not seen.")


def times(each: float, slowest: float, steps: int, limits: TimeLimits) -> list[Finding]:
    """Decisions of one run took ``each`` seconds on the average and ``slowest`` at most."""
    found = []
    if slowest > limits.step:
        found.append(problem("time", f"One decision took {slowest:.1f} s a run; the limit is {limits.step:g} s."))
    if each * steps > limits.run:
        text = f"All decisions of a run would take {duration(each * steps)}, and the limit is {duration(limits.run)}: runs would end early."
        found.append(problem("time", text))
    return found


def unseen(done: int, steps: int, seconds: float) -> Finding:
    """Only some steps fitted into the time."""
    text = f"Only {done} of {steps} steps fitted into the check ({seconds:.0f} s); what goes wrong later was not seen."
    return note("time", text)


def memory(growth: float, last: int, steps: int) -> list[Finding]:
    """Memory grows by ``growth`` bytes a step from ``last`` bytes."""
    later = last + growth * steps
    if later <= MEMORY_LIMIT:
        return []
    text = (
        f"Memory grows by {growth / MIB:.2f} MiB a step and would reach {later / MIB / 1024:,.1f} GiB by the end of a run; the limit is "
        f"{MEMORY_LIMIT / MIB / 1024:,.0f} GiB. Keep only what the next decision needs."
    )
    return [problem("memory", text)]


def surroundings(connections: Sequence[str], written: Sequence[str]) -> list[Finding]:
    """The agent connected to hosts, or wrote files."""
    found = []
    if connections:
        text = f"It connects to {', '.join(connections)}. In the evaluation there is no network: bring along what it needs."
        found.append(problem("surroundings", text))
    if written:
        text = f"It writes to {', '.join(written)}. In the evaluation only /tmp can be written to, and that is gone afterwards."
        found.append(problem("surroundings", text))
    return found


def duration(seconds: float) -> str:
    """Seconds, minutes or hours, as suits."""
    if seconds < 90:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

"""Accuracy of the compiled stepper beside CVODES as the paper runs it, and the table of it in docs/kernel-compiled.md.

``python -m docs.accuracy_table --measure --presets standard fast > docs/measurements/accuracy.txt`` makes the measurement: runs of 60 days
of 900 s steps with real weather, each starting in another month, under controls that move at random (at most 0.1 a step) and
under controls that jump between 0 and 1 at every step. Errors are against the same run at tolerance 1e-10. CVODES has relative and
absolute tolerance 1e-6 on the states as they are. ``python -m docs.accuracy_table`` fills the table with what was measured.
"""

from __future__ import annotations

import argparse
import datetime as dt
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.kernel.compiled.stepper import CompiledStepper, Preset
from glbench.kernel.cvodes import paper_cvodes
from glbench.model import TOMATO, Model
from glbench.weather import disturbances, load_weather

PAGE = Path(__file__).with_name("kernel-compiled.md")
MEASUREMENT = Path(__file__).with_name("measurements") / "accuracy.txt"
KINDS = ("walk", "jump")

Array = NDArray[np.float64]

STEP_SECONDS = 900.0
STEPS_A_DAY = 96
EXACT = Preset(relative=1e-10, first_substep=0.1, fast_error_floor=1.0, singular_error_factor=1.0)
"""Settings of the run that the others are compared with; with 1e-11 the errors found change by 1e-4 of themselves at most."""

_ROUNDING = 1e-12  # errors of this size relative to the state are rounding, not integration


@dataclass(frozen=True)
class Inputs:
    """Controls (steps, runs, controls), weather (steps, runs, 10) and initial states (runs, states) of some runs."""

    controls: Array
    weather: Array
    initial: Array


@dataclass(frozen=True)
class Errors:
    """Errors of a solution: largest and root mean square of each state (states,) [unit of the state]."""

    largest: Array
    mean_square: Array

    def ratio(self, other: Errors) -> tuple[Array, Array]:
        """Both divided by those of ``other``; 0 where neither has an error."""
        pairs = ((self.largest, other.largest), (self.mean_square, other.mean_square))
        largest, mean_square = (np.divide(a, b, out=np.where(a > 0.0, np.inf, 0.0), where=b > 0.0) for a, b in pairs)
        return largest, mean_square


def make_inputs(kind: str, seeds: Sequence[int], days: int) -> Inputs:
    """Runs of ``days`` days, one a seed: run ``s`` starts in month ``s mod 12`` of 2010 or 2011 (never beyond 2012)."""
    record = load_weather("schiphol")
    steps = days * STEPS_A_DAY
    weather = np.empty((steps, len(seeds), TOMATO.sizes["d"]))
    controls = np.empty((steps, len(seeds), TOMATO.sizes["u"]))
    for run, seed in enumerate(seeds):
        start = dt.date(2010 + seed // 12 % 2, 1 + seed % 12, 1)
        weather[:, run] = disturbances(record, start=start, steps=steps, step_seconds=STEP_SECONDS).values
        controls[:, run] = make_controls(kind, seed, steps)
    parameters = TOMATO.parameters.default()
    initial = np.stack([TOMATO.start("mature_crop", weather[0, run], 16.5, parameters) for run in range(len(seeds))])
    return Inputs(controls, weather, initial)


def make_controls(kind: str, seed: int, steps: int) -> Array:
    """Controls (steps, controls) that walk (at most 0.1 a step, held in [0, 1]) or jump (0 or 1, redrawn at every step)."""
    generator = np.random.default_rng([seed, KINDS.index(kind)])
    if kind == "jump":
        return generator.integers(0, 2, (steps, TOMATO.sizes["u"])).astype(np.float64)
    controls = np.empty((steps, TOMATO.sizes["u"]))
    now = generator.uniform(0.0, 1.0, TOMATO.sizes["u"])
    for step in range(steps):
        now = np.clip(now + generator.uniform(-0.1, 0.1, now.shape), 0.0, 1.0)
        controls[step] = now
    return controls


def run_compiled(inputs: Inputs, preset: str | Preset, model: Model = TOMATO) -> tuple[Array, float]:
    """States after every step (steps, runs, states), and the mean number of substeps a step.

    Raises
    ------
    StepError
        When a row could not be stepped.
    """
    stepper = CompiledStepper(model, STEP_SECONDS, preset=preset)
    parameters = model.parameters.default()
    steps, runs, _ = inputs.controls.shape
    states = np.empty((steps, *inputs.initial.shape))
    substeps = 0
    x = inputs.initial
    for step in range(steps):
        status = stepper.step_rows(x, inputs.controls[step], inputs.weather[step], parameters, states[step])
        if status.any():
            raise stepper.error(int(status.nonzero()[0][0]))
        substeps += int(stepper.substeps.sum())
        x = states[step]
    return states, substeps / (steps * runs)


def run_cvodes(inputs: Inputs, tolerance: float = 1e-6, model: Model = TOMATO) -> Array:
    """States after every step (steps, runs, states) by CVODES."""
    integrator = paper_cvodes(model, tolerance, STEP_SECONDS)
    steps, runs, _ = inputs.controls.shape
    states = np.empty((steps, *inputs.initial.shape))
    held = np.concatenate([inputs.controls, inputs.weather], axis=2)
    for run in range(runs):
        x = inputs.initial[run]
        for step in range(steps):
            x = integrator(x0=x, p=held[step, run])["xf"].full().ravel()
            states[step, run] = x
    return states


def errors(states: Array, exact: Array) -> Errors:
    """Errors of ``states`` against ``exact``; differences of the size of rounding count as none."""
    difference = np.abs(states - exact)
    difference[difference <= _ROUNDING * np.abs(exact)] = 0.0
    return Errors(difference.max(axis=(0, 1)), np.sqrt((difference**2).mean(axis=(0, 1))))


def compare(kind: str, seeds: Sequence[int], days: int, presets: Sequence[str]) -> tuple[Errors, dict[str, tuple[Errors, float]]]:
    """Errors of CVODES, and for each preset its errors and substeps a step."""
    inputs = make_inputs(kind, seeds, days)
    exact, _ = run_compiled(inputs, EXACT)
    found = {}
    for preset in presets:
        states, substeps = run_compiled(inputs, preset)
        found[preset] = errors(states, exact), substeps
    return errors(run_cvodes(inputs), exact), found


def report(cvodes: Errors, found: dict[str, tuple[Errors, float]]) -> str:
    """The comparison as text: errors of CVODES, and the errors of each preset as multiples of them."""
    lines = [f"{'state':<10}{'CVODES max':>12}{'CVODES rms':>12}" + "".join(f"{p + ' max':>16}{p + ' rms':>16}" for p in found)]
    ratios = {preset: own.ratio(cvodes) for preset, (own, _) in found.items()}
    for i, name in enumerate(TOMATO.state_names):
        row = f"{name:<10}{cvodes.largest[i]:12.2e}{cvodes.mean_square[i]:12.2e}"
        lines.append(row + "".join(f"{largest[i]:15.2f}x{square[i]:15.2f}x" for largest, square in ratios.values()))
    lines += [f"{preset}: {substeps:.1f} substeps a step" for preset, (_, substeps) in found.items()]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Accuracy:
    """What the command prints of one kind of controls: a row of figures a state, and substeps a step of each preset."""

    states: dict[str, tuple[str, ...]]
    substeps: dict[str, float]


def read(text: str) -> dict[str, Accuracy]:
    """Accuracy by kind of controls."""
    found = {}
    for kind in KINDS:
        part = text.split(f"controls that {kind}\n")[1].split("\n\n")[0].splitlines()[1:]
        rows = [line.split() for line in part if "substeps" not in line]
        substeps = {name: float(number) for name, number in re.findall(r"(\w+): ([\d.]+) substeps", "\n".join(part))}
        found[kind] = Accuracy({state: tuple(cell.rstrip("x") for cell in cells) for state, *cells in rows}, substeps)
    return found


def table(text: str) -> str:
    """Largest error of CVODES and the presets' errors as multiples of those of CVODES; states that are exact are left out."""
    found = read(text)
    lines = [
        "| state | walk: CVODES max | `standard` max | rms | `fast` rms | jump: CVODES max | `standard` max | rms | `fast` rms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for state, walk in found["walk"].states.items():
        if float(walk[0]) > 0.0:
            # Columns: CVODES max and rms, standard max and rms, fast max and rms.
            cells = [row[i] for row in (walk, found["jump"].states[state]) for i in (0, 2, 3, 5)]
            lines.append(f"| {state} | {' | '.join(cells)} |")
    return "\n".join(lines)


def filled(page: str, text: str) -> str:
    """The page with its table made of what the command printed."""
    return with_tables(page, {"accuracy": table(text)})


def measure(arguments: argparse.Namespace) -> bool:
    """Print the measurement; whether the first preset is nowhere less accurate than CVODES."""
    as_good = True
    for kind in arguments.kinds:
        seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
        cvodes, found = compare(kind, seeds, arguments.days, arguments.presets)
        title = f"{arguments.seeds} runs of {arguments.days} days, steps of {STEP_SECONDS:g} s, controls that {kind}"
        sys.stdout.write(f"{title}\n{report(cvodes, found)}\n")
        sys.stdout.flush()
        as_good &= not any(bool((ratio > 1.0).any()) for ratio in found[arguments.presets[0]][0].ratio(cvodes))
    return as_good


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure or fill the table; exit status 1 when the first preset is less accurate than CVODES in any state."""
    parser = argparse.ArgumentParser(prog="python -m docs.accuracy_table", description=__doc__)
    parser.add_argument("--measure", action="store_true", help="print a new measurement (minutes)")
    parser.add_argument("--seeds", type=int, default=20, help="runs of each kind")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--days", type=int, default=60)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--presets", nargs="+", default=["standard"])
    options = parser.parse_args(arguments)
    if options.measure:
        return int(not measure(options))
    page = filled(PAGE.read_text(encoding="utf-8"), MEASUREMENT.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""A step has the same bits on 64-bit Arm: the kernel by a cross compiler, run under emulation, against this machine's library."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled import CompiledStepper
from glbench.kernel.compiled.compiler import Compiler
from glbench.kernel.compiled.library import absent_equipment, traits_of, write_source
from glbench.model import TOMATO

Array: TypeAlias = NDArray[np.float64]
Case: TypeAlias = tuple[Array, Array, Array]
"""States (n, 28), controls (steps, n, 6), weather (steps, n, 10)."""
Stepped: TypeAlias = list[tuple[Array, NDArray[np.int32], NDArray[np.int32]]]
"""For each step: states (n, 28), statuses (n,), substeps (n,)."""
ArmRun: TypeAlias = Callable[[CompiledStepper, Case, Array, int], Stepped]

CROSS, EMULATOR = "aarch64-linux-gnu-g++", "qemu-aarch64"
STEPS = 3

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("compiled")]


@pytest.fixture(scope="module")
def on_arm(tmp_path_factory: pytest.TempPathFactory) -> ArmRun:
    """Steps rows with the kernel as an Arm processor runs it."""
    for program, package in ((CROSS, "g++-aarch64-linux-gnu"), (EMULATOR, "qemu-user")):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed (Debian and Ubuntu: apt-get install {package})")
    folder = tmp_path_factory.mktemp("arm")
    _, include = write_source(folder, TOMATO, traits_of(TOMATO, absent_equipment(TOMATO)))
    here = {"-march=native", "-mtune=haswell", "-mcpu=native", "-fPIC", "-shared"}
    flags = (*(flag for flag in Compiler((CROSS,), "").flags() if flag not in here), "-static")
    program = folder / "arm_driver"
    Compiler((CROSS,), "cross").compile(Path(__file__).with_name("arm_driver.cpp"), program, include, flags)

    def run(stepper: CompiledStepper, case: Case, p: Array, rows_a_call: int) -> Stepped:
        x, u, d = case
        given, taken = folder / "in.bin", folder / "out.bin"
        with given.open("wb") as file:
            file.write(np.array([len(x), len(u), p.size, rows_a_call], np.int64).tobytes())
            file.write(bytes(stepper.settings) + p.tobytes() + x.tobytes())
            for controls, weather in zip(u, d, strict=True):
                file.write(controls.tobytes() + weather.tobytes())
        subprocess.run([EMULATOR, program, given, taken], check=True, timeout=500.0)
        each = np.dtype([("x", "<f8", x.shape), ("status", "<i4", len(x)), ("substeps", "<i4", len(x))])
        return [(row["x"], row["status"], row["substeps"]) for row in np.fromfile(taken, each)]

    return run


def stepped_here(stepper: CompiledStepper, case: Case, p: Array) -> Stepped:
    x, result = case[0].copy(), []
    for u, d in zip(case[1], case[2], strict=True):
        out = np.empty_like(x)
        status = stepper.step_rows(x, u, d, p, out).copy()
        result.append((out, status, stepper.substeps.copy()))
        x = out
    return result


def case_of(rows: Case, n: int) -> Case:
    """The first ``n`` rows with restless controls and another weather at every step."""
    x, u, d = rows
    pick = np.random.default_rng(3).integers(0, len(x), (STEPS, n))
    return x[:n].copy(), u[pick], d[pick]


def assert_same(found: Stepped, expected: Stepped) -> None:
    assert len(found) == len(expected)
    for (x, status, substeps), (x_here, status_here, substeps_here) in zip(found, expected, strict=True):
        assert x.tobytes() == x_here.tobytes(), f"states differ by up to {np.nanmax(abs(x - x_here)):g}"
        assert status.tolist() == status_here.tolist()
        assert substeps.tolist() == substeps_here.tolist()


@pytest.mark.parametrize(("preset", "n", "rows_a_call"), [("reference", 100, 100), ("standard", 200, 200), ("standard", 40, 1)])
def test_arm_gives_the_bits_of_this_machine(on_arm: ArmRun, rows: Case, parameters: Array, preset: str, n: int, rows_a_call: int) -> None:
    stepper, case = CompiledStepper(TOMATO, 900.0, preset=preset), case_of(rows, n)
    here = stepped_here(stepper, case, parameters)
    assert not any(status.any() for _, status, _ in here)
    assert_same(on_arm(stepper, case, parameters, rows_a_call), here)


def test_arm_gives_the_same_bits_where_a_substep_is_not_a_number(on_arm: ArmRun, rows: Case, parameters: Array) -> None:
    # States far from any greenhouse: negative pressures and masses. Powers and roots of those are not numbers, and whether
    # the sign of such a "number" is set is where x86 and Arm differ.
    x, u, d = case_of(rows, 60)
    x *= np.random.default_rng(11).uniform(-1.0, 2.0, x.shape)
    stepper = CompiledStepper(TOMATO, 900.0, preset="standard")
    here = stepped_here(stepper, (x, u, d), parameters)
    failed = sum(int(np.count_nonzero(status)) for _, status, _ in here)
    assert 0 < failed < STEPS * 60
    assert_same(on_arm(stepper, (x, u, d), parameters, 60), here)

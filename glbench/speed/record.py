"""What a speed measurement leaves: one JSON file with the machine, the versions and every figure."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from glbench.errors import ResultError, refuse
from glbench.evaluation.records import Machine, Versions
from glbench.resources import write_atomically
from glbench.untrusted import MIB, parse_json, read_regular, reason_of


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Measurement(_Frozen):
    """One subject's figures; the ratios are those of the rounds, reference over subject."""

    name: str
    group: str
    title: str
    microseconds: float
    """Of one step, in the fastest round."""
    reference: str
    reference_microseconds: float
    """Of one step of the reference, in the fastest round."""
    ratio: float
    """Median over the rounds: how many times as fast as the reference."""
    ratio_low: float
    ratio_high: float
    """Smallest and largest of the rounds."""
    clock: str
    """``"processor"`` or ``"wall"``."""

    @property
    def steps_per_second(self) -> float:
        """Steps in a second."""
        return 1e6 / self.microseconds


class FirstUse(_Frozen):
    """A first use on an empty cache, in a process of its own: whole time [s] and peak memory of process and compiler [MB]."""

    seconds: float
    megabytes: float


class Memory(_Frozen):
    """Peak memory of a process that steps so many environments, beside one that steps a single one [MB]."""

    environments: int
    megabytes: float
    megabytes_of_one: float


class SpeedRecord(_Frozen):
    """Everything that one ``glbench bench`` measured."""

    schema_name: Literal["glbench/speed"] = "glbench/speed"
    schema_version: Literal[1] = 1
    created: str
    machine: Machine
    versions: Versions
    kernel: dict[str, str | float]
    reference: str
    """The reference in words."""
    rounds: int
    measurements: tuple[Measurement, ...]
    first_use: FirstUse | None = None
    memory: Memory | None = None

    def find(self, name: str) -> Measurement | None:
        """The measurement of that name, if it was made."""
        return next((one for one in self.measurements if one.name == name), None)


def save_record(record: SpeedRecord, path: Path) -> None:
    """Write the record as JSON. Raises ``GlbenchError`` when the file cannot be written."""
    write_atomically(path, record.model_dump_json(indent=1) + "\n")


def read_record(path: Path) -> SpeedRecord:
    """Read a record. Raises ``ResultError`` when there is none, or it is no speed record."""
    try:
        return SpeedRecord.model_validate(parse_json(read_regular(path, MIB)))
    except (OSError, ValueError, ValidationError) as error:
        command = f"glbench bench --out {shlex.quote(str(path))}"
        refuse(f"{path} is no speed record of glbench: {reason_of(error)}. `{command}` makes one.", ResultError, error)

"""How fast the model steps, as ratios to a reference that is measured in the same run.

Absolute times differ from machine to machine and from minute to minute; the ratio to the method of the benchmark's paper (CVODES at 1e-6,
compiled just in time by CasADi) differs much less. Every ratio here is taken round by round, the reference and the subject in turn, and the
median is reported. ``glbench bench`` prints them, ``benchmarks/`` runs them under pytest-benchmark, docs/speed.md says what they mean.
"""

from glbench.speed.record import Measurement, SpeedRecord, read_record, save_record
from glbench.speed.run import measure
from glbench.speed.subjects import SUBJECTS, Subject, choose_subjects

__all__ = ["SUBJECTS", "Measurement", "SpeedRecord", "Subject", "choose_subjects", "measure", "read_record", "save_record"]

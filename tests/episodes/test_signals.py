"""One description says what is recorded and shown; nothing else in the room knows the model."""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import glbench.episodes
from glbench.env.accounts import QUANTITY_NAMES
from glbench.episodes import Episode, episode_bytes, read_episode
from glbench.episodes.signals import Amount, Curve, Page, Signal, signals_of
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, STATE_NAMES
from glbench.tasks import get_task

GREENHOUSE = signals_of(get_task("Schiphol2010-Delta10-v1"))

TOY = replace(
    GREENHOUSE,
    recorded=(
        Signal("valve", "-", "a valve", "controls", "control", 0),
        Signal("sun", "W m-2", "sunshine", "weather", "disturbance", 1),
        Signal("mass", "kg", "of a head", "crop", "state", 1),
        Signal("warmth", "degC", "of a leaf", "state", "state", 0),
        Signal("gain", "EUR", "of a step", "economics", "quantity", 0),
    ),
    pages=(Page("All", (Curve("crop/mass", "Mass", "g", ("mass",), factor=1e3), Curve("money/gain", "Gain", "EUR", ("gain",), "sum"))),),
    worst="gain", total="gain", income=("gain",), costs=(), harvest=(Amount("mass", "kg"),), reward="gain",
)  # fmt: skip
"""Two states, one control: a kind of task that glbench does not have."""


def test_the_overview_shows_all_fruit_that_the_task_pays_for():
    """In 60 days of spring nothing is ripe: the fruit on the plants is what grows."""
    signals = signals_of(get_task("Spring-v1"))
    (path,) = [path for path in signals.overview[0] if path.startswith("crop/")]
    (curve,) = [curve for curve in signals.curves if curve.path == path]
    assert curve.heading == "Fruit on the plants and fruit picked, summed [kg m⁻²]"
    course = {"fruit_gained": np.array([0.5, 0.25, -0.5]), "fruit_picked": np.array([0.0, 0.0, 1.0])}
    assert curve.values(course).tolist() == [0.5, 0.75, 1.25]


def test_every_number_of_the_simulation_is_recorded_once_at_its_place():
    for source, names in (
        ("state", STATE_NAMES),
        ("control", CONTROL_NAMES),
        ("disturbance", DISTURBANCE_NAMES),
        ("quantity", QUANTITY_NAMES),
    ):
        assert [signal.name for signal in GREENHOUSE.vector(source)] == list(names)
        assert [signal.index for signal in GREENHOUSE.vector(source)] == list(range(len(names)))
    assert max(Counter(signal.name for signal in GREENHOUSE.recorded).values()) == 1


def test_groups_are_of_one_source_each():
    for name in {signal.group for signal in GREENHOUSE.recorded}:
        assert len({signal.source for signal in GREENHOUSE.recorded if signal.group == name}) == 1, name


def test_no_other_file_of_the_room_names_a_state_a_control_or_a_quantity():
    ordinary = {"time"}  # a time line of the viewer has this name, too
    names = {signal.name for signal in GREENHOUSE.recorded} - ordinary
    folder = Path(glbench.episodes.__file__).parent
    for file in folder.glob("*.py"):
        if file.name in {"signals.py", "definition.py"}:  # the description itself, and the fields of task files
            continue
        texts = {node.value for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Constant)}
        assert not texts & names, file.name


def test_another_model_is_recorded_and_read_back_with_its_own_columns(episode_file, tmp_path):
    day = read_episode(episode_file)
    states, steps = np.arange(50.0).reshape(25, 2), 24
    begun = TOY.tables({"state": states})
    during = TOY.tables({"control": np.ones((steps, 1)), "disturbance": np.ones((steps, 2)), "quantity": np.full((steps, 1), 0.5)})
    toy = Episode(
        day.provenance,
        day.run,
        day.definition,
        TOY.groups(["valve"], controls=False),
        {"action": np.zeros((steps, 1)), **during, **{name: values[1:] for name, values in begun.items()}},
        {name: values[0] for name, values in begun.items()},
        day.times,
    )
    (tmp_path / "toy.mcap").write_bytes(episode_bytes(toy))
    again = read_episode(tmp_path / "toy.mcap")
    assert again.names == ("action_valve", "valve", "sun", "mass", "warmth", "gain")
    assert again["mass"].tolist() == states[1:, 1].tolist()
    assert again.start["crop"].tolist() == [1.0]
    assert TOY.width == 4


@pytest.mark.parametrize(
    ("form", "names", "expected"),
    [("value", ("a",), [2.0, 4.0]), ("sum", ("a",), [2.0, 6.0]), ("beyond", ("a", "b"), [1.0, -4.0]), ("any", ("a", "b"), [3.0, 7.0])],
)
def test_forms_of_curves(form, names, expected):
    columns = {"a": np.array([2.0, 4.0]), "b": np.array([3.0, 0.0])}
    assert Curve("x/y", "y", "-", names, form).values(columns).tolist() == expected
    if form == "value":
        assert Curve("x/y", "y", "-", names, form, factor=0.5).values(columns).tolist() == [1.0, 2.0]

"""The draft with butterhead lettuce: what is seen of the crop, weekly samples, compiled and NumPy bits, checkers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glbench.env import Simulation
from glbench.kernel import available
from glbench.model import BUTTERHEAD
from glbench.model.crop.butterhead import FIFTHS, relative_price
from glbench.tasks import get_task
from tests.env.checking import check_that_both_are_silent
from tests.env.stepping import walk

TASK = get_task("Lettuce-v2").in_split("validation")
MODEL = TASK.model_value
HEAD: Any = next(signal for signal in MODEL.signals() if signal.path == "crop/head").of
NAMES = [column.name for column in TASK.observed()]
MASS = NAMES.index("mean_head_mass")


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_both_checkers_are_silent(recwarn: pytest.WarningsRecorder) -> None:
    check_that_both_are_silent(get_task("Lettuce-v2"), recwarn)


def test_what_is_seen_is_the_same_compiled_with_the_environment_and_not_and_in_any_batch() -> None:
    if "compiled" not in available(BUTTERHEAD):
        pytest.skip("nothing compiled here")
    one, other, alone = Simulation(TASK, 3, "fast"), Simulation(TASK, 3, "fast", fused=False), Simulation(TASK, 1, "fast")
    assert one.fused
    first = one.reset([1, 2, 3])
    assert first.tobytes() == other.reset([1, 2, 3]).tobytes()
    assert first[1].tobytes() == alone.reset([2])[0].tobytes()
    for action in walk(4, 8 * 96, 3, 4):
        seen = one.step(action).observations
        assert seen.tobytes() == other.step(action).observations.tobytes()
        assert seen[1].tobytes() == alone.step(action[1:2]).observations[0].tobytes()
    assert one.x.tobytes() == other.x.tobytes()


def test_nobody_sees_how_heavy_the_crop_is_but_from_the_sample() -> None:
    assert "registration" in TASK.observation.modules
    assert not {"crop", "true_state"} & set(TASK.observation.modules)
    assert not {"head_fresh_mass", "dry_matter", "leaf_area_index"} & set(NAMES)


def test_the_sample_is_weighed_weekly_and_off_by_a_few_percent() -> None:
    simulation = Simulation(TASK, 6, "fast")
    seen, errors = simulation.reset(range(6))[:, MASS], []
    for step in range(14 * 96 + 1):
        true = HEAD(MODEL.State(*simulation.x.T), MODEL.Parameters(*TASK.parameters()))
        if step % (7 * 96) == 0:
            errors += list(seen / true - 1.0)
        before, seen = seen, simulation.step(np.zeros((6, 4), dtype=np.float32)).observations[:, MASS]
        assert (seen != before).all() == ((step + 1) % (7 * 96) == 0)
    assert len({round(float(error), 6) for error in errors}) == 18, "each sample has an error of its own"
    assert 0.03 < np.std(errors) < 0.09
    assert np.abs(errors).max() < 0.181


def test_a_season_earns_what_its_heads_weigh_at_the_end() -> None:
    simulation = Simulation(TASK, 4, "fast")
    simulation.reset(range(4))
    action, total = np.zeros((4, 4), dtype=np.float32), np.zeros(4)
    for step in range(TASK.steps):
        action[:] = [0.8, 0.8, 0.0, 0.4] if step < 5 else 0.0
        result = simulation.step(action)
        total += result.table[result.names.index("revenue")]
    p = MODEL.Parameters(*TASK.parameters())
    heads = np.asarray(HEAD(MODEL.State(*simulation.x.T), p))
    earned = [0.8 * 25 * np.mean([float(relative_price(head * (1 + 0.15 * z))) for z in FIFTHS]) for head in heads]
    np.testing.assert_allclose(total, earned, atol=1e-6)
    assert np.ptp(heads) > 20.0
    assert np.ptp(total) > 1.0

"""Snapshots: exact continuation, here and in another process."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation, Snapshot, StepResult
from glbench.env.spaces import pack_generator, unpack_generator
from glbench.errors import GlbenchError, ResultError, ShapeError, TaskError
from glbench.tasks import TaskSpec
from tests.env.stepping import StillKernel, run, walk

MakeTask = Callable[..., TaskSpec]


def digest(results: list[StepResult]) -> str:
    """Over every bit of the results."""
    sha = hashlib.sha256()
    for result in results:
        for array in (result.observations, result.rewards, result.terminated, *result.quantities.values()):
            sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


@pytest.fixture
def half_way(day: TaskSpec) -> tuple[Simulation, Snapshot]:
    """Three runs of the real greenhouse after five steps, one of them ended after the second."""
    simulation = Simulation(day, 3)
    simulation.reset([7, 8, 2**64 - 1])
    run(simulation, walk(4, 2, 3))
    simulation.end([1])
    run(simulation, walk(5, 3, 3))
    return simulation, simulation.snapshot()


def test_after_restore_the_same_actions_give_the_same_bits(day: TaskSpec, half_way: tuple[Simulation, Snapshot]) -> None:
    simulation, snapshot = half_way
    seen, ahead = simulation.observe(), digest(run(simulation, walk(6, 4, 3)))
    assert (simulation.restore(snapshot) == seen).all()
    assert digest(run(simulation, walk(6, 4, 3))) == ahead
    other = Simulation(day, 3)
    assert (other.restore(snapshot) == seen).all()
    assert digest(run(other, walk(6, 4, 3))) == ahead
    assert other.k.tolist() == [9, 2, 9]
    assert other.seeds.tolist() == [7, 8, 2**64 - 1]


@pytest.mark.slow
def test_another_process_continues_with_the_same_bits(day: TaskSpec, half_way: tuple[Simulation, Snapshot], tmp_path: Path) -> None:
    simulation, snapshot = half_way
    (tmp_path / "snapshot").write_bytes(snapshot.to_bytes())
    script = f"""
from pathlib import Path
from glbench.env import Simulation, Snapshot
from glbench.tasks import get_task
from tests.env.stepping import StillKernel, run, walk
from tests.env.test_snapshot import digest
simulation = Simulation(get_task({day.source!r}), 3)
simulation.restore(Snapshot.from_bytes(Path({str(tmp_path / "snapshot")!r}).read_bytes()))
print(digest(run(simulation, walk(6, 4, 3))))
"""
    folder = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == digest(run(simulation, walk(6, 4, 3)))


def test_bytes_bring_back_every_array_and_repeat(half_way: tuple[Simulation, Snapshot]) -> None:
    _, snapshot = half_way
    data = snapshot.to_bytes()
    read = Snapshot.from_bytes(data)
    for name in ("states", "controls", "steps", "seeds", "ended", "generators"):
        ours, theirs = getattr(snapshot, name), getattr(read, name)
        assert ours.dtype == theirs.dtype
        assert ours.tobytes() == theirs.tobytes()
    assert (read.task_id, read.task_digest) == (snapshot.task_id, snapshot.task_digest)
    assert read.to_bytes() == data


def test_a_snapshot_does_not_change_when_the_simulation_goes_on(half_way: tuple[Simulation, Snapshot]) -> None:
    simulation, snapshot = half_way
    data = snapshot.to_bytes()
    run(simulation, walk(6, 4, 3))
    simulation.reset([1], rows=[0])
    assert snapshot.to_bytes() == data


def test_one_row_can_be_tried_in_several_ways(day: TaskSpec, half_way: tuple[Simulation, Snapshot]) -> None:
    simulation, snapshot = half_way
    many = Simulation(day, 4)
    many.restore(snapshot.take([2, 2, 2, 0]))
    actions = np.zeros((4, 6))
    actions[1] = 1.0
    tried = many.step(actions)
    straight = simulation.step(np.zeros((3, 6)))
    assert (tried.observations[0] == straight.observations[2]).all()
    assert (tried.observations[2] == straight.observations[2]).all()
    assert (tried.observations[3] == straight.observations[0]).all()
    assert tried.observations[1, 0] != straight.observations[2, 0]


def test_a_snapshot_fits_its_own_task_and_size_only(make_task: MakeTask, day: TaskSpec, half_way: tuple[Simulation, Snapshot]) -> None:
    _, snapshot = half_way
    with pytest.raises(TaskError, match="Make the simulation of the task that the snapshot was taken of"):
        Simulation(make_task(("delta = 0.10", "delta = 0.0")), 3).restore(snapshot)
    with pytest.raises(ShapeError, match="3 rows, the simulation 2"):
        Simulation(day, 2).restore(snapshot)


@pytest.mark.parametrize("spoil", [lambda b: b[:-40], lambda b: b"", lambda b: b"snapshot", lambda b: b[50:]])
def test_damaged_bytes_are_refused(half_way: tuple[Simulation, Snapshot], spoil: Callable[[bytes], bytes]) -> None:
    with pytest.raises(ResultError, match="no snapshot, or a damaged one"):
        Snapshot.from_bytes(spoil(half_way[1].to_bytes()))


def test_a_generator_survives_packing() -> None:
    generator = np.random.default_rng(3)
    generator.integers(10, dtype=np.uint32)  # leaves half a word behind
    twin = unpack_generator(pack_generator(generator))
    assert generator.integers(2**31, size=9, dtype=np.int32).tolist() == twin.integers(2**31, size=9, dtype=np.int32).tolist()
    assert generator.random() == twin.random()


def test_an_environment_continues_and_then_draws_the_same_next_episode(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseEnv(day, still)
    environment.reset(seed=3)
    environment.reset()
    environment.step(np.full(6, 0.5, dtype=np.float32))
    snapshot = Snapshot.from_bytes(environment.snapshot().to_bytes())
    ahead = environment.step(np.full(6, -0.2, dtype=np.float32))
    following = environment.reset()[1]["seed"]
    other = GreenhouseEnv(day, still)
    observation, info = other.reset(options={"state": snapshot})
    assert info["step"] == 1
    assert other.observation_space.contains(observation)
    again = other.step(np.full(6, -0.2, dtype=np.float32))
    assert (again[0] == ahead[0]).all()
    assert again[1:] == ahead[1:]
    assert other.reset()[1]["seed"] == following


def test_a_vector_environment_continues_through_its_autoresets(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseVectorEnv(day, 2, kernel=still)
    environment.reset(seed=3)
    actions = walk(1, 200, 2)
    for action in actions[:90]:
        environment.step(action)
    snapshot = environment.snapshot()
    other = GreenhouseVectorEnv(day, 2, kernel=still)
    other.restore(snapshot)
    for action in actions[90:]:
        ours, theirs = environment.step(action), other.step(action)
        assert all((a == b).all() for a, b in zip(ours[:4], theirs[:4], strict=True))
        assert ours[4]["seed"].tolist() == theirs[4]["seed"].tolist()
    assert ours[4]["seed"].tolist() != [3, 4]


def test_a_state_comes_without_a_seed_and_is_a_snapshot(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseEnv(day, still)
    environment.reset(seed=1)
    snapshot = environment.snapshot()
    with pytest.raises(GlbenchError, match="brings its own seeds"):
        environment.reset(seed=1, options={"state": snapshot})
    with pytest.raises(GlbenchError, match="is a bytes; expected what snapshot"):
        environment.reset(options={"state": snapshot.to_bytes()})
    with pytest.raises(GlbenchError, match=r"no option called 'stat'. Did you mean 'state'"):
        environment.reset(options={"stat": snapshot})

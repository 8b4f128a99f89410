"""Trained policies: files without code, the same bits everywhere, and the right one for a task."""

from __future__ import annotations

import io
import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glbench.agents import load_agent
from glbench.agents.deterministic_math import ExactLinear, exp, silu, tanh
from glbench.agents.network_policy import Actor, NetworkPolicy, policy_for, read_policy
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskCard, get_task, task_card

Array = np.ndarray


def policy_of(card: TaskCard, seed: int = 0, output: str = "clip", sizes: tuple[int, ...] = (64, 64)) -> NetworkPolicy:
    rng = np.random.default_rng(seed)
    widths = [len(card.observation_names), *sizes, len(card.actions)]
    pairs = list(itertools.pairwise(widths))
    return NetworkPolicy(
        task_id=card.id,
        delta=card.delta,
        observation_names=card.observation_names,
        action_names=card.action_names,
        low=np.array([action.low for action in card.actions]),
        high=np.array([action.high for action in card.actions]),
        mean=rng.normal(size=widths[0]),
        scale=rng.uniform(0.5, 3.0, widths[0]),
        clip=10.0,
        weights=tuple((rng.normal(size=pair) / math.sqrt(pair[0])).astype(np.float32) for pair in pairs),
        biases=tuple(rng.normal(size=pair[1]).astype(np.float32) for pair in pairs),
        activation="SiLU",
        output=output,  # type: ignore[arg-type]
        about={"algorithm": "none"},
    )


def plain(policy: NetworkPolicy, observations: np.ndarray) -> np.ndarray:
    """The same network, written down plainly."""
    x = np.clip((observations.astype(np.float64) - policy.mean) / policy.scale, -policy.clip, policy.clip)
    for weights, bias in zip(policy.weights[:-1], policy.biases[:-1], strict=True):
        x = x @ weights.astype(np.float64) + bias
        x = x / (1.0 + np.exp(-x))
    x = x @ policy.weights[-1].astype(np.float64) + policy.biases[-1]
    if policy.output == "tanh":
        x = policy.low + (np.tanh(x) + 1.0) / 2.0 * (policy.high - policy.low)
    return np.clip(x, policy.low, policy.high)


def some_observations(rows: int, columns: int = 22) -> np.ndarray:
    return (np.random.default_rng(5).normal(size=(rows, columns)) * 5.0).astype(np.float32)


@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_a_policy_is_its_network(card: TaskCard, output: str) -> None:
    policy = policy_of(card, output=output)
    seen = some_observations(200)
    np.testing.assert_allclose(policy.act(seen), plain(policy, seen), rtol=0, atol=1e-7)


@given(first=st.integers(0, 8), rows=st.integers(1, 9))
@settings(deadline=None, max_examples=15)
def test_a_row_gives_the_same_bits_alone_and_in_any_batch(wide: tuple[NetworkPolicy, Array], first: int, rows: int) -> None:
    policy, whole = wide
    seen = some_observations(len(whole))
    np.testing.assert_array_equal(policy.act(seen[first : first + rows]), whole[first : first + rows])


@pytest.fixture(scope="module")
def wide() -> tuple[NetworkPolicy, Array]:
    """A policy with a layer wider than one exact sum, and its answers to 17 observations."""
    policy = policy_of(task_card(get_task("Schiphol2010-Delta10-v1")), sizes=(256, 1100, 40))
    return policy, policy.act(some_observations(17))


def test_the_order_of_a_sum_does_not_change_a_product() -> None:
    rng = np.random.default_rng(0)
    x, weights, bias = rng.normal(size=(7, 900)), rng.normal(size=(900, 5)).astype(np.float32), np.zeros(5)
    order = rng.permutation(900)
    straight = ExactLinear.of(weights, bias)(x)
    np.testing.assert_array_equal(straight, ExactLinear.of(weights[order], bias)(x[:, order]))
    assert (x @ weights.astype(np.float64) != x[:, order] @ weights[order].astype(np.float64)).any(), "an ordinary product depends"
    np.testing.assert_allclose(straight, x @ weights.astype(np.float64), rtol=0, atol=1e-6)


def test_nothing_times_anything_is_the_bias() -> None:
    layer = ExactLinear.of(np.zeros((3, 2), dtype=np.float32), np.array([1.0, -2.0]))
    np.testing.assert_array_equal(layer(np.zeros((4, 3))), np.tile([1.0, -2.0], (4, 1)))


@given(st.floats(-690, 690))
def test_the_exponential_is_right_to_the_last_places(x: float) -> None:
    assert math.isclose(exp(np.array([x]))[0], math.exp(x), rel_tol=1e-15)


@given(st.floats(-1e6, 1e6))
def test_tanh_and_silu_are_right_also_far_out(x: float) -> None:
    assert math.isclose(tanh(np.array([x]))[0], math.tanh(x), abs_tol=1e-15)
    sigmoid = 1.0 / (1.0 + math.exp(-x)) if x > -700 else 0.0
    assert math.isclose(silu(np.array([x]))[0], x * sigmoid, rel_tol=1e-14, abs_tol=1e-290)


def test_a_policy_survives_its_file_and_equal_ones_have_equal_bytes(card: TaskCard, tmp_path: Path) -> None:
    policy = policy_of(card)
    (tmp_path / "a.npz").write_bytes(policy.to_bytes())
    again = read_policy(tmp_path / "a.npz")
    assert again.to_bytes() == policy.to_bytes()
    np.testing.assert_array_equal(again.act(some_observations(9)), policy.act(some_observations(9)))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


def test_a_damaged_file_is_named(card: TaskCard, tmp_path: Path) -> None:
    data = policy_of(card).to_bytes()
    for name, content in {"cut": data[:2000], "noise": b"x" * 100}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SubmissionError, match=f"{name} is not a glbench policy"):
            read_policy(tmp_path / name)
    with pytest.raises(SubmissionError, match="Cannot read"):
        read_policy(tmp_path / "nothing.npz")


def test_layers_that_do_not_fit_together_are_refused(card: TaskCard) -> None:
    policy = policy_of(card)
    with pytest.raises(ShapeError, match="layers of shapes"):
        replace(policy, weights=policy.weights[::-1])
    with pytest.raises(ShapeError, match="not finite"):
        replace(policy, biases=tuple(bias * np.float32(np.nan) for bias in policy.biases))
    with pytest.raises(ShapeError, match="Unknown activation 'Sin'"):
        replace(policy, activation="Sin")


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("scale", 5e-324, "scale of '.*' is 4.94066e-324, expected 1e-12 to 1e\\+12"),
        ("scale", 1e308, "scale of '.*' is 1e\\+308"),
        ("mean", 1e308, "mean of '.*' is 1e\\+308, expected -1e\\+12 to 1e\\+12"),
        ("mean", -1e308, "mean of '.*' is -1e\\+308"),
        ("mean", np.nan, "mean of '.*' is nan"),
        ("low", -1e308, "lower bound of '.*' is -1e\\+308"),
        ("high", 1e308, "upper bound of '.*' is 1e\\+308"),
        ("clip", 1e-320, "at 9.99989e-321, expected 1e-06 or more"),
        ("delta", -0.1, "delta is -0.1, expected 0 to 1e\\+12"),
        ("delta", 1e300, "delta is 1e\\+300"),
    ],
)
def test_numbers_that_nobody_means_are_refused(card: TaskCard, tmp_path: Path, name: str, value: float, reason: str) -> None:
    policy = policy_of(card)
    old = getattr(policy, name)
    new = value if isinstance(old, float) else np.append(old[:-1], value)
    with np.load(io.BytesIO(policy.to_bytes()), allow_pickle=False) as file:
        np.savez(tmp_path / "p.npz", **{**file, name: np.float64(new) if isinstance(old, float) else new})
    with pytest.raises(ShapeError, match=reason):
        replace(policy, **{name: new})
    with pytest.raises(SubmissionError, match=r"p\.npz is not a glbench policy"):
        read_policy(tmp_path / "p.npz")


def test_one_name_of_all_observations_is_refused(card: TaskCard) -> None:
    policy = policy_of(card)
    with pytest.raises(ShapeError, match="has the observation 'co2' 22 times"):
        replace(policy, observation_names=("co2",) * 22)
    with pytest.raises(ShapeError, match=f"has the action 'x' {len(card.actions)} times"):
        replace(policy, action_names=("x",) * len(card.actions))


def test_the_policy_of_the_task_acts_else_that_of_the_nearest_uncertainty(card: TaskCard) -> None:
    policies = tuple(
        Actor.of(replace(policy_of(card), task_id=f"glbench/Schiphol2010-Delta{level}-v1", delta=int(level) / 100))
        for level in ("00", "10", "30")
    )
    assert policy_for(card, policies).network.delta == 0.10
    assert policy_for(task_card(get_task("Schiphol2010-Delta25-v1")), policies).network.delta == 0.30
    assert policy_for(task_card(get_task("Schiphol2010-Delta05-v1")), policies).network.delta == 0.0
    assert policy_for(task_card(get_task("Schiphol2010-Delta20-v1")), policies).network.delta == 0.10


def test_a_task_with_other_observations_is_refused_with_the_reason(card: TaskCard) -> None:
    other = replace(card, id="test/Blind-v1", observations=card.observations[:21])
    with pytest.raises(SubmissionError, match=r"trained on 22 observations.*Blind-v1 shows 21.*glbench train ppo --task"):
        policy_for(other, (Actor.of(policy_of(card)),))


CARD = 'title = "t"\ncontroller = "network"\nsettings = "weights"\ndescription = "d"\nmade = "m"\nsources = []\n[training]\nseed = 1\n'


def test_whatever_bytes_of_a_policy_are_wrong_it_is_refused_or_acts(card: TaskCard, tmp_path: Path) -> None:
    data = policy_of(card, sizes=(8,)).to_bytes()
    (tmp_path / "card.toml").write_text(CARD, encoding="utf-8")
    (tmp_path / "weights").mkdir()
    rng = np.random.default_rng(0)
    refusals: list[str] = []
    for _ in range(400):
        spoiled = bytearray(data)
        for place in rng.integers(0, len(data), size=rng.integers(1, 4)):
            spoiled[place] ^= int(rng.integers(1, 256))
        (tmp_path / "weights" / "a.npz").write_bytes(spoiled)
        try:
            agent = load_agent(tmp_path).make(card)
        except SubmissionError as error:
            refusals.append(str(error))
            continue
        agent.reset(card, 3)
        assert agent.act(some_observations(3)).shape == (3, 6)
    assert len(refusals) > 100


def test_a_folder_with_a_policy_and_a_card_is_an_agent_whose_digest_follows_its_weights(card: TaskCard, tmp_path: Path) -> None:
    (tmp_path / "card.toml").write_text(CARD, encoding="utf-8")
    with pytest.raises(SubmissionError, match="no policy"):
        load_agent(tmp_path)
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / "a.npz").write_bytes(policy_of(card).to_bytes())
    one = load_agent(tmp_path)
    (tmp_path / "weights" / "a.npz").write_bytes(policy_of(card, seed=1).to_bytes())
    assert load_agent(tmp_path).digest != one.digest
    agent = one.make(card)
    agent.reset(card, 3)
    assert agent.act(some_observations(3)).shape == (3, 6)
    with pytest.raises(ShapeError, match="2 runs"):
        agent.act(some_observations(2))

"""The examples of docs/sensitivities.md run as they stand, and their numbers are right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glbench.env.accounts import EPI
from glbench.kernel import available
from glbench.model import PARAMETER_NAMES
from tests.support import examples_of, run_examples

PAGE = "sensitivities.md"
EXAMPLES = examples_of(PAGE)


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What the page's examples define, up to the one for PyTorch."""
    if "compiled" not in available():
        pytest.skip("no compiled kernel here")
    return run_examples(PAGE, EXAMPLES[:2], {})


def test_the_gradient_of_a_day_is_that_of_finite_differences(names: dict[str, Any]) -> None:
    assert names["slope"] == pytest.approx(names["expected"], rel=1e-5)
    assert f"# {names['epi']:.4f} EUR m-2" in EXAMPLES[1]
    assert f"# {names['slope']:.6f} both" in EXAMPLES[1]


def test_the_profit_of_the_page_is_the_epi_of_the_accounts(names: dict[str, Any]) -> None:
    controls, kernel, accounts = names["controls"], names["kernel"], names["accounts"]
    x, total = names["x"], 0.0
    for u, d in zip(controls, names["weather"], strict=True):
        after = kernel.step(x, u, d, names["p"])
        table = accounts.quantities(x[None], after[None], u[None], np.zeros((3, 1)))
        total += float(table[EPI][0])
        x = after
    assert total == pytest.approx(names["epi"], rel=1e-9)


def test_steps_along_the_gradient_raise_the_profit(names: dict[str, Any]) -> None:
    after = run_examples(PAGE, EXAMPLES[2:3], dict(names))
    assert f"# {after['epi']:.4f} EUR m-2 in the end" in EXAMPLES[2]
    assert after["epi"] > names["epi"] + 0.4


def test_torch_differentiates_through_a_step(names: dict[str, Any]) -> None:
    torch = pytest.importorskip("torch")
    after = run_examples(PAGE, EXAMPLES[3:4], dict(names))
    gradient = after["policy"][0].weight.grad
    assert gradient.shape == (6, 28)
    assert bool(torch.isfinite(gradient).all())
    assert bool((gradient != 0.0).any())
    step, kernel = after["ControlStep"].apply, names["kernel"]
    point = [torch.tensor(names[key], dtype=torch.float64) for key in "xudp"]
    rows = [point[0][None], point[1][None].requires_grad_(), point[2][None], point[3].requires_grad_()]
    weights = torch.linspace(-1.0, 1.0, 28, dtype=torch.float64)
    (step(*rows) @ weights).sum().backward()
    lines = kernel.linearise(*(names[key] for key in "xudp"), parameters=["aPipe"])
    np.testing.assert_allclose(rows[1].grad[0].numpy(), weights.numpy() @ lines.du, rtol=1e-9)
    pipe = rows[3].grad[PARAMETER_NAMES.index("aPipe")].item()
    assert pipe == pytest.approx(float(weights.numpy() @ lines.dp[:, 0]), rel=1e-9)


def test_the_trajectory_calls_give_the_gradient_of_the_day(names: dict[str, Any]) -> None:
    after = run_examples(PAGE, EXAMPLES[4:5], dict(names))
    assert after["epi"] == pytest.approx(names["epi"], rel=1e-12)
    np.testing.assert_allclose(after["slopes"], names["gradient"], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(after["path"].pull(after["weights"]).u, after["gradient"].u, rtol=1e-9, atol=1e-12)
    assert after["changes"].shape == after["states"].shape == (97, 28)
    assert (after["path"].dx.shape, after["path"].du.shape) == ((96, 28, 28), (96, 28, 6))

"""Layers of the cover, against a count of the light between them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES, auxiliaries
from glbench.model.optics import Layer, screen, stack, symmetric
from glbench.tasks import get_task
from tests.model.conditions import a_day, controls, with_entry


@st.composite
def layers(draw: st.DrawFn) -> Layer:
    """A layer that reflects differently up and down, and absorbs the rest."""
    transmittance = draw(st.floats(0.01, 0.98))
    up, down = (draw(st.floats(0, 1)) * (1 - transmittance) * 0.999 for _ in range(2))
    return Layer(transmittance, up, down)


def absorbed_by_each(pile: list[Layer]) -> tuple[float, float, list[float]]:
    """Light that passes a pile, light that returns, and light absorbed in each layer, of 1 that comes from above.

    Solves for the light going down and up in every gap at once, instead of reducing the pile pair by pair.
    """
    n = len(pile)
    # Unknowns: light going down below layer 0..n-1, then light going up above layer 0..n-1. Nothing comes from below.
    matrix, right = np.eye(2 * n), np.zeros(2 * n)
    for k, layer in enumerate(pile):
        below, above = k, n + k
        if k == 0:
            right[below] += layer.transmittance
            right[above] += layer.reflectance_up
        else:
            matrix[below, k - 1] -= layer.transmittance
            matrix[above, k - 1] -= layer.reflectance_up
        if k + 1 < n:
            matrix[below, n + k + 1] -= layer.reflectance_down
            matrix[above, n + k + 1] -= layer.transmittance
    light = np.linalg.solve(matrix, right)
    absorbed = []
    for k, layer in enumerate(pile):
        from_above = 1.0 if k == 0 else light[k - 1]
        from_below = light[n + k + 1] if k + 1 < n else 0.0
        absorbed.append(
            from_above * (1 - layer.transmittance - layer.reflectance_up) + from_below * (1 - layer.transmittance - layer.reflectance_down)
        )
    return float(light[n - 1]), float(light[n]), absorbed


@given(st.lists(layers(), min_size=2, max_size=5))
@settings(deadline=None)
def test_absorbed_reflected_and_transmitted_light_sum_to_one(pile: list[Layer]) -> None:
    whole = pile[0]
    for layer in pile[1:]:
        whole = stack(whole, layer)

    transmitted, reflected, absorbed = absorbed_by_each(pile)

    assert abs(whole.transmittance - transmitted) < 1e-12
    assert abs(whole.reflectance_up - reflected) < 1e-12
    assert abs(whole.transmittance + whole.reflectance_up + sum(absorbed) - 1) < 1e-12


@given(st.lists(layers(), min_size=2, max_size=5))
@settings(deadline=None)
def test_a_pile_upside_down_reflects_below_what_it_reflected_above(pile: list[Layer]) -> None:
    whole, turned = pile[0], Layer(pile[-1].transmittance, pile[-1].reflectance_down, pile[-1].reflectance_up)
    for layer in pile[1:]:
        whole = stack(whole, layer)
    for layer in pile[-2::-1]:
        turned = stack(turned, Layer(layer.transmittance, layer.reflectance_down, layer.reflectance_up))

    np.testing.assert_allclose(turned, (whole.transmittance, whole.reflectance_down, whole.reflectance_up), atol=1e-12)


def test_two_panes_transmit_by_hand() -> None:
    # Panes of 0.8 and 0.1: directly 0.64, after two reflections 0.64*0.01, after four 0.64*0.0001, ...
    assert abs(stack(symmetric(0.8, 0.1), symmetric(0.8, 0.1)).transmittance - 0.64 / 0.99) < 1e-15


def test_an_open_screen_leaves_the_roof_alone() -> None:
    roof = symmetric(0.57, 0.13)

    assert stack(roof, screen(0.0, 0.75, 0.35)) == Layer(0.57, 0.13, 0.13)


@given(controls)
@settings(max_examples=40, deadline=None)
def test_shares_of_the_cover_lie_between_0_and_1(u: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    x, _, d, p = a_day()
    # A physical thermal screen: the benchmark's transmits 0.75 and reflects 0.35.
    p = with_entry(p, PARAMETER_NAMES, rhoThScrPar=0.2, rhoThScrNir=0.2)
    shares = auxiliaries(x, u, d, p)
    for name in ("tauCovPar", "rhoCovPar", "aCovPar", "tauCovNir", "rhoCovNir", "aCovNir", "aCanNir", "aFlrNir"):
        assert 0 <= shares[name] <= 1


def test_closing_the_blackout_screen_darkens_the_greenhouse() -> None:
    x, u, d, p = a_day()
    light = [auxiliaries(x, with_entry(u, CONTROL_NAMES, uBlScr=closure), d, p)["rParGhSun"] for closure in (0, 0.5, 1)]

    assert light[0] > light[1] > light[2] > 0
    assert light[2] < 0.02 * light[0]


def test_under_the_blackout_screen_more_sunlight_is_absorbed_than_arrives() -> None:
    """An oddity of the source, with the figures of docs/model-symbols.md; nothing of the kind happens under open screens."""
    task = get_task("Schiphol2010-Delta00-v1")
    d, x, p = task.disturbances().values[48].copy(), task.initial_state().copy(), task.parameters()
    d[DISTURBANCE_NAMES.index("iGlob")] = 1.0
    sinks = ("rParSunCan", "rNirSunCan", "rParSunFlr", "rNirSunFlr", "rGlobSunAir", "rGlobSunCovE")

    def absorbed(closed: tuple[str, ...], leaf_area: float | None = None) -> float:
        state, u = x.copy(), np.array([float(name in closed) for name in CONTROL_NAMES])
        if leaf_area is not None:
            state[STATE_NAMES.index("cLeaf")] = leaf_area / p[PARAMETER_NAMES.index("sla")]
        found = auxiliaries(state, u, d, p)
        return sum(float(found[name]) for name in sinks)

    assert round(absorbed(("uBlScr",)), 3) == 1.028
    pruned = p[PARAMETER_NAMES.index("laiMax")]
    assert round(max(absorbed(("uBlScr",), area) for area in np.linspace(0.1, pruned, 18)), 3) == 1.031
    assert round(absorbed(()), 2) == 0.89
    assert absorbed(("uBlScr", "uThScr")) < 1.0

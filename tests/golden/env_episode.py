"""Makes env_episode.json: the first hours of an episode, by a second implementation of the environment that shares no code with it.

    python tests/golden/env_episode.py

The model's right-hand side is integrated by SciPy to 1e-10; draws, actuation, observation and reward are written out plainly. Run it
only to change the episode on purpose: the test compares the environment with the numbers stored.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from glbench.model import PARAMETER_NAMES, crop_parameter_set, rhs
from glbench.tasks import get_task

TASK, SEED, STEPS = "glbench/Schiphol2010-Delta10-v1", 666, 12
MASK = 0xFFFFFFFF


def action(step: int) -> list[float]:
    """Heat, dose, light and screen up first, then down again; vents open slowly."""
    up = 1.0 if step < 7 else -0.6
    return [up, 0.5 * up, up, 0.25, up, 0.3 * up]


def philox(counter: list[int], key: list[int]) -> list[int]:
    for number in range(10):
        if number:
            key = [(key[0] + 0x9E3779B9) & MASK, (key[1] + 0xBB67AE85) & MASK]
        a, b = 0xD2511F53 * counter[0], 0xCD9E8D57 * counter[2]
        counter = [(b >> 32) ^ counter[1] ^ key[0], b & MASK, (a >> 32) ^ counter[3] ^ key[1], a & MASK]
    return counter


def draw(nominal: np.ndarray, step: int) -> np.ndarray:
    digest = hashlib.sha256(f"glbench uncertain parameters\n{TASK}\n{SEED}".encode()).digest()
    key = [int.from_bytes(digest[:4], "big"), int.from_bytes(digest[4:8], "big")]
    p = nominal.copy()
    for j, name in enumerate(crop_parameter_set("crop28")):
        words = philox([step, j // 2, 0, 0], key)[2 * (j % 2) :]
        uniform = ((words[0] >> 5) * 2**26 + (words[1] >> 6)) / 2**53
        p[PARAMETER_NAMES.index(name)] *= 1 + 0.1 * (2 * uniform - 1)
    p[PARAMETER_NAMES.index("cLeafMax")] = p[PARAMETER_NAMES.index("laiMax")] / p[PARAMETER_NAMES.index("sla")]
    return p


def humidity(temperature: float, pressure: float) -> float:
    return min(100.0, 100 * pressure / (610.78 * math.exp(17.2694 * temperature / (temperature + 238.3))))


def ppm(temperature: float, density: float) -> float:
    return 8.3144598e6 * (temperature + 273.15) * 1e-6 * density / (101325 * 44.01e-3)


def observe(x: np.ndarray, u: np.ndarray, d: np.ndarray, k: int) -> list[float]:
    hour, day = 2 * math.pi * (k / 96 % 1), 2 * math.pi * (59 + k / 96) / 365
    return [
        *(x[2], ppm(x[2], x[0]), humidity(x[2], x[15]), x[9], x[25] * 1e-6, x[21], x[26]),
        *(math.sin(hour), math.cos(hour), math.sin(day), math.cos(day)),
        *(u[0] * 130, u[1] * 5, u[2], u[3], u[4] * 116, u[5]),
        *(d[0], d[1], humidity(d[1], d[2]), ppm(d[1], d[3]), d[4]),
    ]


def reward(before: np.ndarray, after: np.ndarray, u: np.ndarray) -> tuple[float, float]:
    gain = 1.6 * (after[25] - before[25]) * 1e-6 / 0.065
    epi = gain - u[0] * 130 * 0.25e-3 * 0.09 - u[4] * 116 * 0.25e-3 * 0.3 - u[1] * 5 * 900e-6 * 0.3
    lowest, highest = -0.012975, 0.328 * 900e-6 / 0.065 * 1.6
    penalty = 0.0
    for value, low, high, scale in (
        (after[2], 15, 34, 15),
        (ppm(after[2], after[0]), 300, 1600, 2500),
        (humidity(after[2], after[15]), 50, 85, 15),
    ):
        penalty += (max(0, low - value) + max(0, value - high)) / scale
    return (epi - lowest) / (highest - lowest) - penalty, epi


def flow(x: np.ndarray, u: np.ndarray, d: np.ndarray, p: np.ndarray) -> np.ndarray:
    def slope(_: float, y: np.ndarray) -> np.ndarray:
        return rhs(y, u, d, p)

    end: np.ndarray = solve_ivp(slope, (0.0, 900.0), x, method="Radau", rtol=1e-10, atol=1e-10).y[:, -1]
    return end


def main() -> None:
    task = get_task(TASK)
    nominal, weather = task.parameters(), task.disturbances().values
    x, u = task.initial_state().copy(), np.zeros(6)
    record = []
    for k in range(STEPS):
        u = np.clip(u + 0.1 * np.array(action(k)), 0, 1)
        p, d = draw(nominal, k), weather[k]
        before, x = x, flow(x, u, d, p)
        gained, epi = reward(before, x, u)
        shown = [float(value) for value in observe(x, u, weather[k + 1], k + 1)]
        record.append({"action": action(k), "observation": shown, "reward": gained, "epi": epi})
    out = {"task": TASK, "seed": SEED, "record": record}
    Path(__file__).with_suffix(".json").write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

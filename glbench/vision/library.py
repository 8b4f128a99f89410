"""Libraries of rendered scenes: pictures, what is true of each, and what the encoder makes of it. docs/vision.md."""

from __future__ import annotations

import hashlib
import io
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import ArrayFile, Floats
from glbench.errors import GlbenchError, refuse
from glbench.extras import require
from glbench.resources import data_folder
from glbench.untrusted import MIB, reason_of

Integers = NDArray[np.int64]
Role = Literal["training", "encoder", "test"]
ROLES: tuple[Role, ...] = ("training", "encoder", "test")
"""What plants are for: training and validation, the training of the encoder, tests."""
TRUTH: dict[str, tuple[str, ...]] = {"lettuce": ("mass", "cover", "leaf_area_index"), "tomato": ("leaf_area_index", "fruits", "ripe")}
"""What is known of each scene of a crop: the mean fresh mass of a head [g], the share of the picture that shows leaves, leaf area per floor
area [m2 m-2], fruits on the plants and ripe ones among them [m-2]."""
_FORMAT = 2
_LARGEST = 64 * MIB


@dataclass(frozen=True, eq=False)
class Library:
    """The scenes of one crop in all lights: of lettuce each mean mass with each plant variation, of tomato rows in many states."""

    crop: str
    digest: str
    """SHA-256 of the file, hex."""
    columns: tuple[str, ...]
    """Names of the features."""
    features: Floats
    """What the encoder makes of each picture, -1 to 1, shape (scenes, features)."""
    truth: Mapping[str, Floats]
    """What is true of each scene, by the names of ``TRUTH``, each of shape (scenes,)."""
    seeds: Integers
    """Plant variation of each scene, from 0 on, shape (scenes,)."""
    lights: Integers
    """Light of each scene, from 0 on, shape (scenes,)."""
    roles: Integers
    """What the plants of each scene are for, a place in ``ROLES``, shape (scenes,)."""
    estimates: Floats
    """By the encoder, shape (scenes, estimates): mass [g] and cover of lettuce, all three of ``TRUTH`` of tomato."""
    _pictures: NDArray[np.uint8]
    _starts: Integers

    @classmethod
    def open(cls, crop: str, version: str | None = None) -> Library:
        """The library of a crop, ``"lettuce"`` or ``"tomato"``; the newest, if no version is given.

        Raises ``GlbenchError`` when there is none of that name, when the package with the data is not installed (with the command that
        installs it), or when the file is not the one that the manifest names.
        """
        folder = data_folder("images")
        manifest = tomllib.loads((folder / "manifest.toml").read_text(encoding="utf-8"))
        versions = [int(one.rpartition("-")[2]) for one in manifest if one.rpartition("-")[0] == crop] if version is None else [version]
        name = f"{crop}-{max(versions)}" if versions else crop
        if name not in manifest:
            refuse(f"There are no pictures '{name}'. There are: {', '.join(sorted(manifest))}.", GlbenchError)
        return cls.at(folder / f"{name}.npz", manifest[name]["sha256"])

    @classmethod
    def at(cls, file: Path, sha256: str | None = None) -> Library:
        """The library in ``file``. Raises ``GlbenchError`` when it cannot be read, is damaged, or has another digest than ``sha256``."""
        try:
            content = file.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            if sha256 is not None and digest != sha256:
                refuse(f"it has the SHA-256 {digest}, the manifest says {sha256}")
            arrays = ArrayFile.of(content, _LARGEST)
            arrays.check_format(_FORMAT)
            crop = arrays.text("crop")
            if crop not in TRUTH:
                refuse(f"its crop is '{crop}', not one of {', '.join(TRUTH)}")
            truth = {name: arrays.floats(name, 1) for name in TRUTH[crop]}
            return cls(
                crop=crop, truth=truth, digest=digest, columns=arrays.texts("columns"), features=arrays.floats("features", 2),
                seeds=arrays.integers("seeds", 1, np.int64), lights=arrays.integers("lights", 1, np.int64),
                roles=arrays.integers("shown", 1, np.int64), estimates=arrays.floats("estimates", 2),
                _pictures=arrays.integers("pictures", 1, np.uint8), _starts=arrays.integers("starts", 1, np.int64),
            )  # fmt: skip
        except (OSError, ValueError) as error:
            advice = "" if sha256 is None else " Install glbench-data again."
            refuse(f"Cannot read the pictures in {file}: {reason_of(error)}.{advice}", GlbenchError, error)

    def plants(self, role: Role) -> NDArray[np.bool_]:
        """Which scenes have the plants for training and validation, for tests, or for the encoder alone, shape (scenes,)."""
        if role not in ROLES:
            refuse(f"There are no plants for '{role}'. Choose one of {', '.join(ROLES)}; validation shows those of training.")
        return np.asarray(self.roles == ROLES.index(role))

    def pick(self, mass: Floats, variation: Floats, light: Floats, role: Role = "training") -> Integers:
        """Index of the scene nearest to each ``mass`` [g], of the variation and light that draws in [0, 1) choose. All shapes (n,).

        Only variations for this ``role`` are picked. Beyond the lightest and heaviest scene these two are shown. Raises
        ``ValueError`` for a mass below 0, a draw outside [0, 1), an unknown role, or a library of tomatoes.
        """
        if "mass" not in self.truth or role not in ROLES:
            self.plants(role)
            refuse(f"Scenes of {self.crop} have no mass. Use nearest, by {', '.join(self.truth)}.")
        mass, variation, light = (np.asarray(one, dtype=np.float64) for one in (mass, variation, light))
        for name, draw, most in (("mass", mass, np.inf), ("variation", variation, 1.0), ("light", light, 1.0)):
            if (outside := ~((draw >= 0.0) & (draw < most))).any():
                row = int(np.argmax(outside))
                refuse(f"{name}[{row}] is {draw.flat[row]}: it must be at least 0, and {'finite' if name == 'mass' else 'below 1'}.")
        masses, table = self._tables[role]
        nearest = np.searchsorted((masses[1:] + masses[:-1]) / 2, mass)
        _, variations, lights = table.shape
        return np.asarray(table[nearest, (variation * variations).astype(np.int64), (light * lights).astype(np.int64)])

    def nearest(self, states: Floats, variation: int, light: int = 1) -> Integers:
        """Index of the scene nearest to each state, shape (n,), of one of the variations for tests, the remainder of ``variation``.

        ``states`` are by the names of ``TRUTH``, shape (n, names); distances are shares of the range of each. The light is that of noon.
        Raises ``ValueError`` for states of another shape or that are not finite, and a light that no scene has.
        """
        if np.ndim(states) != 2 or np.shape(states)[1] != len(self.truth) or not np.isfinite(states).all() or light not in self.lights:
            lights = int(self.lights.max())
            refuse(f"States must be finite, of shape (n, {len(self.truth)}): {', '.join(self.truth)}; a light is 0 to {lights}.")
        rows = np.unique(self.seeds[self.plants("test")])
        scenes = np.flatnonzero((self.seeds == rows[variation % len(rows)]) & (self.lights == light))
        table = np.stack([values[scenes] for values in self.truth.values()], axis=-1)
        away = (states[:, None] - table) / np.maximum(np.ptp(table, axis=0), 1e-12)
        return np.asarray(scenes[np.argmin((away**2).sum(axis=-1), axis=1)])

    def content(self, index: int) -> bytes:
        """The file of the picture of a scene (WebP)."""
        return self._pictures[self._starts[index] : self._starts[index + 1]].tobytes()

    def image(self, index: int) -> NDArray[np.uint8]:
        """The picture of a scene (sRGB), shape (height, width, 3). Raises ``GlbenchError`` without the package pillow or that scene."""
        if not 0 <= index < len(self.seeds):
            refuse(f"There is no scene {index}: scenes are numbered 0 to {len(self.seeds) - 1}.", GlbenchError)
        require("A picture of the library", "vision", "PIL")
        from PIL import Image

        with Image.open(io.BytesIO(self.content(index))) as picture:
            return np.asarray(picture.convert("RGB"), dtype=np.uint8)

    @cached_property
    def _tables(self) -> dict[Role, tuple[Floats, Integers]]:
        """Masses [g], and the scene of each mass, variation and light."""
        return {role: self._table(np.flatnonzero(self.plants(role))) for role in ROLES}

    def _table(self, scenes: NDArray[np.intp]) -> tuple[Floats, Integers]:
        masses, row = np.unique(self.truth["mass"][scenes], return_inverse=True)
        variations, column = np.unique(self.seeds[scenes], return_inverse=True)
        table = np.full((len(masses), len(variations), int(self.lights.max()) + 1), -1)
        table[row, column, self.lights[scenes]] = scenes
        if (table < 0).any() or not table.size:
            refuse("The library is incomplete: it lacks a mass, variation or light.", GlbenchError)
        return masses, table

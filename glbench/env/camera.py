"""The picture of the crop that a camera takes once a day, and of which an encoder's features are observed until the next one.

A picture is one of a library's (``glbench.vision.library``): the one nearest to the mean mass of the heads, of plants and in light that are
drawn. A test draws from plants that no training shows. New plants are drawn when the heads weigh less than half of what they did in the
last picture, and the light is drawn for each. The tapes keep the number of a picture, and the kernel looks up its features by it.
docs/observations.md tells more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.accounts import ByName
from glbench.env.memory_layout import DrawPlaces, MemoryLayout
from glbench.env.process_computer import at_least, below, select, within
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key
from glbench.env.weather_pool import CLOCK
from glbench.kernel.environment import Lookup
from glbench.kernel.tape import Recorder, Source
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import CAMERA, head_mass_of
from glbench.vision.library import Library, Role

MASSES = 1024
"""Masses that pictures are numbered by, evenly from the lightest heads of the library to the heaviest."""
_ANY, _NUMBER, _PLANTS, _HEAD = "any picture", "number", "plants", "head"
_REPLANTED = 0.5
"""Heads that weigh less than this share of those in the last picture are of new plants."""
_LARGE = 1.5 * 2.0**52
"""Added to a number and then subtracted, it leaves the nearest whole number: doubles have no more digits."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """The scenes of a library by number of a picture: of so many ``plants``, in so many ``lights``, of each of ``MASSES``.

    ``scenes`` are their indices in the library ``(pictures,)``, ``features`` what the encoder makes of them ``(pictures, features)``,
    ``lightest`` and ``heaviest`` the masses of the library [g].
    """

    scenes: NDArray[np.int64]
    features: NDArray[np.float32]
    lightest: float
    heaviest: float
    plants: int
    lights: int

    @staticmethod
    @lru_cache(maxsize=4)
    def of(library: Library, role: Role) -> Pictures:
        """The pictures of the plants for training or for tests, the mass going fastest."""
        lightest, heaviest = float(library.truth["mass"].min()), float(library.truth["mass"].max())
        plants, lights = len(np.unique(library.seeds[library.plants(role)])), len(np.unique(library.lights))
        draws = ((np.arange(count) + 0.5) / count for count in (plants, lights))
        variation, light, mass = (one.ravel() for one in np.meshgrid(*draws, np.linspace(lightest, heaviest, MASSES), indexing="ij"))
        scenes = library.pick(mass, variation, light, role)
        return Pictures(scenes, library.features[scenes].astype(np.float32), lightest, heaviest, plants, lights)

    def number(self, head: Any, plants: Any, light: Any) -> Any:
        """The number of the picture of heads of mass ``head`` [g]; ``plants`` and ``light`` are uniform numbers in [0, 1)."""
        mass = _whole((head - self.lightest) / (self.heaviest - self.lightest) * (MASSES - 1), MASSES)
        variation, lights = _whole(plants * self.plants - 0.5, self.plants), _whole(light * self.lights - 0.5, self.lights)
        return (variation * self.lights + lights) * MASSES + mass


def _whole(number: Any, count: int) -> Any:
    """The nearest whole number from 0 to ``count - 1``."""
    return within(number, 0.0, count - 1.0) + _LARGE - _LARGE


@dataclass(frozen=True, eq=False)
class Camera:
    """The camera of a task: its pictures, the hour at which it takes them, and where what it draws begins.

    Plants and light of the first picture are traits of the run.
    """

    task: TaskSpec
    pictures: Pictures
    hour: float
    places: DrawPlaces

    STREAM: ClassVar[str] = CAMERA
    TRAIT_STREAM: ClassVar[str] = "first picture"
    PART: ClassVar[str] = CAMERA
    numbers: ClassVar[int] = 2
    trait_numbers: ClassVar[int] = 2
    trait_count: ClassVar[int] = 2
    """``numbers``, ``trait_numbers`` and ``trait_count``: plants and light, each a uniform number."""

    @staticmethod
    def of(task: TaskSpec, places: DrawPlaces) -> Camera | None:
        """The camera of a task, if it has one. Only the splits training and validation show plants that agents may know."""
        library, table = task.picture_library, task.camera
        if library is None or table is None:
            return None
        role: Role = "training" if task.split in ("training", "validation") else "test"
        return Camera(task, Pictures.of(library, role), float(table.hour), places)

    def traits(self, numbers: Floats) -> Floats:
        """Plants and light of the first picture, ``(n, 2)``."""
        return numbers

    def initial_memory(self) -> dict[str, float]:
        """Numbers kept from step to step: whether there is a picture, its number, and the plants and the mass of heads [g] in it."""
        return dict.fromkeys((_ANY, _NUMBER, _PLANTS, _HEAD), 0.0)

    def record(self, recorder: Recorder, layout: MemoryLayout, at: int) -> Lookup:
        """Record the picture's number, before the first step that of one of now, in column ``at``: the lookup makes features of it."""
        memory = layout.of(self.PART)
        traits = (recorder.input("trait", self.places.trait + place) for place in range(2))
        first = self.pictures.number(self._head(recorder, "after"), *traits)
        number = select(recorder.input("memory", memory[_ANY]), recorder.input("memory", memory[_NUMBER]), first)
        recorder.output("observation", at, number)
        return Lookup(self.pictures.features, at=at, numbered=True)

    def update(self, recorder: Recorder, layout: MemoryLayout) -> None:
        """Record what is kept after a step: the picture of the start after the first one, and a new one when the hour has come."""
        memory, clock = layout.of(self.PART), CLOCK.index("hour_of_day")
        any_picture, number, plants, head = (recorder.input("memory", memory[name]) for name in (_ANY, _NUMBER, _PLANTS, _HEAD))
        due = at_least(recorder.input("calendar", clock), self.hour) * below(recorder.input("calendar_before", clock), self.hour)
        first = below(any_picture, 1.0)
        plants_now, light_now = (recorder.input("noise", self.places.noise + place) for place in range(2))
        plants_first, light_first = (recorder.input("trait", self.places.trait + place) for place in range(2))
        mass = select(due, self._head(recorder, "after"), self._head(recorder, "before"))
        in_it = select(first, plants_first, select(below(mass, _REPLANTED * head), plants_now, plants))
        now = self.pictures.number(mass, in_it, select(due, light_now, light_first))
        recorder.output("memory", memory[_ANY], 1.0)
        for name, new, old in ((_NUMBER, now, number), (_PLANTS, in_it, plants), (_HEAD, mass, head)):
            recorder.output("memory", memory[name], select(np.maximum(first, due), new, old))

    def _head(self, recorder: Recorder, moment: Source) -> Any:
        return self.head_mass([recorder.input(moment, place) for place in range(len(self.task.model_value.states))])

    def head_mass(self, states: Sequence[Any]) -> Any:
        """Mean mass of the heads [g] from the states, with nominal parameters."""
        model = self.task.model_value
        return head_mass_of(model)(ByName(model.states, states), model.Parameters(*self.task.parameters().tolist()))


def run_scenes(task: TaskSpec, seed: int, states: Floats, hours: Floats) -> NDArray[np.int64]:
    """The scene of the library in the last picture that the run with ``seed`` shows at its start and after each step, ``(steps + 1,)``.

    ``states`` ``(steps + 1, s)`` and ``hours`` of the day ``(steps + 1,)`` are those of these moments. The task has a camera.
    """
    camera = Camera.of(task, DrawPlaces())
    assert camera is not None
    moments = np.append(0, np.flatnonzero((hours[1:] >= camera.hour) & (hours[:-1] < camera.hour)) + 1)
    first, later = (np.array([stream_key(task.scenario, seed, name)], np.uint64) for name in (Camera.TRAIT_STREAM, Camera.STREAM))
    draws = np.concatenate([uniforms(first, moments[None, :1], 2)[0], uniforms(later, moments[None, 1:], 2)[0]])
    heads = camera.head_mass(list(states[moments].T))
    planted = np.append(True, heads[1:] < _REPLANTED * heads[:-1])
    plants = draws[np.maximum.accumulate(np.where(planted, np.arange(len(moments)), 0)), 0]
    scenes = camera.pictures.scenes[camera.pictures.number(heads, plants, draws[:, 1]).astype(np.intp)]
    return np.repeat(scenes, np.diff(np.append(moments, len(hours))))
